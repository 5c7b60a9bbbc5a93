"""dm_control front: one cell as a `dm_control.rl.control.Environment`."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import glfw
import mujoco
import numpy as np
from dm_control.mujoco import Physics
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.envs.inputs import SEEDS, checked_action, episode_seed
from hrl_comfort.scene.camera import PACKAGES, PicturesUnavailableError
from hrl_comfort.scene.workcell import CONTROL_SPEC, Scene, scene_of
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.sim.variation.bodies import vary
from hrl_comfort.sim.variation.randomisation import Values

Array = NDArray[np.float64]
STATE_SPEC = mujoco.mjtState.mjSTATE_FULLPHYSICS


class CellPhysics(Physics):
    """Physics that runs a queue of controls, one a substep, and records the sensors at each."""

    moving: NDArray[np.int64]
    """`Scene.moving` of the cell."""

    def queue(self, controls: Iterator[Array]) -> None:
        """Set the controls of the next decision, parts of (1, T, ncontrol), which are made when they are due."""
        self._queue = controls

    @property
    def joints(self) -> Array:
        """(1, 2 J) angles, rad, and velocities, rad/s."""
        whole = np.concatenate([[0.0], self.data.qpos, self.data.qvel])
        return whole[self.moving][None]

    def step(self, nstep: int = 1) -> None:
        """Advance `nstep` substeps along the queue; dm_control calls this once a decision."""
        model, data = self.model.ptr, self.data.ptr
        self.sensed: Array = np.zeros((nstep, self.model.nsensordata))
        self._after: Array = np.zeros((nstep, mujoco.mj_stateSize(model, STATE_SPEC)))
        for index, given in enumerate(each for part in self._queue for each in part[0]):
            mujoco.mj_setState(model, data, given, CONTROL_SPEC)
            mujoco.mj_step(model, data)
            self.sensed[index] = data.sensordata
            mujoco.mj_getState(model, data, self._after[index], STATE_SPEC)

    def back_to(self, substep: int) -> None:
        """Restore the state after `substep` of the queue, where the decision ended."""
        if substep < len(self._after) - 1:
            mujoco.mj_setState(self.model.ptr, self.data.ptr, self._after[substep], STATE_SPEC)
            mujoco.mj_forward(self.model.ptr, self.data.ptr)

    def change(self, change: Callable[[Array], None]) -> None:
        """Let `change` alter the state (1, nstate) in place."""
        model, data = self.model.ptr, self.data.ptr
        state = np.zeros((1, mujoco.mj_stateSize(model, STATE_SPEC)))
        mujoco.mj_getState(model, data, state[0], STATE_SPEC)
        before = state.copy()
        change(state)
        if not np.array_equal(state, before):
            mujoco.mj_setState(model, data, state[0], STATE_SPEC)
            mujoco.mj_forward(model, data)

    @property
    def contexts(self) -> Any:
        """OpenGL of dm_control's own pictures.

        Raises:
          PicturesUnavailableError: dm_control chose GLFW and there is no display. MuJoCo cannot draw in this process
            after an attempt without one.
        """
        if self._contexts is None and os.environ.get("MUJOCO_GL", "glfw") == "glfw" and not glfw.init():
            raise PicturesUnavailableError(
                "no pictures: there is no display; set MUJOCO_GL=egl before Python starts "
                f"(on Debian or Ubuntu: apt-get install {PACKAGES})"
            )
        return super().contexts

    def sense(self, bodies: Array, control: Array) -> Array:
        """Return sensordata (nsensor,) of bodies at (nq + nv,) under control (ncontrol,)."""
        model, data = self.model.ptr, self.data.ptr
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = np.split(bodies, [model.nq])
        mujoco.mj_setState(model, data, control, CONTROL_SPEC)
        mujoco.mj_forward(model, data)
        return np.array(data.sensordata)


class CellTask(control.Task):
    """A subtask as a dm_control task, for the episodes of one row; a copy or a pickle goes on where it is."""

    def __init__(self, scene: Scene, config: EnvConfig, seed: int) -> None:
        self.episodes = Episodes(scene, config, rows=1, seed=episode_seed(seed))
        self.outcome: StepResult | None = None
        self._state = np.random.RandomState(seed)

    @property
    def _random(self) -> np.random.RandomState:
        """Generator by which clients of dm_control seed a task: setting one restarts the episodes from a seed of it."""
        return self._state

    @_random.setter
    def _random(self, state: np.random.RandomState) -> None:
        self._state = state
        self.episodes.rewind(episode_seed(state.randint(SEEDS, dtype=np.uint64)))

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name != "episodes"}
        built = self.episodes.scene, self.episodes.config, 1, self.episodes.sampler.seed
        return kept | {"built": built, "state": self.episodes.state_dict()}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.episodes = Episodes(*kept.pop("built"))
        self.episodes.load_state_dict(kept.pop("state"))
        self.__dict__.update(kept)

    def initialize_episode(self, physics: CellPhysics) -> None:
        """Start the next episode of the row."""
        self.outcome = None

        def probe(rows: NDArray[np.int64], bodies: Array, ctrl: Array, values: Values) -> Array:
            vary([physics.model.ptr], self.episodes.scene, values)
            return physics.sense(bodies[0], ctrl[0])[None]

        self.episodes.begin(np.array([0]), probe)

    def before_step(self, action: Array, physics: CellPhysics) -> None:
        """Queue the controls of the decision; raise ValueError unless `action` is (A,) finite numbers."""
        checked = checked_action(action, (self.episodes.action_dim,))[None]
        physics.queue(self.episodes.controls(checked, lambda: physics.joints))

    def after_step(self, physics: CellPhysics) -> None:
        """Compute the result of the decision."""
        self.outcome = self.episodes.advance(physics.sensed[None])
        substeps = self.episodes.config.substeps
        physics.back_to(int(self.outcome.decision_steps[0]) * substeps - 1)
        if self.episodes.config.robot.gripper.holds:
            physics.change(partial(self.episodes.lay, self.outcome))

    def action_spec(self, physics: CellPhysics) -> specs.BoundedArray:
        """Return the action spec: (A,) in [-1, 1]."""
        largest = np.ones(self.episodes.action_dim)
        return specs.BoundedArray(largest.shape, np.float64, -largest, largest, name="action")

    def get_observation(self, physics: CellPhysics) -> OrderedDict[str, Array]:
        """Return the named observation terms, unbatched."""
        state = self.episodes.state
        assert state is not None
        terms, seen = self.episodes.subtask.observations, self.episodes.observed(state)
        return OrderedDict((name, term(seen)[0].numpy().copy()) for name, term in terms.items())

    def get_reward(self, physics: CellPhysics) -> float:
        """Return the reward of the decision."""
        assert self.outcome is not None
        return float(self.outcome.reward[0])

    def get_termination(self, physics: CellPhysics) -> float | None:
        """Return the final discount: 0 on success or collision, 1 at the time limit, None during the episode."""
        assert self.outcome is not None
        if self.outcome.terminated[0]:
            return 0.0
        return 1.0 if self.outcome.truncated[0] else None


def make_environment(config: EnvConfig, seed: int, flat_observation: bool = False) -> control.Environment:
    """Return the subtask of `config` as a dm_control environment with the episodes of row 0 of `seed`.

    A `step` is a decision. At `task.max_episode_steps` an episode ends with discount 1 (truncation). With
    `flat_observation` the terms of the observation are one array, `observations`.

    Raises:
      ConfigError: `seed` is not a whole number from 0 to 2**32 - 1.
    """
    scene = scene_of(config)
    physics = CellPhysics.from_xml_string(scene.xml, dict(scene.assets))
    physics.moving = scene.moving
    task = CellTask(scene, config, seed)
    # dm_control reads the observation spec before the first reset, which needs a state.
    task.initialize_episode(physics)
    task.episodes.rewind()
    decision_s = CONTROL_STEP_S * config.task.action_repeat
    return control.Environment(physics, task, control_timestep=decision_s, flat_observation=flat_observation)


__all__ = ["CellPhysics", "CellTask", "make_environment"]
