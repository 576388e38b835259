"""Other people's learners live in the world: each trains some hundred steps among births and deaths."""

import pytest

import ecology
import scenarios
from ecology.fixed import FixedSlots

SCENARIO = "predator_prey"
HORIZON = 100  # ticks of an episode
EPISODES = 3


def library(name, extra):
    """Return a library, or skip the test with the reason."""
    return pytest.importorskip(
        name,
        reason=f"{name} is not installed; CONTRIBUTING.md says how to install the extra {extra!r}",
        exc_type=ImportError,
    )


def slots(**options):
    """Return the scenario, with several agents, as a world of a fixed number of slots."""
    scenario = scenarios.load(SCENARIO, prey=8, predators=4, arrival=0.05)
    assert all(species.grows for species in scenario.species)
    return FixedSlots(ecology.parallel_env(scenario, horizon=HORIZON), flatten=True, **options)


def weights(*modules):
    """Return a copy of all weights, in one vector."""
    import torch

    return torch.cat([value.detach().flatten().clone() for m in modules for value in m.state_dict().values()])


def has_learned(before, after):
    """Return whether weights changed and are finite."""
    return bool(after.isfinite().all()) and not before.equal(after)


def test_stable_baselines3():
    """PPO of Stable-Baselines3 learns, through SuperSuit, one policy for all slots of all species."""
    sb3, supersuit = library("stable_baselines3", "sb3"), library("supersuit", "sb3")
    sb3.common.utils.set_random_seed(0)
    world = slots(pad=True)
    one = supersuit.pettingzoo_env_to_vec_env_v1(world)
    many = supersuit.concat_vec_envs_v1(one, 1, base_class="stable_baselines3")
    learner = sb3.PPO("MlpPolicy", many, n_steps=HORIZON, batch_size=HORIZON, n_epochs=2, device="cpu")
    before = weights(learner.policy)
    learner.learn(EPISODES * HORIZON * many.num_envs)
    assert many.num_envs == len(world.possible_agents) > 1
    assert learner.num_timesteps == EPISODES * HORIZON * many.num_envs
    assert has_learned(before, weights(learner.policy))


@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_rllib():
    """PPO of RLlib, new API stack, learns one policy per species."""
    library("ray.rllib", "rllib")
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    register_env("ecology", lambda _: ParallelPettingZooEnv(slots()))
    species = list(slots().env.groups)
    config = (
        PPOConfig()
        .environment("ecology")
        .env_runners(num_env_runners=0)
        .multi_agent(policies=set(species), policy_mapping_fn=lambda agent, *_, **__: agent.partition("_slot_")[0])
        .training(train_batch_size_per_learner=HORIZON, minibatch_size=HORIZON, num_epochs=2)
        .debugging(seed=0)
    )
    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    try:
        learner = config.build_algo()
        before = {name: weights(learner.get_module(name)) for name in species}
        for _ in range(EPISODES):
            result = learner.train()
        assert result["num_env_steps_sampled_lifetime"] == EPISODES * HORIZON
        assert all(has_learned(before[name], weights(learner.get_module(name))) for name in species)
        learner.stop()
    finally:
        ray.shutdown()


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrl():
    """PPO of TorchRL learns one policy per species, which takes open actions only."""
    library("torchrl", "torchrl")
    import torch
    from tensordict.nn import TensorDictModule, TensorDictSequential
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs
    from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor
    from torchrl.objectives import ClipPPOLoss

    torch.manual_seed(0)
    env = PettingZooWrapper(slots(names=False), categorical_actions=True, done_on_any=False)
    check_env_specs(env)

    def network(group, outputs):
        """Return a network shared by the slots of a species."""
        width = env.observation_spec[group, "observation"].shape[-1]
        return MultiAgentMLP(width, outputs, len(env.group_map[group]), centralised=False, share_params=True)

    actors, losses = {}, {}
    for group in env.group_map:
        count = env.observation_spec[group, "action_mask"].shape[-1]
        actor = ProbabilisticActor(
            TensorDictModule(network(group, count), [(group, "observation")], [(group, "logits")]),
            in_keys={"logits": (group, "logits"), "mask": (group, "action_mask")},
            out_keys=[(group, "action")],
            distribution_class=MaskedCategorical,
            return_log_prob=True,
            log_prob_key=(group, "log_prob"),
        )
        critic = TensorDictModule(network(group, 1), [(group, "observation")], [(group, "value")])
        loss = ClipPPOLoss(actor, critic, entropy_bonus=False)
        loss.set_keys(
            action=(group, "action"),
            sample_log_prob=(group, "log_prob"),
            value=(group, "value"),
            reward=(group, "reward"),
            done=(group, "done"),
            terminated=(group, "terminated"),
        )
        loss.make_value_estimator(gamma=0.99)
        actors[group], losses[group] = actor, loss
    policy = TensorDictSequential(*actors.values())
    before = {group: weights(loss) for group, loss in losses.items()}
    optimiser = torch.optim.Adam([weight for loss in losses.values() for weight in loss.parameters()], 1e-3)
    for _ in range(EPISODES):
        with torch.no_grad():
            life = env.rollout(HORIZON, policy)
        assert life.shape == (HORIZON,)
        assert life["next", "done"][-1].all()
        for group in env.group_map:
            opened = life[group, "action_mask"].gather(-1, life[group, "action"][..., None])
            assert opened.all()
            assert not life["next", group, "info", "closed"].any()
        for _ in range(2):
            parts = [loss(life.clone()) for loss in losses.values()]
            optimiser.zero_grad()
            sum(part["loss_objective"] + part["loss_critic"] for part in parts).backward()
            optimiser.step()
    assert all(has_learned(before[group], weights(loss)) for group, loss in losses.items())
