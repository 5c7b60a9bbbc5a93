"""Clips of a session: a decision, or one instant."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans import Walk, gait
from hrl_comfort.plots.clip import Array, Clip
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.objects import rendered_positions
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, Subtask


def decision_clip(
    scene: Scene, task: Subtask, before: State, walk: Walk, result: StepResult, walks: list[Walk]
) -> Clip:
    """Return the clip of a decision in one cell.

    It goes from the state and walk before it to those after its last valid control step. `walks` are those after
    each of its K control steps.
    """
    kept = np.flatnonzero(result.valid[0].numpy())
    steps = result.steps
    states = [before, *(steps[k] for k in kept)]
    x_y = np.concatenate([state.human_pos.numpy() for state in states])
    yaw = np.unwrap(np.concatenate([state.human_yaw.numpy() for state in states]))
    walked = [walk, *(walks[k] for k in kept)]
    gaits = [np.column_stack([*gait(each), each.limbs.reshape(len(each.limbs), -1)]) for each in walked]
    return Clip(
        time=np.arange(len(states), dtype=np.float64) * CONTROL_STEP_S,
        joints=np.concatenate([state.joint_pos.numpy() for state in states]),
        person=np.column_stack([x_y, yaw, np.concatenate(gaits)]),
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
    props = np.full((len(scene.mocap) - scene.first_prop, 3), np.nan)
    if task.points:
        props[: task.points] = state.points[0, : task.points].numpy()
    else:
        kinds = state.kinds[0].numpy()
        props[scene.object_prop(np.arange(len(kinds)), kinds)] = rendered_positions(state, task)[0]
    return props
