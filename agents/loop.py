"""The only loop: a world, its learners and their observers."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np

from ecology import Ecology, EcologyError, Group, Tick
from ecology.agents.base import Learner, Transition
from ecology.interventions import Effect
from ecology.observers.base import Observer
from ecology.schedule import ScheduledTick


def run(
    env: Ecology,
    learners: Mapping[str, Learner],
    tick: Tick,
    ticks: int,
    observers: Iterable[Observer] = (),
    clock: Callable[[], float] = float,
) -> Tick:
    """Run for `ticks` ticks from `tick` (as `env.reset_arrays` returned it) and return the last one.

    Every observer's `begin` is called once before the first tick and its `end` once after the last one, also where an
    exception ends the run. `advance` is the same without `begin` and `end`.

    The time that acting and learning take by `clock`, in seconds, is added to `learner.seconds`; the default clock
    stands still.
    """
    observers = tuple(observers)
    if isinstance(tick, ScheduledTick) and tick.state.tick == 0:
        follow(env, learners, tick)
    with observing(observers, env, learners):
        return advance(env, learners, tick, ticks, observers, clock)


@contextlib.contextmanager
def observing(observers: Iterable[Observer], env: Ecology, learners: Mapping[str, Learner]) -> Iterator[None]:
    """Begin the observers in order, and end those that have begun in reverse order, whatever is raised."""
    observers = tuple(observers)
    for observer in observers:
        methods = (getattr(observer, name, None) for name in ("begin", "watch", "end"))
        if isinstance(observer, type) or not all(map(callable, methods)):
            raise EcologyError(
                f"an observer is an object with the methods begin, watch and end, got {observer!r}; derive its class "
                "from ecology.observers.base.Observer, which has empty ones, and pass an instance of it."
            )
    with contextlib.ExitStack() as at_end:
        for observer in observers:
            observer.begin(env, learners)
            at_end.callback(observer.end)
        yield


def advance(
    env: Ecology,
    learners: Mapping[str, Learner],
    tick: Tick,
    ticks: int,
    observers: Iterable[Observer] = (),
    clock: Callable[[], float] = float,
    between: Callable[[Tick], Tick] | None = None,
) -> Tick:
    """Run for `ticks` ticks as `run` does, but leave `begin` and `end` of the observers to the caller.

    Before every tick `between` gets the last one and returns what is perceived by then. It can wait, and change the
    world.
    """
    observers = tuple(observers)
    groups = [(group, learners[group.name]) for group in env.groups.values()]
    inherits = any(group.inherited for group, _ in groups)
    actions = np.zeros(env.size, np.int64)
    if isinstance(tick, ScheduledTick) and env.state_view.tick == 0:
        report(env, observers, tick)
    for _ in range(ticks):
        before = tick if between is None else between(tick)
        if inherits:
            adopt(env, learners)
        for group, learner in groups:
            began = clock()
            chosen = learner.act(before.observations[group.name], before.masks[group.name])
            learner.seconds += clock() - began
            try:
                actions[group.slots] = chosen
            except (TypeError, ValueError) as error:
                raise EcologyError(
                    f"the learner of {group.name!r}, {type(learner).__name__}, must return {group.size} actions, an "
                    f"index for every slot, got {chosen!r}."
                ) from error
        tick = env.step_arrays(actions)
        scheduled = tick if isinstance(tick, ScheduledTick) else None
        lived = tick if scheduled is None else scheduled.lived
        alive = lived.alive & ~lived.born
        changed = bool((lived.died | lived.born).any())
        if inherits:
            adopt(env, learners)
        for group, learner in groups:
            if learner.learning:
                began = clock()
                after = _outcome(group, before, lived) if changed else lived.observations[group.name]
                learner.learn(
                    Transition(
                        observations=before.observations[group.name],
                        masks=before.masks[group.name],
                        actions=lived.action[group.slots],
                        next_observations=after if scheduled is None else _felt_observations(group, after, scheduled),
                        next_masks=lived.masks[group.name],
                        alive=alive[group.slots],
                        died=lived.died[group.slots],
                    )
                )
                learner.seconds += clock() - began
            if changed:
                _pass_on(group, learner, lived)
        if scheduled is not None:
            follow(env, learners, scheduled)
        if observers:
            state = env.state_view if scheduled is None else scheduled.state
            for observer in observers:
                observer.watch(state, lived, learners)
            if scheduled is not None:
                report(env, observers, scheduled)
    return tick


def adopt(env: Ecology, learners: Mapping[str, Learner]) -> None:
    """Hand the learners the settings that their agents have inherited, as the world holds them now."""
    for group in env.groups.values():
        if group.inherited:
            traits = env.state_view.trait
            assert traits is not None
            learners[group.name].adopt({each.setting: traits[group.slots, each.column] for each in group.inherited})


def follow(env: Ecology, learners: Mapping[str, Learner], tick: ScheduledTick) -> None:
    """Report to the learners what the schedule did after a tick; agents that feel it are interrupted only if moved."""
    for _, effect in tick.effects:
        pass_on_effect(env, learners, effect, effect.moved if tick.felt else effect.changed)


def report(env: Ecology, observers: Iterable[Observer], tick: ScheduledTick) -> None:
    """Report to the observers what the schedule did after a tick."""
    for text, effect in tick.effects:
        for observer in observers:
            if (notify := getattr(observer, "intervened", None)) is not None:
                notify(env.state_view, text, effect.said)


def pass_on_effect(env: Ecology, learners: Mapping[str, Learner], effect: Effect, cut: Iterable[int]) -> None:
    """Report an intervention to the learners; in the slots `cut` the next observation does not follow from the last."""
    for species, learner in learners.items():
        rows = env.groups[species].slots

        def mine(slots: Iterable[int], rows: slice = rows) -> np.ndarray:
            return np.array([slot - rows.start for slot in slots if rows.start <= slot < rows.stop], np.int64)

        if (slots := mine(effect.died)).size:
            learner.died(slots)
        if (slots := mine(effect.born)).size:
            learner.born(slots, np.full(len(slots), -1))
        if (slots := mine(cut)).size:
            learner.interrupted(slots)
        if species in effect.learning:
            learner.learning = effect.learning[species]
            learner.begin()


def _felt_observations(group: Group, after: np.ndarray, tick: ScheduledTick) -> np.ndarray:
    """Return the observations after a tick (n, D), after the events for agents that survive them and are not moved."""
    if not tick.felt:
        return after
    through = (tick.lived.alive & tick.alive & ~tick.born)[group.slots]
    moved = [slot - group.slots.start for _, effect in tick.effects for slot in effect.moved]
    through[[row for row in moved if 0 <= row < group.size]] = False
    return np.where(through[:, None], tick.observations[group.name], after)


def _outcome(group: Group, before: Tick, tick: Tick) -> np.ndarray:
    """Return the observations after a tick (n, D); an agent that died keeps all but its needs as it last sensed them.

    The dead sense nothing, so `tick` says of their surroundings that nothing is in sight.
    """
    after, died = tick.observations[group.name], tick.died[group.slots]
    sensed = np.array(group.layout.kinds) != "deviation"
    return np.where(died[:, None] & sensed, before.observations[group.name], after)


def _pass_on(group: Group, learner: Learner, tick: Tick) -> None:
    """Report to a learner which agents of its species died and were born in `tick`."""
    died, born = np.flatnonzero(tick.died[group.slots]), np.flatnonzero(tick.born[group.slots])
    if died.size:
        learner.died(died)
    if born.size:
        parent = tick.parent[group.slots][born]
        own = (parent >= group.slots.start) & (parent < group.slots.stop)
        learner.born(born, np.where(own, parent - group.slots.start, -1))
