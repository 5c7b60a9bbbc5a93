"""Episodes of N cells: how they begin, what moves the robot and the human, how they are judged.

Physics is left to the caller (`engine` in batches, `envs.dm` one cell at a time): it runs the controls
that `apply_action` returns and hands the sensor readings to `advance`. All fronts so share one definition of an
episode, and every random draw of it comes from (seed, row, episode).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort import humans
from hrl_comfort.comfort.adapt import TERM, max_episode_steps, with_comfort
from hrl_comfort.comfort.metrics import human_distance
from hrl_comfort.comfort.sources import SourceInput, make_source
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError, EnvConfig, RewardConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.workcell import Scene, ball_props
from hrl_comfort.sim.arm_distance import ArmDistance
from hrl_comfort.sim.balls import rendered_positions, target_ball, update_placed
from hrl_comfort.sim.cartesian import CartesianHand
from hrl_comfort.sim.disturbance import Disturbance, blocking_place
from hrl_comfort.sim.episode_sampler import ATTEMPTS, DISTURBANCE_STREAM, Draw, EpisodeSampler
from hrl_comfort.sim.step_result import StepResult, compute_step
from hrl_comfort.tasks import State, Subtask, subtask

Array = NDArray[np.float64]
Probe = Callable[[Array, Array], Array]
"""(joints (r, 12): angles rad, velocities rad/s; control (r, ncontrol)) -> sensordata (r, nsensor)."""


def weights_of(reward: RewardConfig, comfort_scale: float) -> dict[str, float]:
    """Return the weight of every reward term by its name; k1, k2 and k3 are those of Eq. 1."""
    weights = {**vars(reward), TERM: comfort_scale}
    for name, k in (("pick", reward.k1), ("place", reward.k2), ("home", reward.k3)):
        weights[name] *= k
    return weights


class Episodes:
    """The episodes of `rows` cells.

    With an `evaluation` set, row r runs the set's entry r (modulo its length): its spawn, motion and seed.
    `measure_arm` fills `State.arm_distance` even where no reward asks for it; `disturbance` is one of
    `sim.disturbance`.
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
        weights = weights_of(config.reward, config.comfort.scale)
        self.reward_names = tuple(self.subtask.rewards)
        self._weights = torch.tensor([weights[name] for name in self.reward_names], dtype=torch.float64)
        self.precision_m = config.task.precision.grasp_tolerance_m
        self._hand = CartesianHand(scene, config.task) if config.task.action == "cartesian" else None

        self.draws = EpisodeSampler(scene, config, self.subtask, seed, evaluation)
        self._drops = self.draws.goals[1:]
        self._tcp_home: Array | None = None
        self._disturbance = Disturbance(disturbance, rows)

        n = rows
        self.episode = np.full(n, -1, dtype=np.int64)
        self.noise = np.zeros((n, self.draws.horizon, humans.NOISE))
        self.source = make_source(config.comfort, n)
        arm = measure_arm or (config.comfort.distance == "arm" and config.comfort.source != "none")
        self._arm = ArmDistance(scene) if arm else None
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

    # ---- beginning -------------------------------------------------------------------------------------

    def begin(self, rows: NDArray[np.int64], probe: Probe) -> Array:
        """Begin the next episode of `rows`; return their joints (r, 12): angles rad, velocities rad/s.

        EpisodeSampler are repeated until the cell begins free of contact and unsolved.

        Raises:
          ConfigError: no such beginning was found.
        """
        self.episode[rows] += 1
        self.steps[rows], self.precision[rows] = 0, self.precision_m
        attempts = {row: self.draws.attempts(int(row), int(self.episode[row])) for row in rows}
        pending = rows
        for _ in range(ATTEMPTS):
            for row in pending:
                self._take(row, next(attempts[row]))
                self._disturb(int(row))
            self.source.begin(pending)
            fresh = humans.begin(self.config.human, self.walk.spawn[pending])
            self.walk = self.walk.put(pending, fresh)
            limbs = self._limbs(fresh)
            # The control holds the robot and the human where they begin.
            control = self._pack(self.start[pending, None, 12:], limbs, self.balls[pending], pending)[:, 0]
            sensed = probe(self.start[pending, :12], control)
            state = self._begun(pending, fresh, limbs, sensed)
            self._put(pending, state)
            solved = self.subtask.next_stage(state) > 0
            bad = (solved | self.subtask.failure(state)).numpy()
            pending = pending[bad]
            if not len(pending):
                return self.start[rows, :12]
        raise ConfigError(f"no free start for {self.subtask.name} in rows {pending.tolist()} after {ATTEMPTS} attempts")

    def rewind(self) -> None:
        """Let each row's next episode be its first again."""
        self.episode[:] = -1

    def _take(self, row: int, draw: Draw) -> None:
        self.balls[row], self.colours[row], self.noise[row] = draw.balls, draw.colours, draw.noise
        self.source.draws[row] = draw.level
        self.motion_id[row], self.spawn_id[row] = draw.motion_id, draw.spawn_id
        self.start[row], self.joint_target[row] = draw.start, draw.start[12:]
        self.points[row], self.walk.spawn[row] = draw.points, draw.spawn

    def _disturb(self, row: int) -> None:
        if self._disturbance.kind == "drop":
            rng = self.draws.generator(row, int(self.episode[row]), DISTURBANCE_STREAM)
            self._disturbance.begin(row, rng)
        elif self._disturbance.kind == "block":
            drop = self._drops[self.colours[row, 0], :2]
            self.spawn_id[row] = -1
            self.walk.spawn[row] = blocking_place(drop, self.config.human.keep_out_m)

    # ---- one decision ----------------------------------------------------------------------------------

    def apply_action(self, action: Array) -> Array:
        """Return the controls (N, K * substeps, ncontrol) of a decision; action (N, 6) in [-1, 1].

        Joint targets are ramped at up to `max_step_deg` a control step. The human walks on meanwhile.
        """
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
        limbs = self._limbs(self._walks)
        self._planned = {
            "joint_target": targets[:, substeps - 1 :: substeps].reshape(-1, 6),
            "human_pos": self._walks.position,
            "human_yaw": self._walks.yaw,
            "human_seen": self._seen(self._walks.position),
            "steps": times.reshape(-1) + 1,
            "limbs": limbs,
        }
        assert self.state is not None
        return self._pack(targets, limbs, rendered_positions(self.state, self.subtask))

    def advance(self, sensed: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Judge a decision from its sensor readings (N, K * substeps, nsensor).

        A decision ends where its stage or its episode does: whatever acts next, perhaps another policy,
        decides anew. The caller takes each row's physics from the end of its last valid control step.
        Readings may be those of some `rows` (r,): see `Engine.step`.
        """
        assert self.state is not None
        substeps = self.config.engine.substeps
        sensed = sensed[:, substeps - 1 :: substeps].reshape(-1, sensed.shape[-1])
        moving = self._moving(sensed, self._planned) if rows is None else self._moved(sensed, rows)
        limit = max_episode_steps(self.state.level, self.config.task.max_episode_steps, self.config.comfort)
        outcome = compute_step(self.subtask, self._weights, limit, self.state, moving)
        before, level = self.state.stage, self._next_level(outcome)
        state = update_placed(outcome.state.with_(level=level), before, self.subtask)
        self.state = self._disturbed(state)
        outcome = replace(outcome, state=self.state)
        steps = self.state.steps.numpy().copy()
        first = np.arange(self.rows) * self.config.task.action_repeat
        self.walk = self._walks.rows(first + np.maximum(steps - self.steps - 1, 0))
        self.steps = steps
        self.joint_target = self.state.joint_target.numpy().copy()
        return outcome

    def aim(self, rows: Tensor, ball: Tensor) -> None:
        """Let `rows` (r,) pick the balls (r,) next.

        Raises:
          ValueError: a row is not to pick now, or the ball has been placed.
        """
        assert self.state is not None
        self.state = target_ball(self.state, rows, ball, self.subtask)

    # ---- pieces ----------------------------------------------------------------------------------------

    def _walked(self, times: NDArray[np.int64]) -> humans.Walk:
        """Return everybody's walk, N * K rows, over the control steps that begin at `times` (N, K)."""
        assert self.state is not None
        keep_out, tcp = self.draws.keep_out(self.points), self.state.tcp_pos.numpy()[:, :2]
        stands = self._disturbance.stands(times)
        noise = self.noise[np.arange(self.rows)[:, None], np.minimum(times, self.noise.shape[1] - 1)]
        walk, walks = self.walk, []
        for k in range(times.shape[1]):
            before, walk = walk, humans.advance(self.config.human, walk, noise[:, k], tcp, keep_out)
            standing = np.flatnonzero(stands[:, k])
            walk = walk.put(standing, before.rows(standing)) if len(standing) else walk
            walks.append(walk)
        return humans.Walk.along(walks)

    def _limbs(self, walk: humans.Walk) -> Array:
        """Return the limb poses (n, 5, 7) of n people."""
        phase, swing = humans.gait(walk)
        x, y = walk.position.T
        return limb_poses(x, y, walk.yaw, phase, swing, self.scene.floor_z)

    def _seen(self, position: Array) -> Array:
        return humans.seen_position(self.config.human, position, self.draws.spawns)

    def _pack(self, targets: Array, limbs: Array, balls: Array, rows: Any = slice(None)) -> Array:
        """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

        targets (n, K * s, 6) rad, s to a control step; limbs (n * K, 5, 7) stay put over a control step,
        balls (n, B, 3) m over all of them.
        """
        n, steps, places = len(targets), len(limbs) // len(targets), 6 + 3 * len(self.scene.mocap)
        control = np.empty((n, steps, targets.shape[1] // steps, self.scene.ncontrol))
        control[..., :6] = targets.reshape(*control.shape[:3], 6)
        position = control[..., 6:places].reshape(*control.shape[:3], -1, 3)
        quaternion = control[..., places:].reshape(*control.shape[:3], -1, 4)
        limbs = limbs.reshape(n, steps, 1, len(LIMBS), 7)
        position[..., : len(LIMBS), :], quaternion[..., : len(LIMBS), :] = limbs[..., :3], limbs[..., 3:]
        props = position[..., len(LIMBS) :, :]
        props[...], quaternion[..., len(LIMBS) :, :] = (FAR_AWAY_M, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        if count := self.subtask.points:
            props[..., 2 : 2 + count, :] = self.points[rows][:, None, None, :count]
        else:
            for index in range(self.config.task.balls):
                prop = ball_props(index)[self.colours[rows][:, index]]
                props[np.arange(n), :, :, prop] = balls[:, index, None, None]
        return control.reshape(n, -1, self.scene.ncontrol)

    def _disturbed(self, state: State) -> State:
        """Return the state in which balls are lost that are to be: they have to be picked again."""
        if self._disturbance.kind != "drop":
            return state
        held = self.subtask.releasing(state.stage)
        lost = torch.from_numpy(self._disturbance.drops(held.numpy()))
        return state.with_(stage=state.stage - lost.long())

    def _next_level(self, outcome: StepResult) -> Tensor:
        """Return the level (N,) at which the next decision is made; `state` is still that before this one."""
        assert self.state is not None
        if self.config.comfort.source == "none":
            return self.state.level
        travelled = vector_norm(outcome.state.tcp_pos - self.state.tcp_pos, dim=-1)
        taken = outcome.decision_steps
        speed = travelled / (taken * CONTROL_STEP_S)
        distance = human_distance(outcome.state.tcp_pos, outcome.state.human_pos)
        now = SourceInput(
            time_s=outcome.state.steps.numpy() * CONTROL_STEP_S,
            passed_s=taken.numpy() * CONTROL_STEP_S,
            distance_m=distance.numpy(),
            speed_m_s=speed.numpy(),
        )
        return torch.from_numpy(self.source.advance(now))

    def _moving(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields of State that change within an episode, (n, ...), from readings (n, nsensor)."""
        at = self.scene.sensors
        limbs = planned["limbs"]
        arrays = {
            **planned,
            "joint_pos": sensed[:, at["joint_pos"]],
            "joint_vel": sensed[:, at["joint_vel"]],
            "tcp_pos": sensed[:, at["tcp_pos"]],
        }
        del arrays["limbs"]
        if self._arm is None:
            arrays["arm_distance"] = np.full(len(sensed), np.nan)
        else:
            arrays["arm_distance"] = self._arm(arrays["joint_pos"], limbs)
        tensors = {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in arrays.items()}
        for name, key in (
            ("human_collision", "human"),
            ("table_collision", "table"),
            ("self_collision", "self"),
        ):
            tensors[name] = torch.from_numpy(sensed[:, at[key]].any(axis=1))
        return tensors

    def _moved(self, sensed: Array, rows: NDArray[np.int64]) -> dict[str, Tensor]:
        """Return what `_moving` does, (N * K, ...), from readings (r * K, nsensor) of `rows` (r,)."""
        count = self.config.task.action_repeat
        at = (rows[:, None] * count + np.arange(count)).reshape(-1)
        moving = self._moving(sensed, {name: value[at] for name, value in self._planned.items()})
        for name, value in moving.items():
            still = getattr(self.state, name).repeat_interleave(count, dim=0)
            moving[name] = still.index_copy(0, torch.from_numpy(at), value)
        return moving

    def _begun(self, rows: NDArray[np.int64], walk: humans.Walk, limbs: Array, sensed: Array) -> State:
        """Return the first instant of the episodes of `rows` (r,), whose people are at `walk`."""
        n, task = len(rows), self.config.task
        planned = {
            "joint_target": self.start[rows, 12:],
            "human_pos": walk.position,
            "human_yaw": walk.yaw,
            "human_seen": self._seen(walk.position),
            "steps": np.zeros(n, dtype=np.int64),
            "limbs": limbs,
        }
        scale = self.precision[rows] / task.precision.grasp_tolerance_m

        def constant(value: Array) -> Tensor:
            return torch.from_numpy(value).repeat(n, 1)

        return State(
            **self._moving(sensed, planned),
            tcp_home=constant(self._home_tcp()),
            joint_home=constant(self.scene.home),
            ball_pos=torch.from_numpy(self.balls[rows, 0]),
            drop_pos=torch.from_numpy(self._drops[self.colours[rows, 0]]),
            orange_drop=constant(self._drops[0]),
            pink_drop=constant(self._drops[1]),
            points=torch.from_numpy(self.points[rows]),
            colour=torch.from_numpy(self.colours[rows, 0]),
            balls=torch.from_numpy(self.balls[rows]),
            colours=torch.from_numpy(self.colours[rows]),
            placed=torch.zeros(n, task.balls, dtype=torch.bool),
            target=torch.zeros(n, dtype=torch.int64),
            level=torch.from_numpy(self.source.level[rows].copy()),
            stage=torch.zeros(n, dtype=torch.int64),
            grasp_tolerance=torch.from_numpy(self.precision[rows].copy()),
            place_tolerance=torch.from_numpy(scale * task.precision.place_tolerance_m),
            home_tolerance=torch.from_numpy(scale * np.radians(task.precision.home_tolerance_deg)),
        )

    def _put(self, rows: NDArray[np.int64], fresh: State) -> None:
        """Let the state be `fresh` (r rows) in `rows`."""
        if self.state is not None:
            self.state = self.state.put(torch.from_numpy(rows), fresh)
        elif len(rows) == self.rows:
            self.state = fresh
        else:
            raise ConfigError("the first reset must reset every row")

    def _home_tcp(self) -> Array:
        if self._tcp_home is None:
            data = mujoco.MjData(self.scene.model)
            data.qpos[:] = self.scene.home
            mujoco.mj_kinematics(self.scene.model, data)
            self._tcp_home = data.site("robot/tcp").xpos.copy()
        return self._tcp_home

    # ---- saving ----------------------------------------------------------------------------------------

    _ARRAYS = (
        "episode", "noise", "balls", "colours", "spawn_id", "motion_id", "points", "precision",
        "joint_target", "start", "steps",
    )  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """Return everything a bit-for-bit continuation needs, as tensors and plain numbers."""
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
        if "disturbance" in saved:  # it came later
            self._disturbance.load_state_dict(saved["disturbance"])
        for name in self._ARRAYS:
            setattr(self, name, saved[name].numpy().copy())
