"""Clips: what the arm, the person and the objects do over some control steps, and the picture at any time of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame, Series

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M
from hrl_comfort.files.tables import Floats, column
from hrl_comfort.humans.walk import FULL_SWING_RAD, FULL_SWING_SPEED_M_S, SPEED_SMOOTHING, STRIDE_M
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import ObjectAt, subtask

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """One picture of a cell; metres and radians, cell frame."""

    joints: Array
    """(J,)"""
    limbs: Array
    """(L, 7), as `scene.human.limb_poses`, of one person after the other."""
    props: Array
    """(P, 3), positions of the points and objects by their order in `Scene.mocap`; NaN where one is not there."""
    bodies: Array | None = None
    """With a gripper: (nq,) positions of all joints of the model, those of fingers and loose objects among them."""


@dataclass(frozen=True)
class Clip:
    """T instants of a cell, between which pictures are interpolated linearly."""

    time: Array
    """(T,) s, rising, from 0."""
    joints: Array
    """(T, J) rad."""
    people: Array
    """(T, P, 5 or 23) x, y (m), yaw (unwrapped), phase and swing of the gait (rad), and perhaps `Walk.limbs`."""
    props: Array
    """(T, P, 3) m; a prop is where it was at the last instant before the picture."""
    floor_z: float
    bodies: Array | None = None
    """With a gripper: (T, nq), as `Frame.bodies`."""

    @property
    def person(self) -> Array:
        """(T, 5 or 23), `people` of the first person."""
        return self.people[:, 0]

    @property
    def duration_s(self) -> float:
        """Time from the first instant to the last, s."""
        return float(self.time[-1])

    def frame(self, time_s: float) -> Frame:
        """Return the picture at a time, held before the first instant and after the last."""
        last = len(self.time) - 1
        index = int(np.clip(np.searchsorted(self.time, time_s, side="right") - 1, 0, max(last - 1, 0)))
        after = min(index + 1, last)
        span = self.time[after] - self.time[index]
        share = 0.0 if span <= 0 else float(np.clip((time_s - self.time[index]) / span, 0.0, 1.0))

        def between(rows: Array) -> Array:
            return np.asarray((1 - share) * rows[index] + share * rows[after])

        joints, people = between(self.joints), between(self.people)
        props = self.props[after if share >= 1.0 else index]
        directions = people[:, 5:].reshape(len(people), -1, 3) if people.shape[1] > 5 else None
        x, y, yaw, phase, swing = people[:, :5].T
        limbs = limb_poses(x, y, yaw, phase, swing, self.floor_z, directions)
        return Frame(joints, limbs.reshape(-1, 7), props, None if self.bodies is None else between(self.bodies))


def gait(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the simulated phase and swing (steps,), rad, of a person who walks along x, y (steps,), m."""
    walked = np.hypot(*(np.diff(values, prepend=values[0]) for values in (x, y)))
    speed = Series(walked / CONTROL_STEP_S).ewm(alpha=SPEED_SMOOTHING, adjust=False).mean().to_numpy()
    swing = FULL_SWING_RAD * np.minimum(speed / FULL_SWING_SPEED_M_S, 1.0)
    return 2 * math.pi * np.cumsum(walked) / STRIDE_M, swing


def path_clip(path: DataFrame, scene: Scene, task: str, kind: str | None) -> Clip:
    """Return the clip of the rows of paths.csv of one episode, with an object of a kind of the cell's, or without."""
    x, y, yaw = (column(path, f"human_{name}") for name in ("x", "y", "yaw"))
    there = np.isfinite(x)
    x, y, yaw = np.where(there, x, FAR_AWAY_M), np.where(there, y, 0.0), np.where(np.isfinite(yaw), yaw, 0.0)
    steps = column(path, "step")
    props = np.full((len(path), len(scene.mocap) - scene.first_prop, 3), np.nan)
    if kind is not None:
        cell, own = scene.cell, scene.cell.objects[kind]
        index = scene.object_prop(0, cell.kinds.index(kind))
        goals = {
            ObjectAt.ARRIVAL: cell.centre(kind, own.arrives_at),
            ObjectAt.PLACE: cell.centre(kind, own.belongs_at),
        }
        tool = np.column_stack([column(path, f"tcp_{axis}") for axis in "xyz"])
        for row, stage in enumerate(column(path, "stage")):
            where = subtask(task).location(0 if math.isnan(stage) else int(stage))
            if where != ObjectAt.NOWHERE:
                props[row, index] = goals.get(where, tool[row])
    return Clip(
        time=(steps - steps[0]) * CONTROL_STEP_S,
        joints=np.column_stack([column(path, f"q{joint}") for joint in range(len(scene.joints))]),
        people=np.column_stack([x, y, np.unwrap(yaw), *gait(x, y)])[:, None],
        props=props,
        floor_z=scene.floor_z,
    )


def set_pose(data: mujoco.MjData, scene: Scene, frame: Frame) -> None:
    """Put every body of `data` where it is in a picture."""
    if frame.bodies is not None:
        data.qpos[:] = frame.bodies
    data.qpos[[scene.model.joint(joint).qposadr[0] for joint in scene.joints]] = frame.joints
    people = len(frame.limbs)
    data.mocap_pos[:people], data.mocap_quat[:people] = frame.limbs[:, :3], frame.limbs[:, 3:]
    away = np.array([FAR_AWAY_M, 0.0, 0.0])
    data.mocap_pos[scene.first_prop :] = np.where(np.isnan(frame.props), away, frame.props)
    mujoco.mj_kinematics(scene.model, data)
