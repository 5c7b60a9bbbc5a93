"""Episodes of N cells: their starts, controls and results.

The caller runs the physics (`engine` in batches, `envs.dm` one cell at a time): it applies the controls of
`apply_action` and passes the sensor readings to `advance`. All environments share this definition of an
episode; every random number of it comes from (seed, row, episode).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.comfort.adapt import max_episode_steps, with_comfort
from hrl_comfort.comfort.sources import make_source
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.balls import rendered_positions, target_ball, update_placed
from hrl_comfort.sim.cartesian import CartesianHand
from hrl_comfort.sim.controls import limbs_of, pack_controls
from hrl_comfort.sim.disturbance import Disturbance, blocking_place
from hrl_comfort.sim.episode_sampler import ATTEMPTS, DISTURBANCE_STREAM, Draw, EpisodeSampler
from hrl_comfort.sim.initial_state import InitialState
from hrl_comfort.sim.sensors import Sensors
from hrl_comfort.sim.step_result import StepResult, compute_step, reward_weights, source_input
from hrl_comfort.tasks import State, Subtask, subtask

Array = NDArray[np.float64]
Probe = Callable[[Array, Array], Array]
"""(joints (r, 12): angles rad, velocities rad/s; control (r, ncontrol)) -> sensordata (r, nsensor)."""


class Episodes:
    """The episodes of `rows` cells.

    With an `evaluation` set, row r runs the set's entry r (modulo its length). `measure_arm` fills
    `State.arm_distance` even if no reward needs it; `disturbance` is one of `config.DISTURBANCES`.
    """

    def __init__(
        self,
        scene: Scene,
        config: EnvConfig,
        rows: int,
        seed: int,
        evaluation: EvaluationSet | None = None,
        measure_arm: bool = False,
        disturbance: str = "none",
    ) -> None:
        self.scene, self.config, self.rows = scene, config, rows
        plain = subtask(config.task.name, config.task.observation, config.task.balls)
        self.subtask: Subtask = with_comfort(plain, config.comfort, config.task.max_step_deg)
        weights = reward_weights(config.reward, config.comfort.scale)
        self.reward_names = tuple(self.subtask.rewards)
        self._weights = torch.tensor([weights[name] for name in self.reward_names], dtype=torch.float64)
        self.precision_m = config.task.precision.grasp_tolerance_m
        self._hand = CartesianHand(scene, config.task) if config.task.action == "cartesian" else None

        self.sampler = EpisodeSampler(scene, config, self.subtask, seed, evaluation)
        self._drops = self.sampler.goals[1:]
        self._initial_state = InitialState(scene, config)
        self._disturbance = Disturbance(disturbance, rows)

        n = rows
        self.episode = np.full(n, -1, dtype=np.int64)
        self._ready = np.zeros(n, dtype=bool)
        self.noise = np.zeros((n, self.sampler.horizon, humans.NOISE))
        self.source = make_source(config.comfort, n)
        paid = config.comfort.distance == "arm" and config.comfort.source != "none"
        self._sensors = Sensors(scene, measure_arm or paid)
        self.balls = np.zeros((n, config.task.balls, 3))
        self.colours = np.zeros((n, config.task.balls), dtype=np.int64)
        self.spawn_id = np.zeros(n, dtype=np.int64)
        self.motion_id = np.full(n, -1, dtype=np.int64)
        self.points = np.zeros((n, 2, 3))
        self.precision = np.full(n, self.precision_m)
        self.joint_target = np.zeros((n, 6))
        self.start = np.zeros((n, 18))
        """Angles, velocities and servo targets of the joints at the start (`sim.starts`)."""
        self.steps = np.zeros(n, dtype=np.int64)
        self.walk = humans.begin(config.human, np.zeros((n, 2)))
        self.state: State | None = None
        self._planned: dict[str, NDArray[Any]] = {}
        self._walks = self.walk

    def begin(self, rows: NDArray[np.int64], probe: Probe) -> Array:
        """Begin the next episode of `rows`; return their joints (r, 12): angles rad, velocities rad/s.

        Draws are repeated until the cell begins free of contact and unsolved.

        Raises:
          ConfigError: no such start was found.
        """
        self.episode[rows] += 1
        return self._begin(rows, {row: self.sampler.attempts(int(row), int(self.episode[row])) for row in rows}, probe)

    def replay(self, rows: NDArray[np.int64], entries: EvaluationSet, probe: Probe) -> Array:
        """Begin the episodes `entries` (r,) of an evaluation split in `rows` (r,); return as `begin` does.

        The next episode that the rows begin is the one that they would have begun now.
        """
        sampler = EpisodeSampler(self.scene, self.config, self.subtask, 0, entries)
        return self._begin(rows, {row: sampler.attempts(index, 0) for index, row in enumerate(rows)}, probe)

    def _begin(self, rows: NDArray[np.int64], attempts: dict[int, Iterator[Draw]], probe: Probe) -> Array:
        self.steps[rows], self.precision[rows] = 0, self.precision_m
        pending = rows
        for _ in range(ATTEMPTS):
            for row in pending:
                self._take(row, next(attempts[row]))
                self._disturb(int(row))
            self.source.begin(pending)
            fresh = humans.begin(self.config.human, self.walk.spawn[pending])
            self.walk = self.walk.put(pending, fresh)
            limbs = limbs_of(self.scene, fresh)
            # The control holds the robot and the human where they begin.
            control = self._controls(self.start[pending, None, 12:], limbs, self.balls[pending], pending)[:, 0]
            sensed = probe(self.start[pending, :12], control)
            state = self._begun(pending, fresh, limbs, sensed)
            self._put(pending, state)
            solved = self.subtask.next_stage(state) > 0
            bad = (solved | self.subtask.failure(state)).numpy()
            pending = pending[bad]
            if not len(pending):
                self._ready[rows] = True
                return self.start[rows, :12]
        raise ConfigError(f"no free start for {self.subtask.name} in rows {pending.tolist()} after {ATTEMPTS} attempts")

    def rewind(self) -> None:
        """Restart each row from its first episode, which is to begin before the next decision."""
        self.episode[:] = -1
        self._ready[:] = False

    def _take(self, row: int, draw: Draw) -> None:
        self.balls[row], self.colours[row], self.noise[row] = draw.balls, draw.colours, draw.noise
        self.source.draws[row] = draw.level
        self.motion_id[row], self.spawn_id[row] = draw.motion_id, draw.spawn_id
        self.start[row], self.joint_target[row] = draw.start, draw.start[12:]
        self.points[row], self.walk.spawn[row] = draw.points, draw.spawn

    def _disturb(self, row: int) -> None:
        if self._disturbance.kind == "drop":
            rng = self.sampler.generator(row, int(self.episode[row]), DISTURBANCE_STREAM)
            self._disturbance.begin(row, rng)
        elif self._disturbance.kind == "block":
            drop = self._drops[self.colours[row, 0], :2]
            self.spawn_id[row] = -1
            self.walk.spawn[row] = blocking_place(drop, self.config.human.keep_out_m)

    def apply_action(self, action: Array) -> Array:
        """Return the controls (N, K * substeps, ncontrol) of a decision; action (N, 6) in [-1, 1].

        Joint targets are ramped at up to `max_step_deg` a control step; the human walks on meanwhile.

        Raises:
          RuntimeError: a row has no episode yet.
        """
        if not self._ready.all():
            raise RuntimeError("there is no episode yet: call reset before step")
        task, substeps = self.config.task, self.config.engine.substeps
        steps = task.action_repeat
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        if self._hand is None:
            increment = action * np.radians(task.max_step_deg)
        else:
            increment = self._hand.increments(self.joint_target, action)
        ramp = np.arange(1, steps * substeps + 1) / substeps
        targets = self.joint_target[:, None] + ramp[:, None] * increment[:, None]
        lowest, highest = self.scene.joint_range.T
        targets = np.minimum(np.maximum(targets, lowest), highest)

        times = self.steps[:, None] + np.arange(steps)
        self._walks = self._walked(times)
        limbs = limbs_of(self.scene, self._walks)
        self._planned = {
            "joint_target": targets[:, substeps - 1 :: substeps].reshape(-1, 6),
            "human_pos": self._walks.position,
            "human_yaw": self._walks.yaw,
            "human_seen": self._seen(self._walks.position),
            "steps": times.reshape(-1) + 1,
            "limbs": limbs,
        }
        assert self.state is not None
        return self._controls(targets, limbs, rendered_positions(self.state, self.subtask))

    def advance(self, sensed: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Return the result of a decision from its sensor readings (N, K * substeps, nsensor).

        A decision ends where its stage or its episode does, so that the next one, perhaps of another policy,
        begins there. The caller takes each row's physics from the end of its last valid control step.
        Readings may be those of some `rows` (r,): see `Engine.step`.
        """
        assert self.state is not None
        substeps = self.config.engine.substeps
        sensed = sensed[:, substeps - 1 :: substeps].reshape(-1, sensed.shape[-1])
        if rows is None:
            moving = self._sensors.read(sensed, self._planned)
        else:
            moving = self._sensors.read_rows(sensed, self._planned, rows, self.state)
        limit = max_episode_steps(self.state.level, self.config.task.max_episode_steps, self.config.comfort)
        result = compute_step(self.subtask, self._weights, limit, self.state, moving)
        before, level = self.state.stage, self._next_level(result)
        state = update_placed(result.state.with_(level=level), before, self.subtask)
        self.state = self._disturbed(state)
        result = replace(result, state=self.state)
        steps = self.state.steps.numpy().copy()
        first = np.arange(self.rows) * self.config.task.action_repeat
        self.walk = self._walks.rows(first + np.maximum(steps - self.steps - 1, 0))
        self.steps = steps
        self.joint_target = self.state.joint_target.numpy().copy()
        return result

    def aim(self, rows: Tensor, ball: Tensor) -> None:
        """Make the balls (r,) the targets of `rows` (r,).

        Raises:
          ValueError: a row is not to pick now, or the ball has been placed.
        """
        assert self.state is not None
        self.state = target_ball(self.state, rows, ball, self.subtask)

    def _walked(self, times: NDArray[np.int64]) -> humans.Walk:
        """Return the walks, N * K rows, over the control steps that begin at `times` (N, K)."""
        assert self.state is not None
        keep_out, tcp = self.sampler.keep_out(self.points), self.state.tcp_pos.numpy()[:, :2]
        stands = self._disturbance.stands(times)
        noise = self.noise[np.arange(self.rows)[:, None], np.minimum(times, self.noise.shape[1] - 1)]
        walk, walks = self.walk, []
        for k in range(times.shape[1]):
            before, walk = walk, humans.advance(self.config.human, walk, noise[:, k], tcp, keep_out)
            standing = np.flatnonzero(stands[:, k])
            walk = walk.put(standing, before.rows(standing)) if len(standing) else walk
            walks.append(walk)
        return humans.Walk.along(walks)

    def _controls(self, targets: Array, limbs: Array, balls: Array, rows: Any = slice(None)) -> Array:
        """Return the controls of `rows`; see `pack_controls`."""
        points = self.points[rows, : self.subtask.points]
        return pack_controls(self.scene, targets, limbs, balls, self.colours[rows], points)

    def _seen(self, position: Array) -> Array:
        return humans.seen_position(self.config.human, position, self.sampler.spawns)

    def _disturbed(self, state: State) -> State:
        """Return the state with the balls that a disturbance knocks out of the gripper back on their table."""
        if self._disturbance.kind != "drop":
            return state
        held = self.subtask.releasing(state.stage)
        lost = torch.from_numpy(self._disturbance.drops(held.numpy()))
        return state.with_(stage=state.stage - lost.long())

    def _next_level(self, result: StepResult) -> Tensor:
        """Return the level (N,) at which the next decision is made; `state` is still that before this one."""
        assert self.state is not None
        if self.config.comfort.source == "none":
            return self.state.level
        return torch.from_numpy(self.source.advance(source_input(self.state, result)))

    def _begun(self, rows: NDArray[np.int64], walk: humans.Walk, limbs: Array, sensed: Array) -> State:
        """Return the first instant of the episodes of `rows` (r,), with the humans at `walk`."""
        planned = {
            "joint_target": self.start[rows, 12:],
            "human_pos": walk.position,
            "human_yaw": walk.yaw,
            "human_seen": self._seen(walk.position),
            "steps": np.zeros(len(rows), dtype=np.int64),
            "limbs": limbs,
        }
        return self._initial_state(
            self._sensors.read(sensed, planned),
            self.balls[rows],
            self.colours[rows],
            self.points[rows],
            self.source.level[rows],
            self.precision[rows],
        )

    def _put(self, rows: NDArray[np.int64], fresh: State) -> None:
        """Replace the state of `rows` by `fresh` (r rows)."""
        if self.state is not None:
            self.state = self.state.put(torch.from_numpy(rows), fresh)
        elif len(rows) == self.rows:
            self.state = fresh
        else:
            raise ConfigError("the first reset must reset every row")

    _ARRAYS = (
        "episode", "noise", "balls", "colours", "spawn_id", "motion_id", "points", "precision",
        "joint_target", "start", "steps",
    )  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as tensors and plain numbers."""
        assert self.state is not None
        return {
            "precision_m": self.precision_m,
            "walk": {name: torch.from_numpy(np.array(value)) for name, value in vars(self.walk).items()},
            "state": dict(vars(self.state)),
            "source": self.source.state_dict(),
            "disturbance": self._disturbance.state_dict(),
            **{name: torch.from_numpy(getattr(self, name).copy()) for name in self._ARRAYS},
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.precision_m = saved["precision_m"]
        self.walk = humans.Walk(**{name: value.numpy().copy() for name, value in saved["walk"].items()})
        self.state = State(**saved["state"])
        self.source.load_state_dict(saved["source"])
        self._disturbance.load_state_dict(saved["disturbance"])
        for name in self._ARRAYS:
            setattr(self, name, saved[name].numpy().copy())
        self._ready[:] = True
