"""Clips of a session: a decision, or one instant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans import gait
from hrl_comfort.plots.clip import Array, Clip
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.objects import rendered_positions
from hrl_comfort.sim.people import Crowd
from hrl_comfort.sim.physics import Rollout
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, Subtask


def decision_clip(engine: Engine, before: State, result: StepResult) -> Clip:
    """Return the clip of the decision that an engine of one cell has just run.

    It goes from the state before it to that after its last valid control step.
    """
    scene, task, course = engine.scene, engine.episodes.subtask, engine.episodes.people.course
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
        bodies=None if scene.gripper is None else _course(engine, kept),
    )


def _course(engine: Engine, kept: NDArray[np.int64]) -> Array:
    """Return `Clip.bodies` before the latest decision and after each of its control steps `kept`."""
    assert isinstance(engine.physics, Rollout)
    steps = [0, *(kept + 1) * engine.episodes.config.substeps]
    return engine.physics.course[0, steps, 1 : 1 + engine.scene.model.nq]


def still_clip(engine: Engine) -> Clip:
    """Return the clip of an engine of one cell as it is now."""
    scene, episodes = engine.scene, engine.episodes
    assert episodes.state is not None
    props = props_of(scene, episodes.subtask, episodes.state)[None]
    people = people_of(episodes.people.now)[None]
    bodies = None if scene.gripper is None else engine.physics.state[:, 1 : 1 + scene.model.nq].copy()
    return Clip(np.zeros(1), episodes.state.joint_pos.numpy().copy(), people, props, scene.floor_z, bodies)


def people_of(crowd: Crowd) -> Array:
    """Return the people (P, 23) of one cell as `Clip.people` has them."""
    rows = [[*walk.position.T, walk.yaw, *gait(walk), *walk.limbs.reshape(1, -1).T] for walk in crowd.walks]
    return np.array(rows)[..., 0]


def props_of(scene: Scene, task: Subtask, state: State) -> Array:
    """Return the positions (P, 3) m of the props of one cell, NaN where one is not there."""
    props = np.full((len(scene.mocap) - scene.first_prop, 3), np.nan)
    if scene.loose:
        return props
    if task.points:
        props[: task.points] = state.points[0, : task.points].numpy()
    else:
        kinds = state.kinds[0].numpy()
        props[scene.object_prop(np.arange(len(kinds)), kinds)] = rendered_positions(state, task)[0]
    return props
