"""Clips of a session: a decision, or one instant."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans import gait
from hrl_comfort.plots.clip import Array, Clip
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.objects import rendered_positions
from hrl_comfort.sim.people import Crowd
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, Subtask


def decision_clip(scene: Scene, task: Subtask, before: State, result: StepResult, course: list[Crowd]) -> Clip:
    """Return the clip of a decision in one cell.

    It goes from the state before it to that after its last valid control step. `course` are the people before it and
    after each of its K control steps.
    """
    kept = np.flatnonzero(result.valid[0].numpy())
    steps = result.steps
    states = [before, *(steps[k] for k in kept)]
    people = np.stack([people_of(crowd) for crowd in (course[0], *(course[k + 1] for k in kept))])
    people[..., 2] = np.unwrap(people[..., 2], axis=0)
    return Clip(
        time=np.arange(len(states), dtype=np.float64) * CONTROL_STEP_S,
        joints=np.concatenate([state.joint_pos.numpy() for state in states]),
        people=people,
        props=np.stack([props_of(scene, task, state) for state in states]),
        floor_z=scene.floor_z,
    )


def still_clip(scene: Scene, task: Subtask, state: State, crowd: Crowd) -> Clip:
    """Return the clip of one instant."""
    props = props_of(scene, task, state)[None]
    return Clip(np.zeros(1), state.joint_pos.numpy().copy(), people_of(crowd)[None], props, scene.floor_z)


def people_of(crowd: Crowd) -> Array:
    """Return the people (P, 23) of one cell as `Clip.people` has them."""
    rows = [[*walk.position.T, walk.yaw, *gait(walk), *walk.limbs.reshape(1, -1).T] for walk in crowd.walks]
    return np.array(rows)[..., 0]


def props_of(scene: Scene, task: Subtask, state: State) -> Array:
    """Return the positions (P, 3) m of the props of one cell, NaN where one is not there."""
    props = np.full((len(scene.mocap) - scene.first_prop, 3), np.nan)
    if task.points:
        props[: task.points] = state.points[0, : task.points].numpy()
    else:
        kinds = state.kinds[0].numpy()
        props[scene.object_prop(np.arange(len(kinds)), kinds)] = rendered_positions(state, task)[0]
    return props
