"""TorchRL's wrappers and its collector take every front."""

from __future__ import annotations

import gymnasium
import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import DMControlWrapper, EnvBase, GymEnv, GymWrapper
from torchrl.envs.utils import RandomPolicy, check_env_specs

import hrl_comfort
from hrl_comfort import environment_of
from hrl_comfort.envs.torchrl import CellEnv

ID = "hrl_comfort.gym:hrl_comfort/Reach-v0"
SHORT = {"human": "arc", "task.max_episode_steps": 20}
MAKERS = {
    "GymEnv": lambda: GymEnv(ID, **SHORT),
    "GymWrapper": lambda: GymWrapper(gymnasium.make(ID, **SHORT)),
    "GymWrapper of a batch": lambda: GymWrapper(gymnasium.make_vec(ID, num_envs=3, **SHORT)),
    "DMControlWrapper": lambda: DMControlWrapper(hrl_comfort.load("reach", **SHORT)),
    "CellEnv": lambda: CellEnv(environment_of("reach", SHORT), 3, 0),
}


@pytest.fixture(params=list(MAKERS))
def env(request: pytest.FixtureRequest) -> EnvBase:
    made: EnvBase = MAKERS[request.param]()
    return made


@pytest.mark.filterwarnings("ignore:.*(Specs|VecGymEnvTransform)")
def test_seeds_repeat_and_specs_hold(env: EnvBase) -> None:
    drawn = []
    for seed in (0, 1, 0):
        env.set_seed(seed)
        drawn.append(torch.cat([value.double().flatten() for value in observations(env)]))
    assert (drawn[0] == drawn[2]).all() and (drawn[0] != drawn[1]).any()
    # Last, because TorchRL's next reset of a batch draws no episodes where only some of its rows have ended.
    check_env_specs(env)


def observations(env: EnvBase) -> list[torch.Tensor]:
    start = env.reset()
    names = [name for name in start.keys() if name in ("observation", "human")]  # noqa: SIM118
    return [start[name] for name in names]


def test_a_collector_runs_over_the_ends_of_episodes(env: EnvBase) -> None:
    collector = Collector(env, RandomPolicy(env.action_spec), frames_per_batch=24, total_frames=48)
    batches = [batch.clone() for batch in collector]
    assert len(batches) == 2
    for batch in batches:
        assert batch["next", "reward"].isfinite().all() and batch["next", "done"].any()
    collector.shutdown()


def test_the_true_last_observation_of_a_batch_is_kept() -> None:
    env = MAKERS["GymWrapper of a batch"]()
    env.set_seed(0)
    run = env.rollout(5, auto_reset=True, break_when_any_done=False)
    ended = run["next", "done"][..., :-1, 0]
    assert ended.any()
    rows, times = torch.nonzero(ended, as_tuple=True)
    assert (run["next", "observation"][rows, times] != run["observation"][rows, times + 1]).any(dim=-1).all()
