"""Compiled twins of the functions of `human`; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.humans.body import UPPER_ARM_M

Array = NDArray[np.float64]


@kernel
def limb_poses(
    x: Array, y: Array, waves: Array, arms: Array, directions: Array, floor_z: float, side: Array, top: Array,
    swing: Array, sinks_m: float,
) -> Array:  # fmt: skip
    """See `human.limb_poses`: of n people.

    `waves` (7, n) are cosines of yaw, yaw / 2, angle and angle / 2, sines of yaw, yaw / 2 and angle / 2, `arms` (n, 2)
    the sines of the upper arms' angles.
    """
    n = len(x)
    poses = np.empty((n, 7, 7))
    for m in range(n):
        cos, cos_half, cos_angle, cos_swung, sin, sin_half, sin_swung = waves[:, m]
        sink = sinks_m * (1 - cos_angle)
        for limb in range(7):
            at = poses[m, limb]
            upright, leaning = 1.0 if swing[limb] == 0.0 else cos_swung, sin_swung * swing[limb]
            at[0], at[1] = x[m] - side[limb] * sin, y[m] + side[limb] * cos
            at[2] = floor_z + top[limb] - sink
            at[3], at[4], at[5], at[6] = cos_half * upright, -sin_half * leaning, cos_half * leaning, sin_half * upright
        for arm in range(2):
            forward, at = -UPPER_ARM_M * arms[m, arm], poses[m, 5 + arm]
            at[0] += cos * forward
            at[1] += sin * forward
            at[2] -= UPPER_ARM_M * cos_angle
        for limb in range(6):
            dx, dy, dz = directions[m, limb]
            if not math.isfinite(dx):
                continue
            w, p, q = 1 - dz, sin * dx + cos * dy, sin * dy - cos * dx
            size, at = math.sqrt(w * w + p * p + q * q), poses[m, 1 + limb]
            if size > 1e-6:
                size = max(size, 1e-12)
                at[3], at[4], at[5], at[6] = w / size, p / size, q / size, 0 * dz / size
            else:
                at[3], at[4], at[5], at[6] = 0.0, 1.0, 0.0, 0.0
        for arm in range(2):
            dx, dy, dz = directions[m, 2 + arm]
            shoulder, elbow = poses[m, 3 + arm], poses[m, 5 + arm]
            if math.isfinite(dx):
                elbow[0] = shoulder[0] + UPPER_ARM_M * (cos * dx - sin * dy)
            if math.isfinite(dy):
                elbow[1] = shoulder[1] + UPPER_ARM_M * (sin * dx + cos * dy)
            if math.isfinite(dz):
                elbow[2] = shoulder[2] + UPPER_ARM_M * dz
    return poses
