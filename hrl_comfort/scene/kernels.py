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
Body = tuple[Array, Array, Array, float]
"""Side, top and swing of each limb, and how far the body sinks: the last arguments of `walkers_limbs`."""


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
def felt(readings: Array, first: int, end: int) -> NDArray[np.bool_]:
    """Return (n,) whether any of the sensors from `first` to before `end` reads something; `readings` (n, nsensor)."""
    found = np.empty(len(readings), np.bool_)
    for m in range(len(readings)):
        reads = False
        for sensor in range(first, end):
            reads |= readings[m, sensor] != 0.0
        found[m] = reads
    return found


@kernel
def controls(
    targets: Array, limbs: Array, layout: Array, objects: Array, kinds: Ints, points: Array, marks: int, bodies: int,
    spare: int, away_m: float,
) -> Array:  # fmt: skip
    """See `sim.controls.pack_controls`.

    The last, `spare` bodies are the `marks` of points, then those of each object, `bodies` by its kind; see
    `Scene.object_prop`.
    """
    (n, times, joints), people, still = targets.shape, limbs.shape[1], layout.shape[1]
    steps, first, shown = len(limbs) // n, people + still, points.shape[1]
    substeps, turns = times // steps, joints + 3 * (first + spare)
    control = np.empty((n, times, joints + 7 * (first + spare)))
    for m in range(n):
        for step in range(steps):
            out, one = control[m, step * substeps], m * steps + step
            for index in range(first + spare):
                place, turn = joints + 3 * index, turns + 4 * index
                if index < first:
                    at = limbs[one, index] if index < people else layout[m, index - people]
                    out[place], out[place + 1], out[place + 2] = at[0], at[1], at[2]
                    out[turn], out[turn + 1], out[turn + 2], out[turn + 3] = at[3], at[4], at[5], at[6]
                else:
                    out[place], out[place + 1], out[place + 2] = away_m, 0.0, 0.0
                    out[turn], out[turn + 1], out[turn + 2], out[turn + 3] = 1.0, 0.0, 0.0, 0.0
            for axis in range(3):
                for index in range(shown):
                    out[joints + 3 * (first + index) + axis] = points[m, index, axis]
                for index in range(objects.shape[1] if bodies and not shown else 0):
                    body = first + marks + index * bodies + kinds[m, index]
                    out[joints + 3 * body + axis] = objects[m, index, axis]
            for time in range(step * substeps + 1, (step + 1) * substeps):
                control[m, time, joints:] = out[joints:]
            for time in range(step * substeps, (step + 1) * substeps):
                control[m, time, :joints] = targets[m, time]
    return control
