"""Learners of Stable-Baselines3 and sb3-contrib take options, and discount over their durations where asked to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import QRDQN, MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy
from sb3_contrib.common.maskable.utils import get_action_masks
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from hrl_comfort import sb3
from hrl_comfort.config import ConfigError
from hrl_comfort.gym import OPTION_IDS
from hrl_comfort.sb3_buffers import OptionMaskableRolloutBuffer, OptionReplayBuffer, OptionRolloutBuffer

ID = f"hrl_comfort.gym:{OPTION_IDS['sort']}"
QUICK: dict[str, Any] = {"task.max_episode_steps": 120, "human": "none"}
GAMMA = 0.99
SMALL = {"policy_kwargs": {"net_arch": [16]}, "device": "cpu", "seed": 0}
ON: dict[str, Any] = {"n_steps": 8, "batch_size": 8, "n_epochs": 1}
OFF: dict[str, Any] = {"learning_starts": 4, "batch_size": 8, "buffer_size": 100}


@pytest.mark.parametrize(("learner", "more"), [(PPO, ON), (MaskablePPO, ON), (QRDQN, OFF), (DQN, OFF)])
@pytest.mark.parametrize("batched", [False, True])
def test_a_learner_takes_options(learner: type[BaseAlgorithm], more: dict[str, Any], batched: bool) -> None:
    env = sb3.make_vec_env(ID, 2, seed=0, **QUICK) if batched else gymnasium.make(ID, **QUICK)
    model = learner("MlpPolicy", env, **SMALL, **more).learn(16)
    assert model.num_timesteps >= 16 and model.ep_info_buffer


@pytest.mark.parametrize("batched", [False, True])
def test_masks_are_those_of_the_options_that_can_start(batched: bool) -> None:
    env = sb3.make_vec_env(ID, 3, seed=0, **QUICK) if batched else make_vec_env(ID, 3, seed=0, env_kwargs=QUICK)
    env.reset()
    assert get_action_masks(env).shape == (3, env.action_space.n)
    model = MaskablePPO("MlpPolicy", env, **SMALL, **ON)
    for _ in range(6):
        masks = get_action_masks(env)
        actions, _ = model.predict(np.zeros((3, *env.observation_space.shape)), action_masks=masks)
        assert masks[np.arange(3), actions].all()
        *_, infos = env.step(actions)
        assert [info["option"] for info in infos] == actions.tolist()
        assert (np.stack([info["action_mask"] for info in infos]) == get_action_masks(env)).all() or not batched
    assert np.isfinite(evaluate_policy(model, env, 2)[0])


def test_the_rows_of_the_vec_env_are_those_of_the_vector_environment() -> None:
    env, twin = sb3.make_vec_env(ID, 3, seed=5, **QUICK), gymnasium.make_vec(ID, num_envs=3, **QUICK)
    assert (env.reset() == twin.reset(seed=5)[0]).all()
    assert (np.stack([info["action_mask"] for info in env.venv.reset_infos]) == twin.unwrapped.action_masks()).all()
    ended = 0
    for _ in range(8):
        actions = twin.unwrapped.action_masks().argmax(axis=1)
        observations, rewards, dones, infos = env.step(actions)
        theirs, earned, terminated, truncated, values = twin.step(actions)
        assert (observations == theirs).all() and rewards == pytest.approx(earned, abs=1e-6)
        assert (dones == (terminated | truncated)).all()
        for row, info in enumerate(infos):
            assert info["duration"] == values["duration"][row]
            assert (info["action_mask"] == values["action_mask"][row]).all()
            if dones[row]:
                ended += 1
                assert (info["terminal_observation"] == values["final_obs"][row]).all()
    assert ended


def test_a_replay_buffer_discounts_over_the_duration() -> None:
    env = sb3.make_vec_env(ID, 2, seed=0, gamma=GAMMA, **QUICK)
    more = {"replay_buffer_class": OptionReplayBuffer, "replay_buffer_kwargs": {"gamma": GAMMA}}
    model = QRDQN("MlpPolicy", env, **SMALL, **OFF, **more).learn(20)
    buffer = model.replay_buffer
    known = {
        tuple(seen): GAMMA**duration
        for seen, duration in zip(
            buffer.next_observations[: buffer.pos].reshape(-1, *buffer.obs_shape),
            buffer.durations[: buffer.pos].reshape(-1),
            strict=True,
        )
    }
    sample = buffer.sample(32)
    assert len(set(known.values())) > 1 and sample.discounts.shape == (32, 1)
    for seen, discount in zip(sample.next_observations.numpy(), sample.discounts.reshape(-1).tolist(), strict=True):
        assert discount == pytest.approx(known[tuple(seen)], rel=1e-6)


@pytest.mark.parametrize(("learner", "kind"), [(PPO, OptionRolloutBuffer), (MaskablePPO, OptionMaskableRolloutBuffer)])
def test_a_rollout_buffer_discounts_over_the_duration(
    learner: type[BaseAlgorithm], kind: type[RolloutBuffer], tmp_path: Path
) -> None:
    env: VecEnv = sb3.make_vec_env(ID, 2, seed=0, gamma=GAMMA, **QUICK)
    env = VecNormalize(env, norm_reward=False) if learner is PPO else env
    model = learner("MlpPolicy", env, **SMALL, **ON, gamma=GAMMA, gae_lambda=1.0, rollout_buffer_class=kind).learn(16)
    buffer = model.rollout_buffer
    durations = np.log(buffer.discounts) / np.log(GAMMA)
    assert durations == pytest.approx(np.round(durations), abs=1e-2) and len(np.unique(np.round(durations))) > 1
    model.save(tmp_path / "model")
    assert learner.load(tmp_path / "model", env=env).learn(16).num_timesteps >= 16


def rewards_of(values: list[float], durations: list[int]) -> sb3.OptionRewards:
    rewards = np.array(values, np.float32).view(sb3.OptionRewards)
    rewards.plain, rewards.duration, rewards.gamma = np.array(values, np.float32), np.array(durations), GAMMA
    return rewards


def test_returns_of_a_rollout_have_a_closed_form() -> None:
    """Options of 3 and 5 steps earn 1 and 2; the second is truncated where the value is 7, then one of 4 earns 3."""
    space = gymnasium.spaces.Box(-1, 1, (1,)), gymnasium.spaces.Discrete(2)
    buffer = OptionRolloutBuffer(3, *space, device="cpu", gae_lambda=1.0, gamma=GAMMA, n_envs=1)
    nothing = np.zeros((1, 1))
    for paid, steps, bootstrap, start in ((1.0, 3, 0.0, 1), (2.0, 5, 7.0, 0), (3.0, 4, 0.0, 1)):
        rewards = rewards_of([paid], [steps])
        rewards[0] += GAMMA * bootstrap  # as PPO does
        buffer.add(nothing, nothing, rewards, np.array([start]), torch.zeros(1), torch.zeros(1))
    buffer.compute_returns_and_advantage(torch.tensor([[5.0]]), np.array([False]))
    second = 2 + GAMMA**5 * 7
    expected = [1 + GAMMA**3 * second, second, 3 + GAMMA**4 * 5]
    assert buffer.returns.reshape(-1).tolist() == pytest.approx(expected, rel=1e-6)


def test_rewards_without_durations_or_another_gamma_are_refused() -> None:
    learner = {**SMALL, **ON, "gamma": GAMMA, "rollout_buffer_class": OptionRolloutBuffer}
    with pytest.raises(ConfigError, match=r"gamma=0.99 is not that of the environment; give make_vec_env gamma=0.99"):
        PPO("MlpPolicy", sb3.make_vec_env(ID, 2, **QUICK), **learner).learn(16)
    with pytest.raises(ConfigError, match="rewards without durations"):
        PPO("MlpPolicy", VecNormalize(sb3.make_vec_env(ID, 2, **QUICK)), **learner).learn(16)
    with pytest.raises(AttributeError, match="one batch"):
        sb3.make_vec_env(ID, 2, **QUICK).env_method("names")
