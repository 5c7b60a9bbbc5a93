"""Ratings of the arms: what set-points may ask of them, and how they brake.

The set-points of the joints form a path. Its velocity changes by at most the rated acceleration, and speed limits
scale the time in which the path is run, not its direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.safety.geometry import ArmGeometry, ArmPose

Array = NDArray[np.float64]
ROUNDING = 1e-9


@dataclass(frozen=True)
class Rating:
    """Limits of set-points; joints in order."""

    speed_rad_s: Array
    """(J,) largest joint speed."""
    acceleration_rad_s2: Array
    """(J,) largest change of a joint's speed in a second, in braking too."""
    tool_speed_m_s: float
    """Largest speed of any point of the arm."""

    def stopping_time(self, velocity: Array) -> Array:
        """Return the time (N,) s in which the rated brake takes joint velocities (N, J) rad/s to rest."""
        slowest: Array = (np.abs(velocity) / self.acceleration_rad_s2).max(axis=1)
        return slowest

    def brake(self, velocity: Array) -> Array:
        """Return the velocity (N, J) rad/s after one control step of rated braking, along its direction."""
        left = 1 - CONTROL_STEP_S / np.maximum(self.stopping_time(velocity), CONTROL_STEP_S)
        return velocity * left[:, None]

    def limited(self, arm: ArmGeometry, pose: ArmPose, asked: Array) -> Array:
        """Return `asked` (N, J) rad/s slowed in time to the limits of joint and tool speed."""
        over = (np.abs(asked) / self.speed_rad_s).max(axis=1)
        asked = asked / np.maximum(over, 1.0)[:, None]
        fastest = arm.speeds(pose, asked).max(axis=0) + arm.bending(asked).max(axis=0) * CONTROL_STEP_S
        return asked / np.maximum(fastest / self.tool_speed_m_s, 1.0)[:, None]

    def follow(self, before: Array, wanted: Array) -> Array:
        """Return the velocity (N, J) rad/s of the next control step, on the way from `before` to `wanted` (N, J)."""
        change = wanted - before
        needed = (np.abs(change) / self.acceleration_rad_s2).max(axis=1) / CONTROL_STEP_S
        return before + change / np.maximum(needed, 1.0)[:, None]

    def within(self, low: Array, high: Array, angles: Array, velocity: Array) -> Array:
        """Return `velocity` (N, J) rad/s slowed so that every joint can still brake inside its range.

        `angles` (N, J) rad are those before the control step, `low` and `high` (J,) rad the range.
        """
        room = np.where(velocity > 0, high - angles, angles - low)
        half = self.acceleration_rad_s2 * CONTROL_STEP_S / 2
        fastest = np.sqrt(np.maximum(half * half + 2 * self.acceleration_rad_s2 * room, 0.0)) - half
        share = np.where(np.abs(velocity) > fastest, fastest / np.maximum(np.abs(velocity), ROUNDING), 1.0)
        return velocity * np.maximum(share, 0.0).min(axis=1)[:, None]

    def way(self, velocity: Array) -> Array:
        """Return the way (N, J) rad of arms that run `velocity` (N, J) rad/s for a control step, and brake then."""
        steps = np.maximum(self.stopping_time(velocity) / CONTROL_STEP_S, ROUNDING)
        whole = np.floor(steps)
        return velocity * (CONTROL_STEP_S * (1 + whole * (2 * steps - whole - 1) / (2 * steps)))[:, None]

    def keeps(self, low: Array, high: Array, angles: Array, velocity: Array) -> NDArray[np.bool_]:
        """Return (N,) whether joints at `angles` (N, J) rad stay between `low` and `high` (J,).

        They run `velocity` (N, J) rad/s for a control step, and brake then. The brake slows all joints together, so
        that one may need more room than it would alone.
        """
        end: Any = angles + self.way(velocity)
        inside: NDArray[np.bool_] = ((end > low - ROUNDING) & (end < high + ROUNDING)).all(axis=1)
        return inside
