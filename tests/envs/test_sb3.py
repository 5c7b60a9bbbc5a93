"""Stable-Baselines3 takes the Gymnasium ids, and the batched engine as a VecEnv."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize, VecVideoRecorder

from hrl_comfort import environment_of, sb3
from hrl_comfort.config import ConfigError
from hrl_comfort.envs.gymnasium import CellVector
from hrl_comfort.gym import IDS
from tests.envs.pictures import drawn

ID = "hrl_comfort.gym:hrl_comfort/Pick-v0"
SHORT = {"task.max_episode_steps": 40}
SMALL = {"policy_kwargs": {"net_arch": [16]}, "device": "cpu", "seed": 0}
FORKED: dict[str, Any] = {"vec_env_kwargs": {"start_method": "fork"}}
"""Other start methods import torch in every process."""
ZOO = """
hrl_comfort/Pick-v0:
  normalize: {norm_obs: true, norm_reward: false}
  n_envs: 2
  n_timesteps: !!float 64
  policy: MlpPolicy
  learning_rate: !!float 7.3e-4
  buffer_size: 1000
  batch_size: 16
  ent_coef: auto
  gamma: 0.98
  tau: 0.02
  train_freq: 8
  gradient_steps: 2
  learning_starts: 16
  use_sde: true
  policy_kwargs: "dict(log_std_init=-3, net_arch=[16, 16])"
"""
"""Hyperparameters as RL Zoo writes them."""


@pytest.mark.filterwarnings("error")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_its_own_check_has_nothing_to_say() -> None:
    check_env(gymnasium.make(ID))


@pytest.mark.parametrize(
    ("learner", "more"),
    [
        (PPO, {"n_steps": 16, "batch_size": 16, "n_epochs": 1}),
        (TD3, {"learning_starts": 8, "batch_size": 8}),
        (SAC, {"learning_starts": 8, "batch_size": 8}),
    ],
)
def test_a_learner_takes_the_id(learner: type[BaseAlgorithm], more: dict[str, Any], tmp_path: Path) -> None:
    model = learner("MlpPolicy", ID, **SMALL, **more).learn(16)
    model.save(tmp_path / "model")
    again = learner.load(tmp_path / "model", env=model.get_env())
    observation = np.zeros((1, *model.observation_space.shape), np.float32)
    first, second = (each.predict(observation, deterministic=True)[0] for each in (model, again))
    assert (first == second).all()


def test_make_vec_env_takes_the_id_with_and_without_a_seed() -> None:
    seeds = [make_vec_env(ID, n_envs=2, seed=seed, env_kwargs=SHORT).reset() for seed in (1, 1, None, None)]
    assert (seeds[0] == seeds[1]).all() and (seeds[2] != seeds[3]).any()
    env = make_vec_env(ID, n_envs=2)
    env.reset()
    assert env.render_mode == "rgb_array" and drawn(env.render).shape == (720, 480, 3)
    env.close()


def test_environments_of_other_processes_step() -> None:
    env = make_vec_env(ID, n_envs=2, seed=0, env_kwargs=SHORT, vec_env_cls=SubprocVecEnv, **FORKED)
    assert env.reset().shape == (2, env.observation_space.shape[0])
    assert env.step(np.zeros((2, 6)))[1].shape == (2,)
    env.close()


@pytest.mark.parametrize("batched", [False, True])
def test_hyperparameters_of_rl_zoo_train(batched: bool) -> None:
    chosen = yaml.safe_load(ZOO)[IDS["pick"]]
    chosen["policy_kwargs"] = eval(chosen["policy_kwargs"])
    envs, steps, normalise = (chosen.pop(key) for key in ("n_envs", "n_timesteps", "normalize"))
    made = sb3.make_vec_env(ID, envs, **SHORT) if batched else make_vec_env(ID, n_envs=envs, env_kwargs=SHORT)
    model = SAC(env=VecNormalize(made, gamma=chosen["gamma"], **normalise), device="cpu", **chosen)
    model.learn(int(steps))
    assert model.ep_info_buffer and np.isfinite(evaluate_policy(model, model.get_env(), 2)[0])


def test_the_rows_of_the_vec_env_are_those_of_the_vector_environment() -> None:
    env, twin = sb3.make_vec_env(IDS["pick"], 3, seed=5, **SHORT), CellVector(environment_of("pick", SHORT), 3)
    observations, rng, ended = env.reset(), np.random.default_rng(0), 0
    assert (observations == twin.reset(seed=5)[0]).all()
    for _ in range(10):
        actions = rng.uniform(-1, 1, (3, 6)).astype(np.float32)
        observations, rewards, dones, infos = env.step(actions)
        theirs, earned, terminated, truncated, values = twin.step(actions)
        assert (observations == theirs).all() and rewards == pytest.approx(earned, abs=1e-6)
        assert (dones == (terminated | truncated)).all()
        for row in np.flatnonzero(dones):
            ended += 1
            assert (infos[row]["terminal_observation"] == values["final_obs"][row]).all()
            assert infos[row]["TimeLimit.truncated"] == truncated[row] and infos[row]["episode"]["l"] > 0
            assert infos[row]["is_success"] == values["success"][row]
    assert ended


def test_the_vec_env_replays_records_and_refuses(tmp_path: Path) -> None:
    env = sb3.make_vec_env(IDS["pick"], 2, render_mode="rgb_array", **SHORT)
    env.set_options({"episode": 3, "split": "validation"})
    first, second = env.reset()
    assert (first == second).all()
    env.set_options([{"episode": 3, "split": "validation"}, {"split": "validation"}])
    with pytest.raises(ConfigError, match="every row takes an episode"):
        env.reset()
    env.set_options()
    recorder = VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=2)
    drawn(recorder.reset)
    for _ in range(3):
        recorder.step(np.zeros((2, 6)))
    recorder.close()
    assert list(tmp_path.glob("*.mp4"))
    with pytest.raises(AttributeError, match="one batch"):
        env.set_attr("gamma", 1)


def test_other_ids_and_numbers_are_refused() -> None:
    with pytest.raises(ConfigError, match="env_id='CartPole-v1' is not allowed; choose one of hrl_comfort/"):
        sb3.make_vec_env("CartPole-v1")
    with pytest.raises(ConfigError, match="num_envs=0"):
        sb3.make_vec_env(ID, 0)
    with pytest.raises(ConfigError, match="one cell"):
        sb3.make_vec_env(ID, 2, render_mode="human")
    with pytest.raises(TypeError, match="unexpected keyword argument 'vec_env_cls'"):
        sb3.make_vec_env(ID, 2, vec_env_cls=SubprocVecEnv)
