"""A walking human of five capsule mocap bodies, posed by position and gait."""

import numpy as np
from dm_control import mjcf
from numpy.typing import ArrayLike, NDArray

LIMBS = ("trunk", "left_leg", "right_leg", "left_arm", "right_arm")
"""Names of the mocap bodies, in order of their mocap index."""

# An upright adult of 1.75 m; proportions: middle of the ranges of Drillis and Contini (1966).
HEIGHT_M = 1.75
HIP_M = 0.93
SHOULDER_M = 1.43
TRUNK_RADIUS_M = 0.13
HEAD_RADIUS_M = 0.10
LEG_RADIUS_M = 0.07
ARM_RADIUS_M = 0.04
ARM_LENGTH_M = 0.62
HIP_HALF_WIDTH_M = 0.09
SHOULDER_HALF_WIDTH_M = 0.18

# Of each limb: lateral offset (left positive) and height of its joint, m, and the sign of its swing. An arm
# swings opposite to the leg on its side.
_SIDE = np.array([0.0, HIP_HALF_WIDTH_M, -HIP_HALF_WIDTH_M, SHOULDER_HALF_WIDTH_M, -SHOULDER_HALF_WIDTH_M])
_TOP = np.array([HIP_M, HIP_M, HIP_M, SHOULDER_M, SHOULDER_M])
_SWING = np.array([0.0, 1.0, -1.0, -1.0, 1.0])


def build_human(world: mjcf.Element, poses: NDArray[np.float64]) -> None:
    """Add the limbs to a worldbody at initial `poses` (5, 7), as of `limb_poses`.

    A body's origin is the joint of its limb. Limbs collide with the robot, not with each other or the cell.
    """
    skin, cloth, trousers = (0.85, 0.65, 0.5, 1), (0.25, 0.4, 0.65, 1), (0.25, 0.25, 0.3, 1)
    shapes = {
        "trunk": ((0, 0, 0.05, 0, 0, SHOULDER_M - HIP_M - 0.06), TRUNK_RADIUS_M, cloth),
        "leg": ((0, 0, 0, 0, 0, LEG_RADIUS_M - HIP_M), LEG_RADIUS_M, trousers),
        "arm": ((0, 0, 0, 0, 0, ARM_RADIUS_M - ARM_LENGTH_M), ARM_RADIUS_M, skin),
    }
    for limb, pose in zip(LIMBS, poses, strict=True):
        body = world.add("body", name=limb, mocap=True, pos=pose[:3], quat=pose[3:])
        fromto, radius, colour = shapes[limb.split("_")[-1]]
        look = {"contype": 0, "conaffinity": 1, "condim": 1}
        body.add("geom", name=limb, type="capsule", fromto=fromto, size=[radius], rgba=colour, **look)
        if limb == "trunk":
            centre = (0, 0, HEIGHT_M - HIP_M - HEAD_RADIUS_M)
            body.add("geom", name="head", type="sphere", pos=centre, size=[HEAD_RADIUS_M], rgba=skin, **look)


def limb_poses(
    x: ArrayLike, y: ArrayLike, yaw: ArrayLike, phase: ArrayLike, swing_rad: ArrayLike, floor_z: ArrayLike
) -> NDArray[np.float64]:
    """Return the pose (..., 5, 7) of each limb: position (m), quaternion (w, x, y, z), cell frame.

    x, y, yaw: vertical axis and heading (m, m, rad). Limbs swing by swing_rad * sin(phase), left and right
    opposite; zero swing is standing. The body sinks as the legs swing, so the feet stay on the floor.
    """
    x, y, yaw, phase, swing_rad, floor_z = (
        np.asarray(v, dtype=np.float64)[..., None] for v in (x, y, yaw, phase, swing_rad, floor_z)
    )
    angle = swing_rad * np.sin(phase)
    swung = angle / 2
    sink = (HIP_M - LEG_RADIUS_M) * (1 - np.cos(angle))
    half = yaw / 2
    upright = np.where(_SWING == 0.0, 1.0, np.cos(swung))
    leaning, cos_half, sin_half = np.sin(swung) * _SWING, np.cos(half), np.sin(half)
    poses = np.empty((*np.broadcast(x, y, yaw, upright, floor_z).shape, 7))
    poses[..., 0] = x - _SIDE * np.sin(yaw)
    poses[..., 1] = y + _SIDE * np.cos(yaw)
    poses[..., 2] = floor_z + _TOP - sink
    poses[..., 3] = cos_half * upright
    poses[..., 4] = -sin_half * leaning
    poses[..., 5] = cos_half * leaning
    poses[..., 6] = sin_half * upright
    return poses
