"""Transitions that are stored at another comfort level than the one they were made at.

What a motion does to the cell does not depend on the level, only what it is worth: so what is done at one level teaches
the others (hindsight, as of goals in Andrychowicz et al. 2017, arXiv:1707.01495).
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from hrl_comfort.comfort.adapt import TERM, comfort_reward
from hrl_comfort.config import TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.sim.step_result import transitions


class OtherLevels:
    """Levels drawn anew for part of the transitions of an environment, whose policies observe the level."""

    def __init__(self, config: TrainConfig, env: CellEnv) -> None:
        self._share, self._comfort = config.agent.other_level, config.comfort
        self._term = comfort_reward(config.comfort, config.task.max_step_deg)
        self._env, self._comfort_term = env, env.reward_names.index(TERM)
        self._column = env.layout["level"].start
        self.generator = torch.Generator().manual_seed(config.train_seed)

    def relabel(self, stored: TensorDictBase, reward_terms: Tensor) -> None:
        """Put part of the transitions (N,) of the latest decision, of `reward_terms` (N, T), at other levels.

        Demonstrations keep the level they were made for.
        """
        count, levels = len(stored), self._comfort.levels
        drawn = torch.randint(1, levels + 1, (count,), generator=self.generator)
        relabelled = (torch.rand(count, generator=self.generator) < self._share) & ~stored["demonstrated"]
        gain = self._reward(drawn).float() - reward_terms[:, self._comfort_term]
        stored["next", "reward"] = stored["next", "reward"] + torch.where(relabelled, gain, 0.0)[:, None]
        for part in (stored, stored["next"]):
            observation = part["observation"].clone()
            observation[:, self._column] = torch.where(
                relabelled, (drawn - 1) / (levels - 1), observation[:, self._column]
            )
            part["observation"] = observation

    def _reward(self, level: Tensor) -> Tensor:
        """Return the weighted comfort reward (N,) of the latest decision, had the levels (N,) been in force."""
        result = self._env.last
        assert result is not None
        before, after = transitions(result.before, result.moving, result.moving["stage"])
        level = level.to(after.level.dtype)[:, None]
        reward = self._term(before, after.with_(level=level)).masked_fill(~result.valid, 0.0)
        return self._comfort.scale * reward.sum(dim=-1)
