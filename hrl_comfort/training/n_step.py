"""Returns over several options before the value of the next observation counts (Sutton 1988: n-step returns)."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase


class NStepReturns:
    """Joins each transition of an environment with the `steps` - 1 that follow it there, or up to the episode's end.

    Its reward is then the sum of their rewards, each discounted by `gamma` a control step since its beginning,
    `steps_to_next_obs` their length, and `next` otherwise that of the last of them.
    """

    def __init__(self, steps: int, gamma: float, rows: int) -> None:
        self.steps, self._gamma = steps, gamma
        self._count = torch.zeros(rows, dtype=torch.int64)
        """(N,) transitions of each environment that wait for others."""
        self._waiting: TensorDictBase | None = None
        """(N, steps): they, oldest first, in the state in which they are."""

    def __call__(self, ended: TensorDictBase) -> TensorDictBase:
        """Return the transitions (G,) that are complete with those of `ended` (F,), at most one of an environment."""
        if self.steps == 1 or not len(ended):
            return ended
        rows, places = ended["row"], torch.arange(self.steps)
        if self._waiting is None:
            self._waiting = ended[:1, None].expand(1, self.steps).repeat(len(self._count), 1)
        count, after, waiting = self._count[rows], ended["next"], self._waiting[rows]
        begun = waiting["steps_to_next_obs"]
        reward = waiting["next", "reward"] + self._gamma**begun * after["reward"][:, None]
        waiting["next"] = after[:, None].repeat(1, self.steps)
        waiting["next", "reward"] = reward
        waiting["steps_to_next_obs"] = begun + ended["steps_to_next_obs"][:, None]
        waiting[torch.arange(len(rows)), count] = ended
        count, done = count + 1, after["done"].reshape(-1)
        leaving = torch.where(done, count, (count == self.steps).long())
        complete = waiting[places < leaving[:, None]]
        onward = (places + leaving[:, None]) % self.steps
        self._waiting[rows], self._count[rows] = waiting[torch.arange(len(rows))[:, None], onward], count - leaving
        return complete

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as plain data."""
        return {"count": self._count, "waiting": {} if self._waiting is None else self._waiting.to_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self._count, waiting = state["count"], state["waiting"]
        size = [len(self._count), self.steps]
        self._waiting = TensorDict.from_dict(waiting, batch_size=size, auto_batch_size=False) if waiting else None
