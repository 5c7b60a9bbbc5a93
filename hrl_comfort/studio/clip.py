"""Clips: what the arm, the person and the balls do over some control steps, and the picture at any time of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans import Walk, gait
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.workcell import Scene, ball_props
from hrl_comfort.sim.balls import rendered_positions
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """One picture of a cell; metres and radians, cell frame."""

    joints: Array
    """(J,)"""
    limbs: Array
    """(7, 7), as `scene.human.limb_poses`."""
    props: Array
    """(P, 3), positions of the balls and points by their order in `Scene.mocap`; NaN where one is not there."""


@dataclass(frozen=True)
class Clip:
    """T instants of a cell, between which pictures are interpolated linearly."""

    time: Array
    """(T,) s, rising, from 0."""
    joints: Array
    """(T, J) rad."""
    person: Array
    """(T, 5 or 23) x, y (m), yaw (unwrapped), phase and swing of the gait (rad), and perhaps `Walk.limbs`."""
    props: Array
    """(T, P, 3) m; a prop is where it was at the last instant before the picture."""
    floor_z: float

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
        joints, person = ((1 - share) * rows[index] + share * rows[after] for rows in (self.joints, self.person))
        props = self.props[after if share >= 1.0 else index]
        directions = person[5:].reshape(-1, 3) if len(person) > 5 else None
        x, y, yaw, phase, swing = person[:5]
        return Frame(joints, limb_poses(x, y, yaw, phase, swing, self.floor_z, directions), props)


def decision_clip(scene: Scene, task: Subtask, before: State, walk: Walk, result: StepResult, after: Walk) -> Clip:
    """Return the clip of a decision in one cell, from the state and walk before it to those after it."""
    kept = np.flatnonzero(result.valid[0].numpy())
    states = [before, *(result.steps[k] for k in kept)]
    x_y = np.concatenate([state.human_pos.numpy() for state in states])
    yaw = np.unwrap(np.concatenate([state.human_yaw.numpy() for state in states]))
    ends = np.array([np.concatenate([*gait(each), each.limbs.ravel()]) for each in (walk, after)])
    share = np.linspace(0.0, 1.0, len(states))[:, None]
    return Clip(
        time=np.arange(len(states), dtype=np.float64) * CONTROL_STEP_S,
        joints=np.concatenate([state.joint_pos.numpy() for state in states]),
        person=np.column_stack([x_y, yaw, (1 - share) * ends[0] + share * ends[1]]),
        props=np.stack([props_of(scene, task, state) for state in states]),
        floor_z=scene.floor_z,
    )


def still_clip(scene: Scene, task: Subtask, state: State, walk: Walk) -> Clip:
    """Return the clip of one instant."""
    person = np.column_stack([state.human_pos.numpy(), state.human_yaw.numpy(), *gait(walk), walk.limbs.reshape(1, -1)])
    props = props_of(scene, task, state)[None]
    return Clip(np.zeros(1), state.joint_pos.numpy().copy(), person, props, scene.floor_z)


def props_of(scene: Scene, task: Subtask, state: State) -> Array:
    """Return the positions (P, 3) m of the props of one cell, NaN where one is not there."""
    props = np.full((len(scene.mocap) - len(LIMBS), 3), np.nan)
    if task.points:
        props[2 : 2 + task.points] = state.points[0, : task.points].numpy()
    else:
        for index, place in enumerate(rendered_positions(state, task)[0]):
            props[ball_props(index)[int(state.colours[0, index])]] = place
    return props
