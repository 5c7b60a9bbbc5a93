"""Returns over several choices before the value of the next observation counts (Sutton 1988: n-step returns)."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase


class NStepReturns:
    """Transitions over up to `n_step` choices in each of `num_envs` environments, fewer at the end of an episode.

    Of the transitions that are joined, the reward is the sum of theirs, each discounted by `gamma` a control step since
    the first began, `steps_to_next_obs` their length, and `next` otherwise that of the last.
    """

    def __init__(self, n_step: int, gamma: float, num_envs: int) -> None:
        self.n_step, self._gamma = n_step, gamma
        self._count = torch.zeros(num_envs, dtype=torch.int64)
        """(N,) transitions of each environment that are not complete."""
        self._waiting: TensorDictBase | None = None
        """(N, n_step): these, oldest first; what comes after the first `_count` has no meaning."""

    def __call__(self, transitions: TensorDictBase) -> TensorDictBase:
        """Return the transitions (G,) that are complete with `transitions` (F,), at most one of an environment."""
        if self.n_step == 1 or not len(transitions):
            return transitions
        rows, slots, each = transitions["row"], torch.arange(self.n_step), torch.arange(len(transitions))
        if self._waiting is None:
            self._waiting = transitions[:1, None].expand(1, self.n_step).repeat(len(self._count), 1)
        count, after, waiting = self._count[rows], transitions["next"], self._waiting[rows]
        length = waiting["steps_to_next_obs"]
        reward = waiting["next", "reward"] + self._gamma**length * after["reward"][:, None]
        waiting["next"] = after[:, None].repeat(1, self.n_step)
        waiting["next", "reward"] = reward
        waiting["steps_to_next_obs"] = length + transitions["steps_to_next_obs"][:, None]
        waiting[each, count] = transitions
        count, done = count + 1, after["done"].reshape(-1)
        leaving = torch.where(done, count, (count == self.n_step).long())
        complete = waiting[slots < leaving[:, None]]
        order = (slots + leaving[:, None]) % self.n_step
        self._waiting[rows], self._count[rows] = waiting[each[:, None], order], count - leaving
        return complete

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as plain data."""
        return {"count": self._count, "waiting": {} if self._waiting is None else self._waiting.to_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self._count, waiting = state["count"], state["waiting"]
        size = [len(self._count), self.n_step]
        self._waiting = TensorDict.from_dict(waiting, batch_size=size, auto_batch_size=False) if waiting else None
