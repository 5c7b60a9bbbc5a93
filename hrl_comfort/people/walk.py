"""A walk in progress, and what every motion model is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import HumanConfig

Array = NDArray[np.float64]

FAR_AWAY_M = 50.0
"""x of a human who is not there."""
NOISE = 3
"""Uniform [0, 1) numbers a motion may use each control step."""
CONTROL_STEP_S = 0.02
STRIDE_M = 1.4
"""Ground covered by one gait cycle (two steps) of an adult."""
FULL_SWING_RAD, FULL_SWING_SPEED_M_S = np.radians(25.0), 1.0
SPEED_SMOOTHING = 0.05
"""Weight of the newest step in the low-passed speed that drives the gait."""
MARGIN_M = 1e-6


@dataclass(frozen=True)
class Walk:
    """Where n people are: position (n, 2) m, yaw (n,) rad, spawn (n, 2) m, and their gait."""

    position: Array
    yaw: Array
    spawn: Array
    walked_m: Array
    """(n,) ground covered."""
    speed_m_s: Array
    """(n,) low-passed."""
    step: NDArray[np.int64]
    """(n,) control steps walked."""

    def rows(self, index: Any) -> Walk:
        """Return the walks of the rows `index` selects."""
        return Walk(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def put(self, index: Any, other: Walk) -> Walk:
        """Return a walk whose rows at `index` are `other`'s."""
        replaced = {}
        for field in fields(self):
            value = getattr(self, field.name).copy()
            value[index] = getattr(other, field.name)
            replaced[field.name] = value
        return Walk(**replaced)


Motion = Callable[[HumanConfig, Walk, Array, Array], tuple[Array, Array]]
"""(config, walk, noise (n, NOISE), tcp (n, 2)) -> proposed position (n, 2) m and yaw (n,) rad, one step on."""


@dataclass(frozen=True)
class KeepOut:
    """Discs nobody walks into: centres (n, g, 2) m and their radius."""

    centres: Array
    radius_m: float

    def entered(self, position: Array) -> NDArray[np.bool_]:
        """Return (n,) whether position (n, 2) lies in any disc."""
        if not self.centres.shape[1]:
            return np.zeros(len(position), dtype=bool)
        return (np.linalg.norm(position[:, None] - self.centres, axis=-1) < self.radius_m).any(axis=1)


def facing_base(position: Array) -> Array:
    """Return the yaw (n,) rad that faces the robot's base from position (n, 2)."""
    return np.arctan2(-position[:, 1], -position[:, 0])


def outside(position: Array, keep_out: KeepOut) -> Array:
    """Return position (n, 2) moved out of every disc by the least push, disc after disc until none is entered."""
    position = position.copy()
    rows = np.arange(len(position))
    for _ in range(50):
        if not keep_out.centres.shape[1]:
            return position
        offsets = position[:, None] - keep_out.centres
        distances = np.linalg.norm(offsets, axis=-1)
        nearest = distances.argmin(axis=1)
        least, offset = distances[rows, nearest], offsets[rows, nearest]
        inside = least < keep_out.radius_m
        if not inside.any():
            return position
        towards = np.where(least[:, None] > MARGIN_M, offset / np.maximum(least, MARGIN_M)[:, None], [1.0, 0.0])
        pushed = keep_out.centres[rows, nearest] + towards * (keep_out.radius_m + MARGIN_M)
        position[inside] = pushed[inside]
    raise RuntimeError(f"no way out of the keep-out discs of {keep_out.radius_m} m for {position[inside].tolist()}")


def gait(walk: Walk) -> tuple[Array, Array]:
    """Return phase (n,) rad and swing amplitude (n,) rad of the limbs."""
    swing = FULL_SWING_RAD * np.minimum(walk.speed_m_s / FULL_SWING_SPEED_M_S, 1.0)
    return 2 * np.pi * walk.walked_m / STRIDE_M, swing
