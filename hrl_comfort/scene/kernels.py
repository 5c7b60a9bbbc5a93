"""Compiled twins of the functions of `human`; see `hrl_comfort.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.humans.body import UPPER_ARM_M
from hrl_comfort.humans.walk import FULL_SWING_RAD, FULL_SWING_SPEED_M_S, STRIDE_M

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@kernel
def pose_limbs(
    poses: Array, x: float, y: float, yaw: float, phase: float, swing_rad: float, directions: Array, floor_z: float,
    side: Array, top: Array, swing: Array, sinks_m: float,
) -> None:  # fmt: skip
    """Fill in the `poses` (7, 7) of one person; see `human.limb_poses`."""
    angle = swing_rad * math.sin(phase) if math.isnan(directions[0, 0]) else 0.0
    cos, sin = math.cos(yaw), math.sin(yaw)
    cos_half, sin_half = math.cos(yaw / 2), math.sin(yaw / 2)
    cos_angle, sin_angle = math.cos(angle), math.sin(angle)
    cos_swung, sin_swung = math.cos(angle / 2), math.sin(angle / 2)
    sink = sinks_m * (1 - cos_angle)
    for limb in range(7):
        at = poses[limb]
        upright, leaning = 1.0 if swing[limb] == 0.0 else cos_swung, sin_swung * swing[limb]
        at[0], at[1] = x - side[limb] * sin, y + side[limb] * cos
        at[2] = floor_z + top[limb] - sink
        at[3], at[4], at[5], at[6] = cos_half * upright, -sin_half * leaning, cos_half * leaning, sin_half * upright
    for arm in range(2):
        forward, at = -UPPER_ARM_M * (swing[3 + arm] * sin_angle), poses[5 + arm]
        at[0] += cos * forward
        at[1] += sin * forward
        at[2] -= UPPER_ARM_M * cos_angle
    for limb in range(6):
        dx, dy, dz = directions[limb]
        if not math.isfinite(dx):
            continue
        w, p, q = 1 - dz, sin * dx + cos * dy, sin * dy - cos * dx
        size, at = math.sqrt(w * w + p * p + q * q), poses[1 + limb]
        if size > 1e-6:
            size = max(size, 1e-12)
            at[3], at[4], at[5], at[6] = w / size, p / size, q / size, 0 * dz / size
        else:
            at[3], at[4], at[5], at[6] = 0.0, 1.0, 0.0, 0.0
    for arm in range(2):
        dx, dy, dz = directions[2 + arm]
        shoulder, elbow = poses[3 + arm], poses[5 + arm]
        if math.isfinite(dx):
            elbow[0] = shoulder[0] + UPPER_ARM_M * (cos * dx - sin * dy)
        if math.isfinite(dy):
            elbow[1] = shoulder[1] + UPPER_ARM_M * (sin * dx + cos * dy)
        if math.isfinite(dz):
            elbow[2] = shoulder[2] + UPPER_ARM_M * dz


@kernel
def limb_poses(
    x: Array, y: Array, yaw: Array, phase: Array, swing_rad: Array, directions: Array, floor_z: float, side: Array,
    top: Array, swing: Array, sinks_m: float,
) -> Array:  # fmt: skip
    """See `human.limb_poses`: of n people."""
    poses = np.empty((len(x), 7, 7))
    for m in range(len(x)):
        pose_limbs(
            poses[m], x[m], y[m], yaw[m], phase[m], swing_rad[m], directions[m], floor_z, side, top, swing, sinks_m
        )
    return poses


@kernel
def walkers_limbs(
    position: Array, yaw: Array, walked_m: Array, speed_m_s: Array, directions: Array, floor_z: float, side: Array,
    top: Array, swing: Array, sinks_m: float,
) -> Array:  # fmt: skip
    """See `human.walkers_limbs`: of fields of their walks."""
    poses = np.empty((len(yaw), 7, 7))
    for m in range(len(yaw)):
        phase = 2 * np.pi * walked_m[m] / STRIDE_M
        swing_rad = FULL_SWING_RAD * min(speed_m_s[m] / FULL_SWING_SPEED_M_S, 1.0)
        pose_limbs(
            poses[m], position[m, 0], position[m, 1], yaw[m], phase, swing_rad, directions[m], floor_z, side, top,
            swing, sinks_m,
        )  # fmt: skip
    return poses


@kernel
def controls(
    targets: Array, limbs: Array, layout: Array, objects: Array, props: Ints, points: Array, spare: int, away_m: float
) -> Array:
    """See `sim.controls.pack_controls`: of objects shown by the `props` (n, B), of `spare` that there are."""
    (n, times, joints), people, still = targets.shape, limbs.shape[1], layout.shape[1]
    steps, bodies = len(limbs) // n, people + still + spare
    control = np.empty((n, times, joints + 7 * bodies))
    places, turns, first = joints, joints + 3 * bodies, people + still
    for m in range(n):
        for time in range(times):
            out = control[m, time]
            for j in range(joints):
                out[j] = targets[m, time, j]
            step = m * steps + time // (times // steps)
            for index in range(bodies):
                for axis in range(7):
                    if index < people:
                        value = limbs[step, index, axis]
                    elif index < first:
                        value = layout[m, index - people, axis]
                    else:
                        value = away_m if axis == 0 else 1.0 if axis == 3 else 0.0
                    out[places + 3 * index + axis if axis < 3 else turns + 4 * index + axis - 3] = value
            for axis in range(3):
                for index in range(points.shape[1]):
                    out[places + 3 * (first + index) + axis] = points[m, index, axis]
                for index in range(0 if points.shape[1] else props.shape[1]):
                    out[places + 3 * (first + props[m, index]) + axis] = objects[m, index, axis]
    return control
