"""The contract that every scenario must satisfy: what learners, libraries and readers of results rely on.

A check is a function of a scenario and a number of ticks; it raises an EcologyError that says what is broken and
where. `ecology check` and the tests run the same checks.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import hashlib
import io
import json
import math
import pickle
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ecology.env import Ecology
from ecology.errors import EcologyError
from ecology.ground import split_room
from ecology.observers.shapes import patches as patches_drawn
from ecology.scenario import Scenario
from ecology.spec import require
from ecology.state import Ints, State
from ecology.world import Tick

ROUNDING = 1e-9  # by which an account may miss in a tick, units of the variable or 1e-9 of what went through
HANDED_OUT = 20  # ticks whose arrays are kept and looked at again
HORIZON = 3  # ticks

Check = Callable[[Scenario, int], None]


def choose(env: Ecology, tick: Tick, rng: np.random.Generator, *, open_only: bool = True) -> Ints:
    """Return one action per slot (N,) at random, open in its mask, or any."""
    wanted = np.zeros(env.size, np.int64)
    for group in env.groups.values():
        mask = tick.masks[group.name] if open_only else np.ones((group.size, len(group.actions)), bool)
        wanted[group.slots] = np.argmax(rng.random(mask.shape) * mask, axis=1)
    return wanted


def check(scenario: Scenario, ticks: int) -> Iterator[tuple[str, Exception | None]]:
    """Yield the description of each check, and the exception that it raised; None if it passed."""
    for holds, test in CHECKS.items():
        try:
            test(scenario, ticks)
        except Exception as error:  # also what a scenario's own rule raises
            yield holds, error
        else:
            yield holds, None


def reason(error: Exception) -> str:
    """Return why a check failed, from the exception that it raised."""
    return str(error) if isinstance(error, EcologyError) else f"{type(error).__name__}: {error}"


def _lives(env: Ecology, seed: int, ticks: int, *, open_share: float = 0.7) -> Iterator[tuple[Tick, Ints, Tick]]:
    """Yield the tick before, the actions and the tick after, of a life of random actions, open and closed."""
    rng = np.random.default_rng(seed)
    before = env.reset_arrays(seed=seed)
    for _ in range(ticks):
        actions = choose(env, before, rng, open_only=rng.random() < open_share)
        tick = env.step_arrays(actions)
        yield before, actions, tick
        before = tick


def _same(one: Any, other: Any, what: str) -> None:
    """Raise EcologyError unless the two are equal; the message is made only then, there are many of them."""
    if one is not other and not (one == other if isinstance(one, (bool, int, float)) else np.array_equal(one, other)):
        raise EcologyError(f"{what}: {one!r} is not {other!r}.")


# ---- the interface ------------------------------------------------------------------------------


def pettingzoo_accepts_it(scenario: Scenario, ticks: int) -> None:
    """Pass PettingZoo's own parallel_api_test, with and without a horizon, and its state_test, agent by agent."""
    from pettingzoo.test import parallel_api_test  # needed by this check only
    from pettingzoo.test.state_test import state_test
    from pettingzoo.utils.conversions import parallel_to_aec

    horizon = min(20, ticks)
    for env in (Ecology(scenario), Ecology(scenario, horizon=horizon)):
        for group in env.groups.values():
            if group.size:
                env.action_space(f"{group.name}_{0 if env.open_population else group.slots.start}").seed(0)
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("error")
            if env.open_population:  # names without end, births, and a population that may die out
                for words in (".*possible_agents", "No agents present", "Agent was given"):
                    warnings.filterwarnings("ignore", message=words)
            parallel_api_test(env, num_cycles=ticks if env.horizon is None else horizon + 30)
            warnings.filterwarnings("ignore", message=".*state space value is (-)?infinity")  # an unbounded need
            if env.horizon is not None:
                state_test(parallel_to_aec(env), Ecology(scenario), num_cycles=horizon + 1)


def observations_lie_in_their_space(scenario: Scenario, ticks: int) -> None:
    """Check that observations are finite and inside their space, whatever the actions."""
    env = Ecology(scenario)
    rng = np.random.default_rng(1)
    observations, _ = env.reset(seed=1)
    rewards: Mapping[str, float] = {}
    for t in range(ticks + 1):
        for name, seen in observations.items():
            zeta, space = seen["observation"], env.observation_space(name)
            if not (np.isfinite(zeta).all() and space.contains(seen)):
                layout, box = env.groups[env.species_of(name)].layout, space["observation"]
                bad = np.flatnonzero(~(np.isfinite(zeta) & (zeta >= box.low) & (zeta <= box.high)))  # type: ignore[attr-defined]
                what = {layout.names[i]: float(zeta[i]) for i in bad.tolist()} or seen
                require(False, f"tick {t}: {name} perceives {what}, outside its observation space {box}.")
        for name, reward in rewards.items():
            require(math.isfinite(reward), f"tick {t}: the reward of {name} is {reward}.")
        observations, rewards, *_ = env.step({a: int(rng.integers(env.action_space(a).n)) for a in env.agents})


def the_mask_is_honoured(scenario: Scenario, ticks: int) -> None:
    """Check that only open actions are executed: a closed one becomes rest, or what is open without it, and counts."""
    env = Ecology(scenario)
    asked_closed = np.zeros(env.size, np.int64)
    for before, wanted, tick in _lives(env, 2, ticks, open_share=0.5):
        for group in env.groups.values():
            rest = group.kinds.index("rest")
            for row in np.flatnonzero(before.alive[group.slots]).tolist():
                slot, mask = group.slots.start + row, before.masks[group.name][row]
                asked, did = int(wanted[slot]), int(tick.action[slot])
                who = f"tick {env.state_view.tick}: {env.name_of(slot)}"
                require(bool(mask[did]), f"{who} does {group.actions[did]!r}, which is closed.")
                if mask[asked] or mask[rest]:
                    due = asked if mask[asked] else rest
                    require(
                        did == due, f"{who} chooses {group.actions[asked]!r} and executes {group.actions[did]!r} "
                        f"instead of {group.actions[due]!r}."
                    )  # fmt: skip
                require(
                    bool(tick.closed[slot]) == (not mask[asked]),
                    f"{who} chooses {group.actions[asked]!r}, but `closed` is {bool(tick.closed[slot])}.",
                )
            dead = ~before.alive[group.slots]
            require(
                not before.masks[group.name][dead].any(), f"tick {env.state_view.tick}: a dead slot has open actions."
            )
        asked_closed += tick.closed
    _same(env.state_view.closed, asked_closed, "the count of closed actions")


def infos_tell_drive_and_closed(scenario: Scenario, ticks: int) -> None:
    """Check that `infos` has the drive and whether the last action was closed; the mask is in the observation alone."""
    env = Ecology(scenario)
    observations, infos = env.reset(seed=3)
    closed: dict[str, bool] = dict.fromkeys(env.agents, False)
    for t in range(min(ticks, 50) + 1):
        for name, info in infos.items():
            require("action_mask" not in info, f"tick {t}: the mask of {name} is in its info too.")
            _same(info["closed"], closed.get(name, False), f"tick {t}: closed in the info of {name}")
        for name, slot in zip(env.agents, np.flatnonzero(env.state_view.alive), strict=True):
            _same(infos[name]["drive"], env.state_view.drive[slot], f"tick {t}: the drive in the info of {name}")
        # a closed action, where there is one
        wanted = {name: int(np.argmin(observations[name]["action_mask"])) for name in env.agents}
        closed = {name: not observations[name]["action_mask"][action] for name, action in wanted.items()}
        observations, _, _, _, infos = env.step(wanted)


def dicts_and_arrays_agree(scenario: Scenario, ticks: int) -> None:
    """Check that `step` and `step_arrays` give one trajectory, number for number.

    Newborns are in all five dicts on the tick of their birth, the dead for a last time on that of their death.
    """
    of_dicts, of_arrays = Ecology(scenario), Ecology(scenario)
    observations, infos = of_dicts.reset(seed=4)
    _same(sorted(observations), sorted(infos), "the agents in the dicts of reset")
    for before, actions, tick in _lives(of_arrays, 4, ticks):
        t = of_arrays.state_view.tick
        living = of_dicts.agents
        if not (living or any(species.arrival for species in scenario.species)):
            return  # nobody is left for whom there are dicts
        _same(len(living), np.count_nonzero(before.alive), f"tick {t}: the count of agents")
        names = {int(slot): name for slot, name in zip(np.flatnonzero(before.alive), living, strict=True)}
        five: tuple[Any, ...] = of_dicts.step({name: int(actions[slot]) for slot, name in names.items()})
        names |= {int(slot): of_arrays.name_of(int(slot)) for slot in np.flatnonzero(tick.born)}
        for part, word in zip(five, ("observations", "rewards", "terminations", "truncations", "infos"), strict=True):
            _same(sorted(map(str, part)), sorted(names.values()), f"tick {t}: the agents in {word}")
        observations, rewards, terminations, truncations, infos = five
        for group in of_arrays.groups.values():
            for slot in (slot for slot in names if group.slots.start <= slot < group.slots.stop):
                name, row = names[slot], slot - group.slots.start
                for word, one, other in (
                    ("observation", observations[name]["observation"], tick.observations[group.name][row]),
                    ("action_mask", observations[name]["action_mask"], tick.masks[group.name][row]),
                    ("reward", rewards[name], tick.reward[slot]),
                    ("termination", terminations[name], not tick.alive[slot]),
                    ("truncation", truncations[name], False),
                    ("drive", infos[name]["drive"], tick.drive[slot]),
                ):
                    _same(one, other, f"tick {t}: the {word} of {name} in dicts and in arrays")
    in_arrays = of_arrays.state_view.arrays()
    for field, values in of_dicts.state_view.arrays().items():
        _same(values, in_arrays[field], f"{field} of the state in dicts and in arrays")


def a_horizon_truncates_everyone(scenario: Scenario, ticks: int) -> None:
    """Check that after `horizon` ticks every agent is truncated and none remains."""
    horizon = min(HORIZON, ticks)
    env = Ecology(scenario, horizon=horizon)
    env.reset(seed=0)
    for t in range(1, horizon + 1):
        *_, truncations, _ = env.step(dict.fromkeys(env.agents, 0))
        require(
            all(over == (t == horizon) for over in truncations.values()),
            f"tick {t} of a horizon of {horizon}: truncations are {truncations}.",
        )
    require(not env.agents, f"after the horizon of {horizon} ticks there are still {env.agents}.")


# ---- the life --------------------------------------------------------------------------------


def what_was_handed_out_stays(scenario: Scenario, ticks: int) -> None:
    """Check that later ticks do not write into arrays that were returned before."""
    env, kept = Ecology(scenario), []
    for before, _, tick in _lives(env, 5, min(ticks, HANDED_OUT)):
        for one in (before, tick, env.state_view):
            parts = {name: values for name, values in vars(one).items() if isinstance(values, np.ndarray)}
            if isinstance(one, Tick):
                parts |= {f"observations of {name}": values for name, values in one.observations.items()}
                parts |= {f"masks of {name}": values for name, values in one.masks.items()}
            kept.append([(env.state_view.tick, name, values, values.copy()) for name, values in parts.items()])
    for parts_ in kept:
        for t, name, values, as_handed_out in parts_:
            _same(values, as_handed_out, f"{name}, handed out around tick {t} and looked at later")


def _fingerprints(env: Ecology, seed: int, ticks: int) -> list[str]:
    """Return a digest of all that is at every tick of a life."""
    found = []
    for _, _, tick in _lives(env, seed, ticks):
        digest = hashlib.sha256()
        arrays = [*env.state_view.arrays().values(), tick.reward, *tick.observations.values(), *tick.masks.values()]
        arrays.append(np.array(env.scenario.measure(env.state_view)))
        for values in arrays:
            digest.update(np.ascontiguousarray(values).tobytes())
        found.append(digest.hexdigest())
    return found


def the_seed_decides_the_life(scenario: Scenario, ticks: int) -> None:
    """Check that two worlds with one seed, and one reset to its seed, give one run, bit for bit."""
    env = Ecology(scenario)
    first = _fingerprints(env, 11, ticks)
    for whose, again in (("another world", Ecology(scenario)), ("the world after a reset", env)):
        for t, (one, other) in enumerate(zip(first, _fingerprints(again, 11, ticks), strict=True), 1):
            require(
                one == other,
                f"tick {t}: with the same seed and actions {whose} is in another state; does a rule keep something "
                "from tick to tick, or draw from elsewhere than its generator?",
            )


def a_snapshot_lives_on(scenario: Scenario, ticks: int) -> None:
    """Check that a world restored from a snapshot, at a fifth of its ticks, continues bit for bit."""
    env, other = Ecology(scenario), Ecology(scenario)
    rng = np.random.default_rng(6)
    tick = env.reset_arrays(seed=6)
    leaves = {round(share * ticks) for share in (0, 0.2, 0.4, 0.6, 0.8)}
    for t in range(ticks):
        if t in leaves:
            arrays, values = env.snapshot()
            again = Ecology(scenario)
            again.restore(arrays, json.loads(json.dumps(values)))
            other = again
        actions = choose(env, tick, rng, open_only=rng.random() < 0.7)
        tick, twin = env.step_arrays(actions), other.step_arrays(actions)
        then = other.state_view.arrays()
        for field, mine in env.state_view.arrays().items():
            require(
                np.array_equal(mine, then[field], equal_nan=True),
                f"tick {t + 1}: {field} is another in a world that was left and entered at tick "
                f"{max(left for left in leaves if left <= t)}; does a rule keep something from tick to tick?",
            )
        for group in env.groups:
            _same(tick.observations[group], twin.observations[group], f"tick {t + 1}: observations of {group}")
    require(env.state_view.next_serial == other.state_view.next_serial, "the next serial is another.")


def a_copy_lives_on(scenario: Scenario, ticks: int) -> None:
    """Check that a deep copy and a pickled one, taken at a third of the ticks, continue bit for bit as the original."""
    env = Ecology(scenario)
    rng = np.random.default_rng(10)
    tick = env.reset_arrays(seed=10)
    copies: dict[str, Ecology] = {}
    for t in range(ticks):
        if t == ticks // 3:
            copies = {"a deep copy": copy.deepcopy(env), "a pickled copy": pickle.loads(pickle.dumps(env))}
        actions = choose(env, tick, rng, open_only=rng.random() < 0.7)
        tick = env.step_arrays(actions)
        now = env.state_view.arrays()
        for what, twin in copies.items():
            after, then = twin.step_arrays(actions), twin.state_view.arrays()
            for field, mine in now.items():
                require(
                    np.array_equal(mine, then[field], equal_nan=True),
                    f"tick {t + 1}: {field} is another in {what} that was taken at tick {ticks // 3}; does a rule keep "
                    "something from tick to tick?",
                )
            for group in env.groups:
                _same(tick.observations[group], after.observations[group], f"tick {t + 1}: observations of {group}")


def bodies_stay_inside(scenario: Scenario, ticks: int) -> None:
    """Check that the living are within the arena and their paths cross no wall, whatever the actions."""
    if scenario.rule is not None:  # a rule may put a body behind a wall, so ways are looked at without it
        bodies_stay_inside(dataclasses.replace(scenario, rule=None, memory={}), ticks)
    env = Ecology(scenario)
    (left, bottom), (right, top) = scenario.arena.extent
    came_from, ground = np.empty((env.size, 2)), env.world.model.ground
    for before, _, tick in _lives(env, 9, ticks):
        places = env.state_view.position
        if not ground.torus:
            walked = before.alive & tick.alive & (env.state_view.tick > 1) & (scenario.rule is None)
            for slot in np.flatnonzero(walked & ~ground.stays(came_from, places)).tolist():
                raise EcologyError(
                    f"tick {env.state_view.tick}: {env.name_of(slot)} goes through a wall, from "
                    f"{came_from[slot].tolist()} to {places[slot].tolist()}."
                )
            ground = env.world.model.ground  # doors may have moved after the bodies
            came_from = places.copy()
            inside = ground.inside(places)
        else:
            x, y = places.T
            inside = (x >= left) & (x < right) & (y >= bottom) & (y < top)
        for slot in np.flatnonzero(tick.alive & ~inside).tolist():
            raise EcologyError(
                f"tick {env.state_view.tick}: {env.name_of(slot)} is outside the arena, at {places[slot].tolist()}."
            )


def bodies_reach_everything(scenario: Scenario, _: int) -> None:
    """Check that the smallest body can reach all of the arena: no passage is too narrow, no part cut off."""
    radius = min(species.radius for species in scenario.species)
    cut = "" if scenario.arena.torus else split_room(scenario.arena, radius)
    if cut:
        raise EcologyError(f"{cut}; widen the passage, or make the body smaller.")


def accounts_close(scenario: Scenario, ticks: int) -> None:
    """Check that every account closes after every tick."""
    env = Ecology(scenario)
    env.reset_arrays(seed=7)
    first = env.state_view.copy()
    for _ in _lives(env, 7, ticks):
        account_closes(env, first)


def account_closes(env: Ecology, first: State) -> None:
    """Check that every quantity of a world that began as `first` is what came in less what went out, to rounding.

    No stock is below zero. Raises EcologyError.
    """
    now, scenario, finite = env.state_view, env.scenario, np.isfinite(first.stock)
    held = first.internal + now.ingested + now.received - now.given - now.metabolised - now.lost
    through = sum(np.abs(part) for part in (now.ingested, now.received, now.given, now.metabolised, now.lost))
    off = np.abs(held - now.internal) > ROUNDING * np.maximum(1.0, through)
    if off.any():
        slot, need = (int(i) for i in np.argwhere(off)[0])
        species = scenario.species[env.world.model.species_of[slot]]
        name = species.needs[need].name if need < len(species.needs) else f"padding {need}"
        require(
            False,
            f"tick {now.tick}: {name} of {env.name_of(slot)} is {now.internal[slot, need]!r}, its account says "
            f"{held[slot, need]!r}.",
        )
    stored = first.stock[finite] + (now.grown - now.eaten)[finite]
    through = np.maximum(1.0, (now.grown + now.eaten)[finite])
    require(
        bool((np.abs(stored - now.stock[finite]) <= ROUNDING * through).all()),
        f"tick {now.tick}: the stocks are {now.stock[finite]}, their accounts say {stored}.",
    )
    if now.load is not None and env.world.model.hauling is not None:
        most = env.world.model.hauling.most * now.alive[:, None]
        good = (now.load >= 0) & (now.load <= most * (1 + ROUNDING))
        require(bool(good.all()), f"tick {now.tick}: a body carries less than nothing or more than it can, {now.load}.")
    require(bool((now.stock >= 0).all()), f"tick {now.tick}: a stock is below zero, {now.stock}.")
    eaten, ingested = float(now.eaten.sum()), float(now.ingested.sum())
    require(
        abs(eaten - ingested) <= ROUNDING * max(1.0, eaten),
        f"tick {now.tick}: {eaten!r} left the stocks, {ingested!r} was eaten by bodies.",
    )


def names_never_return(scenario: Scenario, ticks: int) -> None:
    """Check that serials are given once, in order, to one life from birth to death, with a rest between two."""
    env = Ecology(scenario)
    over: set[int] = set()
    env.reset_arrays(seed=8)
    free = ~env.state_view.alive  # at the start of the tick
    for before, _, tick in _lives(env, 8, ticks):
        now = env.state_view
        serials = now.serial[tick.alive].tolist()
        who = f"tick {now.tick}"
        require(len(set(serials)) == len(serials), f"{who}: two living agents share a serial.")
        require(
            not over.intersection(serials),
            f"{who}: living agents have serials of dead ones, {over.intersection(serials)}.",
        )
        require(max(serials, default=-1) < now.next_serial, f"{who}: a serial is beyond the next, {now.next_serial}.")
        require(bool(free[tick.born].all()), f"{who}: an agent was born into a slot that was still occupied.")
        require(
            bool((tick.alive == ((before.alive & ~tick.died) | tick.born)).all()),
            f"{who}: the living are not (previously living - died + born).",
        )
        require(
            bool(((now.cause > 0) == ~tick.alive)[now.serial >= 0].all()),
            f"{who}: the dead must have a cause of death, and only they.",
        )
        over.update(now.serial[tick.died].tolist())
        free = ~tick.alive


def gone_patches_offer_nothing(scenario: Scenario, ticks: int) -> None:
    """Check that patches that come and go either hold more than `gone_below`, or are empty, unseen and not drawn."""
    ends = np.array(
        [-1.0 if r.gone_below is None else r.gone_below for r in scenario.resources for _ in range(r.count)]
    )
    if not (ends >= 0).any():
        return
    env = Ecology(scenario)
    for _ in _lives(env, 12, ticks):
        now = env.state_view
        gone = (ends >= 0) & (now.stock <= ends)
        where = f"tick {now.tick}: patch {int(np.argmax(gone))}"
        require(bool((now.stock[gone] == 0).all()), f"{where} is gone, but something is left of it.")
        require(not (now.seen | now.inside)[:, gone].any(), f"{where} is gone, but a body sees it or stands in it.")
        drawn = patches_drawn(scenario, now)[gone]
        require(bool(np.isnan(drawn).all()), f"{where} is gone, but drawn.")


CHECKS: Mapping[str, Check] = {
    "PettingZoo's own test passes": pettingzoo_accepts_it,
    "observations and rewards are finite, observations inside their space": observations_lie_in_their_space,
    "the action mask is honoured": the_mask_is_honoured,
    "infos have the drive and closed actions": infos_tell_drive_and_closed,
    "dicts and arrays give one trajectory, births and deaths included": dicts_and_arrays_agree,
    "a horizon truncates every agent": a_horizon_truncates_everyone,
    "returned arrays never change": what_was_handed_out_stays,
    "the same seed gives the same run": the_seed_decides_the_life,
    "a snapshot continues bit for bit": a_snapshot_lives_on,
    "a copy continues bit for bit": a_copy_lives_on,
    "no body leaves the arena or goes through a wall": bodies_stay_inside,
    "the smallest body can reach all of the arena": bodies_reach_everything,
    "every account closes": accounts_close,
    "names are never used again": names_never_return,
    "patches that are gone offer nothing": gone_patches_offer_nothing,
}
