"""The batched engine: N cells stepped together by `mujoco.rollout`, with partial resets."""

from copy import copy
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.config import EnvConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.scene.links import vary_links
from hrl_comfort.scene.workcell import CONTROL_SPEC, build_scene
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State
from hrl_comfort.threads import Threads

Array = NDArray[np.float64]


def physics_of(joints: Array) -> Array:
    """Return the physics (r, nstate) at time 0 of joints (r, 2 J): angles rad, velocities rad/s."""
    return np.concatenate([np.zeros((len(joints), 1)), joints], axis=1)


class Engine:
    """N cells of one model, or of N whose links differ; `reset` starts episodes, `step` runs a decision."""

    def __init__(
        self,
        config: EnvConfig,
        rows: int,
        seed: int,
        evaluation: EvaluationSet | None = None,
        measure_arm: bool = False,
        disturbance: str = "none",
    ) -> None:
        self.scene = build_scene(config.robot, config.cell, config.engine.substeps, config.task.objects)
        self.episodes = Episodes(self.scene, config, rows, seed, evaluation, measure_arm, disturbance)
        self.num_envs = rows
        self._models = [copy(self.scene.model) for _ in range(rows if config.randomise.links else 0)]
        """One a row, where links differ from the model."""
        self._data = [mujoco.MjData(self.scene.model) for _ in range(config.engine.threads)]
        self._rollout = Threads(config.engine.threads)
        self.physics = np.zeros((rows, self.scene.nstate))
        """(N, nstate) mjSTATE_FULLPHYSICS: time, qpos, qvel."""

    def reset(self, rows: NDArray[np.int64] | None = None, entries: EvaluationSet | None = None) -> State:
        """Begin the next episode of `rows` (all by default) and return the state of every row.

        With `entries` (r,) of an evaluation split the rows begin these; see `Episodes.begin`.
        """
        rows = np.arange(self.num_envs) if rows is None else rows
        if len(rows):
            self.physics[rows] = physics_of(self.episodes.begin(rows, self._probe, entries))
            self._vary(rows)
        assert self.episodes.state is not None
        return self.episodes.state

    def step(self, action: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Run one decision, action (N, A) in [-1, 1], and return its result.

        If `rows` (r,) are given, only these are run; the others are void in the result and must be reset
        before they are stepped again.

        Raises:
          RuntimeError: a row has no episode yet.
          ValueError: the actions are of another shape, or there are no rows, with which MuJoCo would crash.
        """
        if rows is not None and not len(rows):
            raise ValueError("rows=[] is not allowed; name at least one row")
        at = slice(None) if rows is None else rows
        physics = self.physics.copy()
        states, sensed = [], []
        for control in self.episodes.controls(action, lambda: physics[:, 1:]):
            reached, readings = self._run(physics[at], control[at], rows)
            physics[at] = reached[:, -1]
            states.append(reached)
            sensed.append(readings)
        result = self.episodes.advance(np.concatenate(sensed, axis=1), rows)
        taken = result.decision_steps.numpy()[at] * self.episodes.config.engine.substeps
        self.physics[at] = np.concatenate(states, axis=1)[np.arange(len(taken)), taken - 1]
        return result

    def _probe(self, joints: Array, control: Array) -> Array:
        # Readings belong to the instant before a physics step is integrated: one step senses the start.
        # Another mass or friction makes no difference to them.
        sensed = self._rollout.rollout(
            self.scene.model, self._data, physics_of(joints), control[:, None], control_spec=CONTROL_SPEC
        )[1]
        return sensed[:, 0]

    def _run(self, physics: Array, control: Array, rows: NDArray[np.int64] | None) -> tuple[Array, Array]:
        """Return states and sensors (r, K * substeps, ...) of `rows` (r,), all by default."""
        models = [self.scene.model] * len(physics)
        if self._models:
            models = self._models if rows is None else [self._models[row] for row in rows]
        n, steps = control.shape[:2]
        states, sensed = np.empty((n, steps, self.scene.nstate)), np.empty((n, steps, self.scene.model.nsensordata))
        # The checks of the shapes would take a sixth as long as one cell's physics.
        self._rollout.rollout(
            models, self._data, physics, control, control_spec=CONTROL_SPEC, skip_checks=True, nstep=steps,
            state=states, sensordata=sensed,
        )  # fmt: skip
        return states, sensed

    def _vary(self, rows: NDArray[np.int64]) -> None:
        """Give the links of `rows` the mass and friction of their episodes."""
        if self._models:
            values = self.episodes.values()
            for row in rows:
                vary_links(self._models[row], self.scene.model, values.mass[row], values.friction[row])

    def close(self) -> None:
        """Stop the threads."""
        self._rollout.close()

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        return {"physics": torch.from_numpy(self.physics.copy()), "episodes": self.episodes.state_dict()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.physics = saved["physics"].numpy().copy()
        self.episodes.load_state_dict(saved["episodes"])
        self._vary(np.arange(self.num_envs))
