"""Other people's learners live in the world: each trains some hundred steps among births and deaths."""

import sys

import gymnasium
import numpy as np
import pytest

import ecology
from ecology import scenarios
from ecology.fixed import FixedSlots

SCENARIO = "predator_prey"
ALONE = "ecology/paper-v0"  # a scenario of one agent
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
    return FixedSlots(ecology.parallel_env(scenario, horizon=HORIZON), **options)


def weights(*modules):
    """Return a copy of all weights, in one vector."""
    import torch

    return torch.cat([value.detach().flatten().clone() for m in modules for value in m.parameters()])


def has_learned(before, after):
    """Return whether weights changed and are finite."""
    return bool(after.isfinite().all()) and not before.equal(after)


class Counting(gymnasium.Wrapper):
    """Counts the ticks in which a closed action was asked for, of all."""

    ticks = closed = 0

    def step(self, action):
        """Advance one tick."""
        told = self.env.step(action)
        self.ticks, self.closed = self.ticks + 1, self.closed + told[-1]["closed"]
        return told


def test_a_single_file_ppo():
    """A PPO of one file, as CleanRL's, learns in Gymnasium's vector environment, and asks for open actions only."""
    import torch
    from torch import nn

    torch.manual_seed(0)
    envs = gymnasium.make_vec(ALONE, num_envs=4, vectorization_mode="sync", horizon=HORIZON)
    inputs, count = envs.single_observation_space.shape[0], int(envs.single_action_space.n)
    actor = nn.Sequential(nn.Linear(inputs, 32), nn.Tanh(), nn.Linear(32, count))
    critic = nn.Sequential(nn.Linear(inputs, 32), nn.Tanh(), nn.Linear(32, 1))
    optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=1e-3)
    before = weights(actor, critic)

    def policy(zeta, mask):
        """Return the distribution over open actions."""
        return torch.distributions.Categorical(logits=actor(zeta).masked_fill(~mask, -1e9))

    zeta, infos = envs.reset(seed=0)
    closed = ended = 0
    for _ in range(EPISODES):
        steps = []
        for _ in range(HORIZON):
            seen, mask = torch.as_tensor(zeta), torch.as_tensor(infos["action_mask"] > 0)
            with torch.no_grad():
                chosen = policy(seen, mask).sample()
                log = policy(seen, mask).log_prob(chosen)
            zeta, reward, _, truncated, infos = envs.step(chosen.numpy())
            closed += infos["closed"].sum()
            ended += truncated.sum()
            steps.append((seen, mask, chosen, log, torch.as_tensor(reward, dtype=torch.float32)))
        seen, mask, chosen, log, reward = (torch.stack(part) for part in zip(*steps, strict=True))
        gains, total = torch.zeros_like(reward), torch.zeros(4)
        for t in reversed(range(HORIZON)):
            gains[t] = total = reward[t] + 0.99 * total
        for _ in range(2):
            value = critic(seen)[..., 0]
            ratio = (policy(seen, mask).log_prob(chosen) - log).exp()
            advantage = (gains - value).detach()
            surrogate = torch.minimum(ratio * advantage, ratio.clamp(0.8, 1.2) * advantage)
            optimiser.zero_grad()
            ((gains - value).square().mean() - surrogate.mean()).backward()
            optimiser.step()
    envs.close()
    assert closed == 0
    assert ended > 0
    assert has_learned(before, weights(actor, critic))


def test_stable_baselines3_alone():
    """MaskablePPO of sb3-contrib learns in a world of one agent, and asks for open actions only."""
    contrib = library("sb3_contrib", "sb3")
    env = Counting(ecology.gym_env(scenarios.load("paper"), horizon=HORIZON))
    learner = contrib.MaskablePPO("MlpPolicy", env, n_steps=HORIZON, batch_size=50, n_epochs=2, seed=0, device="cpu")
    before = weights(learner.policy)
    learner.learn(EPISODES * HORIZON)
    assert (env.ticks, env.closed) == (EPISODES * HORIZON, 0)
    assert has_learned(before, weights(learner.policy))


def test_stable_baselines3():
    """PPO of Stable-Baselines3 learns, through SuperSuit, one policy for all slots of all species."""
    sb3, supersuit = library("stable_baselines3", "sb3"), library("supersuit", "sb3")
    sb3.common.utils.set_random_seed(0)
    world = slots(flatten=True, pad=True)
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

    register_env("ecology", lambda _: ParallelPettingZooEnv(slots(flatten=True)))
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
        width = env.observation_spec[group, "observation", "observation"].shape[-1]
        return MultiAgentMLP(width, outputs, len(env.group_map[group]), centralised=False, share_params=True)

    actors, losses = {}, {}
    for group in env.group_map:
        count = env.observation_spec[group, "action_mask"].shape[-1]
        actor = ProbabilisticActor(
            TensorDictModule(network(group, count), [(group, "observation", "observation")], [(group, "logits")]),
            in_keys={"logits": (group, "logits"), "mask": (group, "action_mask")},
            out_keys=[(group, "action")],
            distribution_class=MaskedCategorical,
            return_log_prob=True,
            log_prob_key=(group, "log_prob"),
        )
        critic = TensorDictModule(network(group, 1), [(group, "observation", "observation")], [(group, "value")])
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


@pytest.mark.filterwarnings("ignore")  # BenchMARL's and TorchRL's own
def test_benchmarl(tmp_path, monkeypatch):
    """MAPPO of BenchMARL learns one policy per species, with masks."""
    library("benchmarl", "benchmarl")
    import torch
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments.common import TaskClass
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper

    class EcologyTask(TaskClass):
        """The world as a task of BenchMARL."""

        def get_env_fun(self, num_envs, continuous_actions, seed, device):
            return lambda: PettingZooWrapper(
                slots(names=False), categorical_actions=True, done_on_any=False, seed=seed, device=device
            )

        def supports_continuous_actions(self):
            return False

        def supports_discrete_actions(self):
            return True

        def has_render(self, env):
            return False

        def max_steps(self, env):
            return HORIZON

        def group_map(self, env):
            return env.group_map

        def state_spec(self, env):
            return None

        def info_spec(self, env):
            return None

        def _only(self, env, key):
            spec = env.observation_spec.clone()
            for group in env.group_map:
                for other in list(spec[group].keys()):
                    if other != key:
                        del spec[group][other]
            return spec

        def action_mask_spec(self, env):
            return self._only(env, "action_mask")

        def observation_spec(self, env):
            return self._only(env, "observation")

        def action_spec(self, env):
            return env.full_action_spec

        @staticmethod
        def env_name():
            return "ecology"

    EcologyTask.__qualname__ = "EcologyTask"  # BenchMARL pickles it
    monkeypatch.setattr(sys.modules[__name__], "EcologyTask", EcologyTask, raising=False)
    config = ExperimentConfig.get_from_yaml()
    config.max_n_iters, config.evaluation, config.render, config.loggers = EPISODES, False, False, []
    config.create_json, config.save_folder = False, str(tmp_path)
    config.on_policy_collected_frames_per_batch = config.on_policy_minibatch_size = HORIZON
    config.on_policy_n_envs_per_worker, config.on_policy_n_minibatch_iters = 1, 2
    model = MlpConfig(num_cells=[32], activation_class=torch.nn.Tanh, layer_class=torch.nn.Linear)
    experiment = Experiment(
        EcologyTask("predator_prey", {}), MappoConfig.get_from_yaml(), model, 0, config, critic_model_config=model
    )
    before = weights(experiment.policy)
    experiment.run()
    assert experiment.total_frames == EPISODES * HORIZON
    assert has_learned(before, weights(experiment.policy))


@pytest.mark.filterwarnings("ignore")  # Tianshou's own
def test_tianshou():
    """DQN of Tianshou learns, agent by agent, and asks for open actions only."""
    library("tianshou", "tianshou")
    import torch
    from pettingzoo.utils.conversions import parallel_to_aec
    from tianshou.algorithm import DQN
    from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
    from tianshou.algorithm.multiagent.marl import MultiAgentOffPolicyAlgorithm
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv, PettingZooEnv
    from tianshou.trainer import OffPolicyTrainerParams
    from tianshou.utils.net.common import Net

    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002  (Tianshou explores by it)
    world = slots(pad=True, names=False)
    env = PettingZooEnv(parallel_to_aec(world))
    zeta = env.observation_space["observation"]

    def learner():
        """Return a learner for one slot."""
        model = Net(state_shape=zeta.shape, action_shape=env.action_space.n, hidden_sizes=[32])
        policy = DiscreteQLearningPolicy(
            model=model, action_space=env.action_space, observation_space=zeta, eps_training=0.1
        )
        return DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), target_update_freq=10)

    algorithm = MultiAgentOffPolicyAlgorithm(algorithms=[learner() for _ in env.agents], env=env)
    before = weights(algorithm.policy)
    vector = DummyVectorEnv([lambda: env])
    collector = Collector(algorithm, vector, VectorReplayBuffer(5000, 1), exploration_noise=True)
    algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=20 * len(env.agents),
            collection_step_num_env_steps=10 * len(env.agents),
            update_step_num_gradient_steps_per_sample=0.02,
            multi_agent_return_reduction=lambda returns: returns.mean(axis=1),
            verbose=False,
            show_progress=False,
        )
    )
    assert world.env.state_view.tick >= 20
    assert not world.env.state_view.closed.any()
    assert has_learned(before, weights(algorithm.policy))


@pytest.mark.filterwarnings("ignore")  # skrl's own
def test_skrl(tmp_path):
    """MAPPO of skrl learns, with the world's state for its critics."""
    library("skrl", "skrl")
    import torch
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import CategoricalMixin, DeterministicMixin, Model
    from skrl.multi_agents.torch.mappo import MAPPO, MAPPO_CFG
    from skrl.trainers.torch import SequentialTrainer
    from torch import nn

    torch.manual_seed(0)
    env = wrap_env(slots(flatten=True), wrapper="pettingzoo")
    names = env.possible_agents

    class Actor(CategoricalMixin, Model):
        """A policy that sees the observation, and the mask as a part of it."""

        def __init__(self, name):
            spaces = env.observation_space(name), env.state_space(name), env.action_space(name)
            Model.__init__(self, observation_space=spaces[0], state_space=spaces[1], action_space=spaces[2])
            CategoricalMixin.__init__(self, unnormalized_log_prob=True)
            self.net = nn.Sequential(nn.Linear(self.num_observations, 32), nn.Tanh(), nn.Linear(32, self.num_actions))

        def compute(self, inputs, role):
            seen = inputs["observations"]
            return self.net(seen).masked_fill(seen[:, -self.num_actions :] == 0, -1e9), {}

    class Critic(DeterministicMixin, Model):
        """A value of the world's state."""

        def __init__(self, name):
            spaces = env.observation_space(name), env.state_space(name), env.action_space(name)
            Model.__init__(self, observation_space=spaces[0], state_space=spaces[1], action_space=spaces[2])
            DeterministicMixin.__init__(self)
            self.net = nn.Sequential(nn.Linear(self.num_states, 32), nn.Tanh(), nn.Linear(32, 1))

        def compute(self, inputs, role):
            return self.net(inputs["states"]), {}

    models = {name: {"policy": Actor(name), "value": Critic(name)} for name in names}
    nothing = {name: {} for name in names}  # skrl 2.1.1 takes an empty dict for one without its agents
    fields = ("learning_rate_scheduler", "observation_preprocessor", "state_preprocessor", "value_preprocessor")
    config = MAPPO_CFG(
        rollouts=HORIZON, learning_epochs=2, mini_batches=1, **{f"{field}_kwargs": nothing for field in fields}
    )
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    config.experiment.directory = str(tmp_path)
    agent = MAPPO(
        possible_agents=names,
        models=models,
        memories={name: RandomMemory(memory_size=HORIZON, num_envs=1) for name in names},
        observation_spaces=env.observation_spaces,
        state_spaces=env.state_spaces,
        action_spaces=env.action_spaces,
        cfg=config,
    )
    parts = [part for pair in models.values() for part in pair.values()]
    before = weights(*parts)
    quiet = {"close_environment_at_exit": False}
    trainer = SequentialTrainer(env=env, agents=agent, cfg={"timesteps": HORIZON, "disable_progressbar": True, **quiet})
    trainer.train()
    assert has_learned(before, weights(*parts))
