"""Smallest distance between any link of the robot and any body part of the human, batched."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.robots import LINKS, ROBOTS, UrModel
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]


def link_frames(robot: UrModel, joints: Array) -> list[tuple[Array, Array]]:
    """Return rotation (..., 3, 3) and origin (..., 3) m of each link's DH frame; joints (..., 6) rad."""
    turn, origin = np.broadcast_to(np.eye(3), (*joints.shape[:-1], 3, 3)), np.zeros((*joints.shape[:-1], 3))
    frames = []
    for i in range(6):
        cos, sin = np.cos(joints[..., i, None]), np.sin(joints[..., i, None])
        ca, sa = np.cos(robot.alpha_rad[i]), np.sin(robot.alpha_rad[i])
        x, y, z = turn[..., 0], turn[..., 1], turn[..., 2]
        along, across = cos * x + sin * y, cos * y - sin * x
        turn = np.stack([along, ca * across + sa * z, ca * z - sa * across], axis=-1)
        origin = origin + robot.d_m[i] * z + robot.a_m[i] * along
        frames.append((turn, origin))
    return frames


class ArmDistance:
    """Distance between the capsules of the compiled model; a sphere is a capsule of length 0."""

    def __init__(self, scene: Scene) -> None:
        self._robot = ROBOTS[scene.robot]
        model, data = scene.model, mujoco.MjData(scene.model)
        mujoco.mj_kinematics(model, data)
        links = [model.body(f"robot/{link}").id for link in LINKS]
        limbs = [model.body(limb).id for limb in LIMBS]
        self._arm, self._person = [], []
        for geom in range(model.ngeom):
            owner = int(model.geom_bodyid[geom])
            while owner not in (*links, *limbs, 0):
                owner = int(model.body_parentid[owner])
            if owner == 0:
                continue  # neither arm nor human
            size, half = model.geom_size[geom][:2]
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
                half = 0.0
            axis = half * data.geom_xmat[geom].reshape(3, 3)[:, 2]
            ends = data.geom_xpos[geom] + np.array([-1.0, 1.0])[:, None] * axis
            local = (ends - data.xpos[owner]) @ data.xmat[owner].reshape(3, 3)
            if owner in links:
                self._arm.append((links.index(owner), local, size))
            else:
                self._person.append((limbs.index(owner), local, size))
        arm, person = ([size for *_, size in parts] for parts in (self._arm, self._person))
        self._sum = np.add.outer(arm, person)

    def __call__(self, joints: Array, limbs: Array) -> Array:
        """Return (...,) m, negative in overlap; joints (..., 6) rad, limbs (..., 5, 7) as `limb_poses`."""
        links, turns = link_frames(self._robot, joints), rotations(limbs[..., 3:])
        arm = [_placed(ends, *links[link]) for link, ends, _ in self._arm]
        person = [_placed(ends, turns[..., limb, :, :], limbs[..., limb, :3]) for limb, ends, _ in self._person]
        first = np.stack(arm, axis=-3)[..., :, None, :, :]
        second = np.stack(person, axis=-3)[..., None, :, :, :]
        gap = segment_distance(first[..., 0, :], first[..., 1, :], second[..., 0, :], second[..., 1, :])
        return np.asarray((gap - self._sum).min(axis=(-2, -1)))


def _placed(points: Array, turn: Array, origin: Array) -> Array:
    """Return points (p, 3) of frames with rotations (..., 3, 3) and origins (..., 3), m: (..., p, 3)."""
    return np.asarray(origin[..., None, :] + points @ np.swapaxes(turn, -1, -2))


def rotations(quaternions: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def segment_distance(p: Array, p_end: Array, q: Array, q_end: Array) -> Array:
    """Return the distance (...,) between segments p to p_end and q to q_end (..., 3).

    The closest points of the lines, clamped to one segment and then to the other (Ericson, Real-Time
    Collision Detection, 2005, section 5.1.9).
    """
    d, e, r = p_end - p, q_end - q, p - q
    a, c, b = (d * d).sum(-1), (d * r).sum(-1), (d * e).sum(-1)
    ee, f = np.maximum((e * e).sum(-1), 1e-12), (e * r).sum(-1)
    aa = np.maximum(a, 1e-12)
    denominator = aa * ee - b * b
    s = np.where(denominator > 1e-12, (b * f - c * ee) / np.maximum(denominator, 1e-12), 0.0).clip(0.0, 1.0)
    t = ((b * s + f) / ee).clip(0.0, 1.0)
    s = ((b * t - c) / aa).clip(0.0, 1.0)
    gap = r + d * s[..., None] - e * t[..., None]
    return np.asarray(np.sqrt((gap * gap).sum(-1)))
