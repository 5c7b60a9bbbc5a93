"""A walking human of seven capsule mocap bodies, posed by position and by gait or the directions of their limbs."""

from __future__ import annotations

from typing import Any

import numpy as np
from dm_control import mjcf
from numpy.typing import ArrayLike, NDArray

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.humans.body import (
    ARM_RADIUS_M,
    FOREARM_M,
    HEIGHT_M,
    HIP_M,
    SHOULDER_HALF_WIDTH_M,
    SHOULDER_M,
    UPPER_ARM_M,
)
from hrl_comfort.humans.walk import Walk
from hrl_comfort.scene import kernels

LIMBS = (
    "trunk", "left_leg", "right_leg", "left_upper_arm", "right_upper_arm", "left_forearm", "right_forearm",
)  # fmt: skip
"""Names of the mocap bodies of the first person, in order of their mocap index."""

TRUNK_RADIUS_M = 0.13
HEAD_RADIUS_M = 0.10
LEG_RADIUS_M = 0.07
HIP_HALF_WIDTH_M = 0.09

# Of each limb: lateral offset (left positive) and height of its joint, m, and the sign of its swing. An arm
# swings opposite to the leg on its side. The elbows of `_ELBOWS` hang below the shoulders of `_SHOULDERS`.
_SHOULDERS, _ELBOWS = slice(3, 5), slice(5, 7)
_HIPS, _SIDES = (HIP_HALF_WIDTH_M, -HIP_HALF_WIDTH_M), (SHOULDER_HALF_WIDTH_M, -SHOULDER_HALF_WIDTH_M)
_SIDE = np.array([0.0, *_HIPS, *_SIDES, *_SIDES])
_TOP = np.array([HIP_M] * 3 + [SHOULDER_M] * 4)
_SWING = np.array([0.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0])
BODY = _SIDE, _TOP, _SWING, HIP_M - LEG_RADIUS_M
"""As kernels take it."""


def limbs_of_person(index: int) -> tuple[str, ...]:
    """Return the names of the limbs of a person, counted from 0: those of the second are `trunk_2` and so on."""
    return LIMBS if index == 0 else tuple(f"{limb}_{index + 1}" for limb in LIMBS)


def build_human(world: mjcf.Element, poses: NDArray[np.float64], index: int = 0) -> None:
    """Add the limbs of a person, counted from 0, to a worldbody at initial `poses` (7, 7), as of `limb_poses`.

    A body's origin is the joint of its limb. Limbs collide with the robot, not with each other or the cell.
    """
    skin, cloth, trousers = (0.85, 0.65, 0.5, 1), (0.25, 0.4, 0.65, 1), (0.25, 0.25, 0.3, 1)
    shapes = {
        "trunk": ((0, 0, 0.05, 0, 0, SHOULDER_M - HIP_M - 0.06), TRUNK_RADIUS_M, cloth),
        "leg": ((0, 0, 0, 0, 0, LEG_RADIUS_M - HIP_M), LEG_RADIUS_M, trousers),
        "arm": ((0, 0, 0, 0, 0, -UPPER_ARM_M), ARM_RADIUS_M, skin),
        "forearm": ((0, 0, 0, 0, 0, -FOREARM_M), ARM_RADIUS_M, skin),
    }
    for limb, name, pose in zip(LIMBS, limbs_of_person(index), poses, strict=True):
        body = world.add("body", name=name, mocap=True, pos=pose[:3], quat=pose[3:])
        fromto, radius, colour = shapes[limb.split("_")[-1]]
        look = {"contype": 0, "conaffinity": 1, "condim": 1}
        body.add("geom", name=name, type="capsule", fromto=fromto, size=[radius], rgba=colour, **look)
        if limb == "trunk":
            centre = (0, 0, HEIGHT_M - HIP_M - HEAD_RADIUS_M)
            head = name.replace("trunk", "head")
            body.add("geom", name=head, type="sphere", pos=centre, size=[HEAD_RADIUS_M], rgba=skin, **look)


def limb_poses(
    x: ArrayLike,
    y: ArrayLike,
    yaw: ArrayLike,
    phase: ArrayLike,
    swing_rad: ArrayLike,
    floor_z: ArrayLike,
    directions: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the pose (..., 7, 7) of each limb: position (m), quaternion (w, x, y, z), cell frame.

    x, y, yaw: vertical axis and heading (m, m, rad). Limbs swing by swing_rad * sin(phase), left and right
    opposite; zero swing is standing. The body sinks as the legs swing, so the feet stay on the floor.
    `directions` (..., 6, 3) are unit vectors down all limbs but the trunk, in the person's frame: x forward, y left,
    z up. NaN is the direction of the gait.
    """
    if directions is not None and plain(x, y, yaw, phase, swing_rad, directions) and np.ndim(x) == 1:
        given: Any = x, y, yaw, phase, swing_rad, directions
        compiled: NDArray[np.float64] = kernels.limb_poses(*contiguous(*given), float(np.asarray(floor_z)), *BODY)
        return compiled
    x, y, yaw, phase, swing_rad, floor_z = (
        np.asarray(v, dtype=np.float64)[..., None] for v in (x, y, yaw, phase, swing_rad, floor_z)
    )
    angle, cos_yaw, sin_yaw = swing_rad * np.sin(phase), np.cos(yaw), np.sin(yaw)
    if directions is not None and np.isnan(directions).all():
        directions = None
    if directions is not None:  # legs that are given do not walk
        angle = np.where(np.isnan(directions[..., 0, :1]), angle, 0.0)
    swung, half, cos_angle = angle / 2, yaw / 2, np.cos(angle)
    sink = (HIP_M - LEG_RADIUS_M) * (1 - cos_angle)
    upright = np.where(_SWING == 0.0, 1.0, np.cos(swung))
    leaning, cos_half, sin_half = np.sin(swung) * _SWING, np.cos(half), np.sin(half)
    poses = np.empty((*np.broadcast(x, y, yaw, upright, floor_z).shape, 7))
    poses[..., 0] = x - _SIDE * sin_yaw
    poses[..., 1] = y + _SIDE * cos_yaw
    poses[..., 2] = floor_z + _TOP - sink
    poses[..., 3] = cos_half * upright
    poses[..., 4] = -sin_half * leaning
    poses[..., 5] = cos_half * leaning
    poses[..., 6] = sin_half * upright
    forward = -UPPER_ARM_M * np.sin(angle * _SWING[_SHOULDERS])
    poses[..., _ELBOWS, 0] += cos_yaw * forward
    poses[..., _ELBOWS, 1] += sin_yaw * forward
    poses[..., _ELBOWS, 2] -= UPPER_ARM_M * cos_angle
    if directions is not None:
        _direct(poses, yaw, directions)
    return poses


def walkers_limbs(walk: Walk, floor_z: float) -> NDArray[np.float64]:
    """Return the limbs (n, 7, 7) of n people, as of `limb_poses` in their gait."""
    fields = contiguous(walk.position, walk.yaw, walk.walked_m, walk.speed_m_s, walk.limbs)
    limbs: NDArray[np.float64] = kernels.walkers_limbs(*fields, floor_z, *BODY)
    return limbs


def _direct(poses: NDArray[np.float64], yaw: NDArray[np.float64], directions: NDArray[np.float64]) -> None:
    """Turn the limbs of standing or walking `poses` (..., 7, 7) to their `directions` (..., 6, 3)."""
    (x, y, z), cos, sin = np.moveaxis(directions, -1, 0), np.cos(yaw), np.sin(yaw)
    given = np.isfinite(directions)
    # The shortest rotation of -z to the direction; straight up it is half a turn about x.
    quaternion = np.stack([1 - z, sin * x + cos * y, sin * y - cos * x, 0 * z], axis=-1)
    size = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion = np.where(size > 1e-6, quaternion / np.maximum(size, 1e-12), [0.0, 1.0, 0.0, 0.0])
    poses[..., 1:, 3:] = np.where(given[..., :1], quaternion, poses[..., 1:, 3:])
    upper = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)[..., 2:4, :]
    elbows = poses[..., _SHOULDERS, :3] + UPPER_ARM_M * upper
    poses[..., _ELBOWS, :3] = np.where(given[..., 2:4, :], elbows, poses[..., _ELBOWS, :3])
