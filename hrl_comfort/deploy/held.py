"""Places of the objects beside a real hand, which tells no more than whether its fingers grip something.

An object lies where its episode begins until the fingers grip near it. Then it rides on the tool, and when they open it
falls on what is below.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.deploy.arms import Fingers, HandReading
from hrl_comfort.deploy.stops import GripLostError
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
NEAR_M = 0.06
"""Distance of the tool from the middle of an object within which fingers that grip hold it."""
FARTHER = 0.1
"""Share of the way of the fingers from where they gripped at which they no longer hold it, or it forces them open."""


class Objects:
    """Poses of the objects of one cell, as the hand lets one believe.

    Args:
      scene: with a gripper.
    """

    def __init__(self, scene: Scene) -> None:
        model, cell = scene.model, scene.cell
        self._at, self._planning = scene.sensors, mujoco.MjData(scene.planning)
        self._model = scene.planning
        self._open, self._shut = model.actuator_ctrlrange[len(scene.joints)]
        joints = [model.joint(name) for name in scene.loose]
        self._qpos = np.array([np.arange(7) + each.qposadr[0] for each in joints])
        self._qvel = np.array([np.arange(3) + each.dofadr[0] for each in joints])
        kinds = list(cell.objects.values())
        self._half = np.array([kinds[index % len(kinds)].half_height_m for index in range(len(joints))])
        self._floor_z = scene.floor_z
        tops = [(each.top_m, each.size_m, each.yaw_deg) for each in cell.places.values()]
        for obstacle in cell.obstacles.values():
            x, y, z = obstacle.position_m
            half = obstacle.size_m if obstacle.shape == "box" else [obstacle.size_m[0]] * 2
            tops.append(([x, y, z + obstacle.half_height_m], [2 * half[0], 2 * half[1]], obstacle.yaw_deg))
        self._tops = tops

    def begin(self, qpos: Array) -> None:
        """Begin an episode with the positions (nq,) of the model."""
        self.poses = qpos[self._qpos].copy()
        self._velocity = np.zeros((len(self.poses), 3))
        self._held: int | None = None
        self._gripped = self._closed = self._told = self._speed = 0.0
        self._steps = 0

    def follow(self, hand: HandReading, told: float, angles: Array) -> None:
        """Go on by a control step to a reading of the hand whose set-point is `told`, the arm at `angles` (J,) rad.

        Raises:
          GripLostError: what the fingers held is no longer there, though they were not told to open.
        """
        least = self._told if self._held is None else max(self._told, self._gripped)
        opening, self._told = told < least, told
        self._speed, self._closed = (hand.closed - self._closed) / CONTROL_STEP_S, hand.closed
        self._steps += 1
        self._velocity[:] = 0.0
        place, turn = self._tool(angles)
        if self._held is None and hand.fingers == Fingers.GRIP and not opening:
            self._grip(place, turn)
        if (held := self._held) is None:
            return
        if not opening:
            self._check(hand)
        elif hand.fingers != Fingers.GRIP:
            self._let_go()
            return
        before = self.poses[held, :3].copy()
        self.poses[held, :3] = place + turn @ self._away
        mujoco.mju_mulQuat(self.poses[held, 3:], _quaternion(turn), self._turned)
        self._velocity[held] = (self.poses[held, :3] - before) / CONTROL_STEP_S

    def _grip(self, place: Array, turn: Array) -> None:
        """Let the nearest object ride on the tool at `place` (3,) m with axes `turn` (3, 3), midway between the pads.

        If none is near, the fingers hold something unknown, and no object moves.
        """
        away = (self.poses[:, :3] - place) @ turn
        nearest = int(np.linalg.norm(away, axis=1).argmin())
        if np.linalg.norm(away[nearest]) > NEAR_M:
            return
        self._held, self._gripped = nearest, self._closed
        self._away, self._turned = away[nearest] * [0.0, 1.0, 1.0], np.zeros(4)
        back = np.zeros(4)
        mujoco.mju_negQuat(back, _quaternion(turn))
        mujoco.mju_mulQuat(self._turned, back, self.poses[nearest, 3:])

    def _check(self, hand: HandReading) -> None:
        if hand.fingers in (Fingers.THERE, Fingers.STOPPED_OPENING) or abs(hand.closed - self._gripped) > FARTHER:
            raise GripLostError(
                f"grip lost: the fingers gripped at {100 * self._gripped:.0f} % of their way, and are at "
                f"{100 * hand.closed:.0f} % ({hand.fingers.name}) without having been told to open"
            )

    def _let_go(self) -> None:
        """Let the held object fall, upright, on the highest surface below it."""
        assert self._held is not None
        pose, half = self.poses[self._held], self._half[self._held]
        below = [self._floor_z]
        for (x, y, top), size, yaw_deg in self._tops:
            turn = np.radians(yaw_deg)
            dx, dy = pose[0] - x, pose[1] - y
            along, across = np.cos(turn) * dx + np.sin(turn) * dy, np.cos(turn) * dy - np.sin(turn) * dx
            if abs(along) <= size[0] / 2 and abs(across) <= size[1] / 2 and top < pose[2]:
                below.append(top)
        w, x, y, z = pose[3:]
        yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        pose[2], pose[3:] = max(below) + half, (np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
        self._held = None

    def _tool(self, angles: Array) -> tuple[Array, Array]:
        """Return position (3,) m and axes (3, 3) of the tool at joint angles (J,) rad."""
        self._planning.qpos[:] = angles
        mujoco.mj_kinematics(self._model, self._planning)
        tool = self._planning.site("robot/tcp")
        return tool.xpos.copy(), tool.xmat.reshape(3, 3).copy()

    def put(self, data: mujoco.MjData) -> None:
        """Put the objects of `data` where they are believed to be."""
        data.qpos[self._qpos], data.qvel[self._qvel] = self.poses, self._velocity

    def tell(self, sensed: Array) -> None:
        """Write what the hand has told, and the time since the episode began, into readings (nsensor,)."""
        way = self._shut - self._open
        pads = np.zeros((len(self.poses), 2))
        if self._held is not None:
            pads[self._held] = 1.0
        sensed[self._at["pads"]] = pads.ravel()
        sensed[self._at["hand_pos"]] = self._open + way * self._closed
        sensed[self._at["hand_vel"]] = way * self._speed
        sensed[self._at["time"]] = self._steps * CONTROL_STEP_S


def _quaternion(turn: Array) -> Array:
    """Return the unit quaternion (4,), w first, of axes (3, 3)."""
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, turn.ravel())
    return found
