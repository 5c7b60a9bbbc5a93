"""Smallest distance between any link of the robot and any body part of the human, batched."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.kinematics import LinkFrames

Array = NDArray[np.float64]


class ArmDistance:
    """Distance between the capsules of the compiled model; a sphere is a capsule of length 0."""

    def __init__(self, scene: Scene) -> None:
        self._frames = LinkFrames(scene)
        model, data = scene.model, mujoco.MjData(scene.model)
        mujoco.mj_kinematics(model, data)
        links = self._frames.links
        limbs = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, limb) for limb in LIMBS]
        self._arm, self._person = [], []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            size, half = model.geom_size[geom][:2]
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
                half = 0.0
            axis = half * data.geom_xmat[geom].reshape(3, 3)[:, 2]
            ends = data.geom_xpos[geom] + np.array([-1.0, 1.0])[:, None] * axis
            owner = body
            while owner not in links and owner not in limbs and owner != 0:
                owner = int(model.body_parentid[owner])
            if owner == 0:
                continue  # neither arm nor human
            local = (ends - data.xpos[owner]) @ data.xmat[owner].reshape(3, 3)
            if owner in links:
                self._arm.append((links.index(owner), local, size))
            else:
                self._person.append((limbs.index(owner), local, size))
        arm, person = ([size for *_, size in parts] for parts in (self._arm, self._person))
        self._sum = np.add.outer(arm, person)

    def __call__(self, joints: Array, limbs: Array) -> Array:
        """Return (...,) m, negative in overlap; joints (..., J) rad, limbs (..., 5, 7) as `limb_poses`."""
        frames = self._frames(joints)
        arm = [frames[link][1][..., None, :] + ends @ np.swapaxes(frames[link][0], -1, -2)
               for link, ends, _ in self._arm]  # fmt: skip
        turns = rotations(limbs[..., 3:])
        person = [
            limbs[..., limb, None, :3] + ends @ np.swapaxes(turns[..., limb, :, :], -1, -2)
            for limb, ends, _ in self._person
        ]
        first = np.stack(arm, axis=-3)[..., :, None, :, :]
        second = np.stack(person, axis=-3)[..., None, :, :, :]
        gap = segment_distance(first[..., 0, :], first[..., 1, :], second[..., 0, :], second[..., 1, :])
        return np.asarray((gap - self._sum).min(axis=(-2, -1)))


def rotations(quaternions: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=-2,
    )


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
