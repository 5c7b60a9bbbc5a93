"""The hand in an episode: where fingers and objects begin, and what the drive of the fingers is commanded."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.episode_sampler import Draw
from hrl_comfort.sim.hand.fingers import Fingers
from hrl_comfort.sim.variation.bodies import vary_objects
from hrl_comfort.sim.variation.grasps import narrow_rad, rise_m
from hrl_comfort.tasks import Start, State, Subtask

Array = NDArray[np.float64]
CLOSES_S = 0.5
"""Time in which a hand closes on an object."""
NEAR = 0.15
"""Part of the jitter and of the turn of an object by which a hand in front of it may be off."""
ASIDE_M, APART_M = 2.0, 1.0
"""Distance of objects that are not in an episode from people who are not there and from the floor, and from each other.
They fall freely, from so high that the episode is over before they arrive: what touches nothing costs least."""


class Gripping:
    """Fingers and objects of the cells of `scene` in episodes of `subtask`, which last up to `steps` control steps."""

    def __init__(self, scene: Scene, subtask: Subtask, steps: int) -> None:
        self._scene, self._start = scene, subtask.start
        self.fingers = Fingers(scene)
        model = self._model = scene.model
        self._objects = np.array([model.joint(name).qposadr[0] for name in scene.loose])
        self._arm = np.array([model.joint(name).qposadr[0] for name in scene.joints])
        known = (*scene.joints, *scene.loose)
        others = [model.joint(i) for i in range(model.njnt) if model.joint(i).name not in known]
        self._fingers = np.array([joint.qposadr[0] for joint in others])
        self._arrives = [list(scene.cell.places).index(each.arrives_at) for each in scene.cell.objects.values()]
        self._parked = model.qpos0.copy()
        high = scene.floor_z + ASIDE_M - model.opt.gravity[2] * (steps * CONTROL_STEP_S) ** 2 / 2
        for index, at in enumerate(self._objects):
            self._parked[at : at + 7] = (FAR_AWAY_M, ASIDE_M + APART_M * index, high, 1, 0, 0, 0)
        self._data = mujoco.MjData(scene.planning)
        self._closed_on = lru_cache(maxsize=64)(self._closed)

    def begin(self, draw: Draw, rows: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the bodies (r, nq + nv) in which the episodes of `rows` (r,) begin, and the hands' set-points (r,).

        They are those of a recorded start, if there is one. Else objects lie where they arrive. A hand is closed on
        the first one where the subtask begins with that in the hand; where it begins with that placed, it lies there.
        """
        model, cell = self._model, self._scene.cell
        bodies = np.zeros((len(rows), model.nq + model.nv))
        grip, kinds = np.zeros(len(rows)), draw.kinds[rows]
        lying = draw.objects(rows)
        for row, (start, turns) in enumerate(zip(draw.start[rows], draw.turns[rows], strict=True)):
            recorded = draw.hand[rows[row]]
            if np.isfinite(recorded).all():
                bodies[row], grip[row] = recorded[:-1], recorded[-1]
                for at, dof in self._absent(kinds[row]):
                    bodies[row, at : at + 7], bodies[row, dof : dof + 6] = self._parked[at : at + 7], 0.0
                continue
            qpos, joints = self._parked.copy(), len(self._arm)
            qpos[self._arm] = start[:joints]
            for index, kind in enumerate(kinds[row]):
                at, turn, size = lying[row, index], turns[index], float(draw.factors[rows[row], 2, kind])
                pose = np.array([*at, np.cos(turn / 2), 0, 0, np.sin(turn / 2)])
                if index == 0 and self._start == Start.AT_PLACE:
                    pose[:3] = draw.kind_places[rows[row], kind]
                if index == 0 and np.isfinite(before := draw.before[rows[row]]).all():
                    off = at[:2] - draw.places[rows[row], self._arrives[kind], :2]
                    pose = self._in_front(before, at[2], int(kind), size, off, turn)
                if index == 0 and self._start == Start.AT_OBJECT:
                    pose = self._in_hand(start[:joints], int(kind), size)
                    qpos[self._fingers] = self._closed_on(int(kind), size)
                    grip[row] = 1.0
                body = self._objects[index * len(cell.objects) + kind]
                qpos[body : body + 7] = pose
            bodies[row, : model.nq] = qpos
            bodies[row, model.nq + self._scene.moving[joints:] - 1 - model.nq] = start[joints : 2 * joints]
        return bodies, grip

    def lay(self, state: State, arrived: NDArray[np.bool_], physics: Array) -> None:
        """Put the objects `arrived` (N, B) where they are in the state, at rest, in the `physics` (N, nstate)."""
        centres, turns, kinds = (getattr(state, name).numpy() for name in ("objects", "objects_quat", "kinds"))
        count, bodies = len(self._scene.cell.objects), physics[:, 1:]
        for row, index in np.argwhere(arrived):
            for kind in range(count):
                at, dof = self._where(index * count + kind)
                bodies[row, at : at + 7], bodies[row, dof : dof + 6] = self._parked[at : at + 7], 0.0
            at, _ = self._where(index * count + kinds[row, index])
            bodies[row, at : at + 7] = *centres[row, index], *turns[row, index]

    def _where(self, body: int) -> tuple[int, int]:
        """Return where in a row of bodies the pose and the velocity begin of an object's body."""
        joint = self._model.joint(self._scene.loose[body])
        return int(joint.qposadr[0]), int(self._model.nq + joint.dofadr[0])

    def _absent(self, kinds: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Yield where in a row of bodies the pose and the velocity begin of each object not among `kinds` (B,)."""
        count = len(self._scene.cell.objects)
        for body in range(len(self._scene.loose)):
            if body % count != kinds[body // count]:
                yield self._where(body)

    def _in_front(self, angles: Array, height: float, kind: int, size: float, off: Array, turn: float) -> Array:
        """Return the pose (7,) of an object that lies at `height` m in front of the hand at joint angles (J,) rad.

        It is `size` times as large as its kind, aside by NEAR of `off` (2,) m and turned by NEAR of `turn` rad.
        """
        place, axes = self._tool(angles)
        ahead = (height + rise_m(self._scene, kind, size) - place[2]) / axes[2, 2]
        yaw = np.arctan2(axes[1, 0], axes[0, 0]) - narrow_rad(self._scene, kind) + NEAR * turn
        at = (place + ahead * axes[:, 2])[:2] + NEAR * off
        return np.array([*at, height, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])

    def _tool(self, angles: Array) -> tuple[Array, Array]:
        """Return position (3,) m and axes (3, 3) of the tool at joint angles (J,) rad."""
        data = self._data
        data.qpos[:] = angles
        mujoco.mj_kinematics(self._scene.planning, data)
        tool = data.site("robot/tcp")
        return tool.xpos.copy(), tool.xmat.reshape(3, 3).copy()

    def _in_hand(self, angles: Array, kind: int, size: float) -> Array:
        """Return the pose (7,) of an object in the hand at joint angles (J,) rad, level, below the tool."""
        place, axes = self._tool(angles)
        yaw = np.arctan2(axes[1, 0], axes[0, 0]) - narrow_rad(self._scene, kind)
        return np.array([*(place - [0, 0, rise_m(self._scene, kind, size)]), np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])

    def _closed(self, kind: int, size: float) -> Array:
        """Return the positions of the fingers' joints of a hand that has closed on an object.

        It is of a kind, and `size` times as large.
        """
        model, scene = copy(self._model), self._scene
        if size != 1.0:
            vary_objects(model, scene, np.full((3, len(scene.cell.objects)), [[1.0], [1.0], [size]]))
        model.opt.gravity[:] = 0.0
        data: Any = mujoco.MjData(model)
        data.qpos[:] = self._parked
        data.qpos[self._arm] = data.ctrl[: len(self._arm)] = scene.home
        mujoco.mj_kinematics(model, data)
        tool, at = data.site("robot/tcp"), self._objects[kind]
        data.qpos[at : at + 3] = tool.xpos
        across, turned = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(across, np.array([0.0, 0.0, 1.0]), -narrow_rad(scene, kind))
        mujoco.mju_mat2Quat(turned, tool.xmat)
        mujoco.mju_mulQuat(data.qpos[at + 3 : at + 7], turned, across)
        data.ctrl[len(self._arm)] = model.actuator_ctrlrange[len(self._arm), 1]
        for _ in range(round(CLOSES_S / model.opt.timestep)):
            mujoco.mj_step(model, data)
        return np.array(data.qpos[self._fingers])
