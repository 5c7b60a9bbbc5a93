"""The command of the fingers: from the last number of an action to controls of the hand's drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
CLOSING_S = 0.2
"""Shortest time in which the set-point of the fingers goes from open to closed."""


class Fingers:
    """Set-points of the fingers of N hands; 0 is open, 1 closed."""

    def __init__(self, scene: Scene) -> None:
        self._open, self._closed = scene.model.actuator_ctrlrange[len(scene.joints)]

    def follow(self, before: Array, command: Array) -> Array:
        """Return the set-points (N,) after a control step, from `before` (N,) towards commands (N,) in [-1, 1]."""
        most = CONTROL_STEP_S / CLOSING_S
        way = np.clip((command + 1) / 2 - before, -most, most)
        return np.clip(before + way, 0.0, 1.0)

    def ramp(self, before: Array, after: Array, steps: int) -> Array:
        """Return controls (N, steps, 1) of the drive, on the way from set-points `before` (N,) to `after` (N,)."""
        share = np.arange(1, steps + 1) / steps
        closing = before[:, None] + share * (after - before)[:, None]
        control: Array = (self._open + (self._closed - self._open) * closing)[..., None]
        return control
