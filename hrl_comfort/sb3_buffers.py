"""Buffers with which learners of Stable-Baselines3 discount over the duration of an option (extra `sb3`).

A learner discounts each step by its one `gamma`, however long an option was. With these it raises the gamma of a
control step to the control steps of the option, as a semi-Markov decision process does. Give the environment the same:

    env = make_vec_env("hrl_comfort/Kitting-Options-v0", 16, gamma=0.998)
    QRDQN("MlpPolicy", env, replay_buffer_class=OptionReplayBuffer, replay_buffer_kwargs={"gamma": 0.998})
    PPO("MlpPolicy", env, gamma=0.998, rollout_buffer_class=OptionRolloutBuffer)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from sb3_contrib.common.maskable.buffers import MaskableRolloutBuffer
from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor

from hrl_comfort.config import ConfigError
from hrl_comfort.sb3 import OptionRewards


def checked(reward: np.ndarray, gamma: float) -> OptionRewards:
    """Return the rewards (N,) of options that are discounted by `gamma`; raise ConfigError if they are not."""
    if not isinstance(reward, OptionRewards) or reward.gamma is None:
        raise ConfigError(
            "rewards without durations: take options from hrl_comfort.sb3.make_vec_env, without normalised rewards"
        )
    if reward.gamma != gamma:
        raise ConfigError(f"gamma={gamma} is not that of the environment; give make_vec_env gamma={gamma}")
    return reward


class OptionReplayBuffer(ReplayBuffer):
    """Replay buffer of DQN and QRDQN whose samples hold `gamma ** info["duration"]` as their discounts."""

    def __init__(self, *args: Any, gamma: float, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.gamma = gamma
        self.durations = np.ones((self.buffer_size, self.n_envs), np.float32)
        """(buffer_size, N), control steps."""

    def add(
        self,
        obs: np.ndarray,
        next_obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """Add an option of every row.

        Raises:
          ConfigError: as `OptionRolloutBuffer.add`.
        """
        checked(reward, self.gamma)
        self.durations[self.pos] = [info["duration"] for info in infos]
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds: np.ndarray, env: VecNormalize | None = None) -> ReplayBufferSamples:
        rows = np.random.randint(0, high=self.n_envs, size=len(batch_inds))  # noqa: NPY002, the generator of the library
        at = batch_inds, rows
        following = ((batch_inds + 1) % self.buffer_size, rows)
        after = self.observations[following] if self.optimize_memory_usage else self.next_observations[at]
        data = (
            self._normalize_obs(self.observations[at], env),
            self.actions[at],
            self._normalize_obs(after, env),
            (self.dones[at] * (1 - self.timeouts[at])).reshape(-1, 1),
            self._normalize_reward(self.rewards[at].reshape(-1, 1), env),
            (self.gamma ** self.durations[at]).astype(np.float32).reshape(-1, 1),
        )
        return ReplayBufferSamples(*map(self.to_torch, data))


class _Discounting:
    """A rollout buffer that discounts the value after an option by `gamma` for each of its control steps."""

    gamma: float
    gae_lambda: float

    def reset(self) -> None:
        """Forget the rollout."""
        super().reset()  # type: ignore[misc]
        self.discounts = np.ones((self.buffer_size, self.n_envs), np.float32)  # type: ignore[attr-defined]
        """(n_steps, N) of the next observation."""

    def add(self, obs: np.ndarray, action: np.ndarray, reward: np.ndarray, *args: Any, **kwargs: Any) -> None:
        """Add an option of every row.

        To the rewards of rows that were truncated the learner has added gamma times the value of the last observation.

        Raises:
          ConfigError: the rewards are not those of `hrl_comfort.sb3.make_vec_env`, or its gamma is another one.
        """
        paid = checked(reward, self.gamma)
        discount = self.gamma**paid.duration
        self.discounts[self.pos] = discount  # type: ignore[attr-defined]
        value = (np.asarray(paid) - paid.plain) / self.gamma
        super().add(obs, action, paid.plain + discount * value, *args, **kwargs)  # type: ignore[misc]

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray) -> None:
        """Estimate advantages and returns; `last_values` (N,) follow the last step, `dones` (N,) say where none do."""
        values, rewards, starts = self.values, self.rewards, self.episode_starts  # type: ignore[attr-defined]
        after, goes_on = last_values.cpu().numpy().reshape(-1), 1.0 - dones.astype(np.float32)
        advantage = np.zeros_like(after)
        for step in reversed(range(len(rewards))):
            discount = self.discounts[step] * goes_on
            advantage = rewards[step] + discount * (after + self.gae_lambda * advantage) - values[step]
            self.advantages[step] = advantage  # type: ignore[attr-defined]
            after, goes_on = values[step], 1.0 - starts[step]
        self.returns = self.advantages + values  # type: ignore[attr-defined]


class OptionRolloutBuffer(_Discounting, RolloutBuffer):
    """Rollout buffer of PPO and A2C."""


class OptionMaskableRolloutBuffer(_Discounting, MaskableRolloutBuffer):  # type: ignore[misc]
    """Rollout buffer of MaskablePPO."""
