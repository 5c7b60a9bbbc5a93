"""Frames of the links of a serial arm, batched."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]


class LinkFrames:
    """Forward kinematics of the J links of a scene's arm, read from the compiled model."""

    def __init__(self, scene: Scene) -> None:
        model = scene.model
        joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in scene.joints]
        self.links = [int(model.jnt_bodyid[joint]) for joint in joints]
        """Body of each link."""
        self._steps, self._offsets, self._anchors = [], [], model.jnt_pos[joints].copy()
        base = 0
        for joint, link in zip(joints, self.links, strict=True):
            turn, offset = _fixed_pose(model, link, base)
            cross = np.cross(np.eye(3), model.jnt_axis[joint])  # v -> axis x v
            square = turn @ cross @ cross
            self._steps.append((turn + square, turn @ cross, -square))  # Rodrigues: I + sin q K + (1 - cos q) K²
            self._offsets.append(offset + turn @ model.jnt_pos[joint])
            base = link

    def __call__(self, joints: Array) -> list[tuple[Array, Array]]:
        """Return rotation (..., 3, 3) and origin (..., 3) m of each link; joints (..., J) rad."""
        turn, origin = np.broadcast_to(np.eye(3), (*joints.shape[:-1], 3, 3)), np.zeros((*joints.shape[:-1], 3))
        sine, cosine = np.sin(joints)[..., None, None], np.cos(joints)[..., None, None]
        frames = []
        for i, (fixed, by_sine, by_cosine) in enumerate(self._steps):
            origin = origin + turn @ self._offsets[i]
            turn = turn @ (fixed + sine[..., i, :, :] * by_sine + cosine[..., i, :, :] * by_cosine)
            origin = origin - turn @ self._anchors[i]
            frames.append((turn, origin))
        return frames


def _fixed_pose(model: mujoco.MjModel, body: int, base: int) -> tuple[Array, Array]:
    """Return rotation (3, 3) and position (3,) m of a body in the frame of `base`, with its joint at 0."""
    turn, offset = np.eye(3), np.zeros(3)
    while body != base:
        step = np.empty(9)
        mujoco.mju_quat2Mat(step, model.body_quat[body])
        local = step.reshape(3, 3)
        turn, offset = local @ turn, model.body_pos[body] + local @ offset
        body = int(model.body_parentid[body])
    return turn, offset
