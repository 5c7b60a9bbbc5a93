"""Disturbances, once an episode.

`drop`: the first object picked is knocked out of the gripper and lies where it lay. `block`: a person stands at
the place where the first object belongs, and walks on after BLOCK_STEPS.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.config import DISTURBANCES
from hrl_comfort.config.checks import one_of
from hrl_comfort.humans import Walk
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]
HELD = (2, 5)
"""`drop`: smallest and largest number of decisions, the pick included, after which the object is lost."""
BLOCK_STEPS = 400
"""`block`: control steps (8 s) for which the person stands there."""


class Disturbance:
    """Disturbance of the episodes of `rows` cells; `kind` is one of DISTURBANCES."""

    def __init__(self, kind: str, rows: int) -> None:
        one_of("disturbance", kind, DISTURBANCES)
        self.kind = kind
        self._left = np.zeros(rows, dtype=np.int64)

    def begin(self, row: int, drop: Array, keep_out_m: float, rng: np.random.Generator) -> Array | None:
        """Begin an episode in `row`, whose first object belongs at `drop` (3,) m.

        Draw when the object will be lost, or return where (2,) m the person stands in the way.
        """
        if self.kind == "drop":
            self._left[row] = rng.integers(HELD[0], HELD[1] + 1)
        return blocking_place(drop[:2], keep_out_m) if self.kind == "block" else None

    def applied(self, state: State, task: Subtask) -> State:
        """Return the state after a decision with the objects knocked out of the gripper back where they arrived."""
        if self.kind != "drop":
            return state
        held = task.releasing(state.stage).numpy()
        self._left[held] -= 1
        lost = torch.from_numpy(held & (self._left == 0))
        return state.with_(stage=state.stage - lost.long())

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        return {"left": torch.from_numpy(self._left.copy())}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self._left = saved["left"].numpy().copy()

    def walked(self, before: Walk, after: Walk, steps: NDArray[np.int64]) -> Walk:
        """Return the walk after the control steps of index `steps` (N,): that `before` them where people stand."""
        if self.kind != "block":
            return after
        standing = np.flatnonzero(steps < BLOCK_STEPS)
        return after.put(standing, before.rows(standing)) if len(standing) else after


def blocking_place(place: Array, keep_out_m: float) -> Array:
    """Return the position (2,) m of a person who blocks the place at (2,) m, behind it for the robot."""
    away: Array = place * (1 + (keep_out_m + 1e-6) / np.linalg.norm(place))
    return away
