"""Compiled twins of the functions of `human`; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.humans.body import UPPER_ARM_M

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@kernel
def limb_poses(
    x: Array, y: Array, yaw: Array, phase: Array, swing_rad: Array, directions: Array, floor_z: float, side: Array,
    top: Array, swing: Array, sinks_m: float,
) -> Array:  # fmt: skip
    """See `human.limb_poses`: of n people."""
    n = len(x)
    poses = np.empty((n, 7, 7))
    for m in range(n):
        angle = swing_rad[m] * math.sin(phase[m]) if math.isnan(directions[m, 0, 0]) else 0.0
        cos, sin = math.cos(yaw[m]), math.sin(yaw[m])
        cos_half, sin_half = math.cos(yaw[m] / 2), math.sin(yaw[m] / 2)
        cos_angle, sin_angle = math.cos(angle), math.sin(angle)
        cos_swung, sin_swung = math.cos(angle / 2), math.sin(angle / 2)
        sink = sinks_m * (1 - cos_angle)
        for limb in range(7):
            at = poses[m, limb]
            upright, leaning = 1.0 if swing[limb] == 0.0 else cos_swung, sin_swung * swing[limb]
            at[0], at[1] = x[m] - side[limb] * sin, y[m] + side[limb] * cos
            at[2] = floor_z + top[limb] - sink
            at[3], at[4], at[5], at[6] = cos_half * upright, -sin_half * leaning, cos_half * leaning, sin_half * upright
        for arm in range(2):
            forward, at = -UPPER_ARM_M * (swing[3 + arm] * sin_angle), poses[m, 5 + arm]
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


@kernel
def controls(
    targets: Array, limbs: Array, layout: Array, objects: Array, props: Ints, points: Array, spare: int, away_m: float
) -> Array:
    """See `sim.controls.pack_controls`: of objects shown by the `props` (n, B), of `spare` that there are."""
    (n, times, joints), people, still = targets.shape, limbs.shape[1], layout.shape[1]
    steps, bodies = len(limbs) // n, people + still + spare
    control = np.empty((n, times, joints + 7 * bodies))
    pose = np.empty((bodies, 7))
    for m in range(n):
        pose[people : people + still] = layout[m]
        pose[people + still :] = 0.0
        for index in range(people + still, bodies):
            pose[index, 0], pose[index, 3] = away_m, 1.0
        for index in range(points.shape[1]):
            pose[people + still + index, :3] = points[m, index]
        for index in range(0 if points.shape[1] else props.shape[1]):
            pose[people + still + props[m, index], :3] = objects[m, index]
        for time in range(times):
            if time % (times // steps) == 0:
                pose[:people] = limbs[m * steps + time // (times // steps)]
            out = control[m, time]
            out[:joints] = targets[m, time]
            for index in range(bodies):
                for axis in range(3):
                    out[joints + 3 * index + axis] = pose[index, axis]
                for axis in range(4):
                    out[joints + 3 * bodies + 4 * index + axis] = pose[index, 3 + axis]
    return control
