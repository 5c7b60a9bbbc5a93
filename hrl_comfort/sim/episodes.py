"""Episodes of N cells: their starts, controls and results.

The caller runs the physics (`engine` in batches, `envs.dm` one cell at a time): it applies the `controls` of an action
and passes the sensor readings to `advance`. All environments share this definition of an episode; every random number
of it comes from (seed, row, episode).
"""

from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.comfort.adapt import max_episode_steps, with_comfort
from hrl_comfort.comfort.sources import make_source
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EnvConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.safety.drive import Drive, SetPoints, make_drive
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene, tool_at
from hrl_comfort.sim.cartesian import CartesianHand, action_dim
from hrl_comfort.sim.disturbance import Disturbance
from hrl_comfort.sim.episode_sampler import ARRIVALS, ATTEMPTS, DISTURBANCE_STREAM, EpisodeSampler
from hrl_comfort.sim.objects import choose_target, go_on, rendered_positions, update_placed
from hrl_comfort.sim.people import stop_at_contact
from hrl_comfort.sim.randomisation import Servos, Values, observed
from hrl_comfort.sim.signals import Sensors, limbs_of, pack_controls
from hrl_comfort.sim.state_fields import first_fields, human_fields, planned_fields, set_points
from hrl_comfort.sim.step_result import StepResult, compute_step, reward_weights, source_input
from hrl_comfort.sim.tracker import Tracker
from hrl_comfort.tasks import State, Subtask, subtask
from hrl_comfort.tasks.observations import share

Array = NDArray[np.float64]
Objects = tuple[Array, NDArray[np.int64]]
"""Centres (n, B, 3) m, and kinds (n, B)."""
Probe = Callable[[Array, Array], Array]
"""(joints (r, 2 J): angles rad, velocities rad/s; control (r, ncontrol)) -> sensordata (r, nsensor)."""


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
        task, source = config.task, config.comfort.source
        known = subtask(task.name, task.observation, task.objects)
        plain = replace(known, terminate_on=task.terminate_on, arrival_speed=task.arrival_speed_rad_s)
        seen = with_comfort(plain, config.comfort, task.max_step_deg)
        self.subtask: Subtask = seen.observing(share=share) if config.safety.kind != "none" else seen
        weights = reward_weights(config.reward, config.comfort.scale)
        self.reward_names = tuple(self.subtask.rewards)
        self._weights = torch.tensor([weights[name] for name in self.reward_names], dtype=torch.float64)
        self.precision_m = config.task.precision.grasp_tolerance_m
        self.planned_steps = config.task.action_repeat
        """Control steps of a decision."""
        self.action_dim = action_dim(scene, config.task)
        """Size A of an action."""
        self._hand = CartesianHand(scene, config.task) if config.task.action == "cartesian" else None
        self.sampler = EpisodeSampler(scene, config, self.subtask, seed, evaluation)
        self._tcp_home = tool_at(scene, scene.home)

        self.episode = np.full(rows, -1, dtype=np.int64)
        self._ready = np.zeros(rows, dtype=bool)
        self.draw = self.sampler.blank(rows)
        """Values drawn for the episode of each row."""
        self.source = make_source(config.comfort, rows)
        paid = source == "frightened" or (config.comfort.distance == "arm" and source != "none")
        self._separation = Separation(scene)
        self.drive = make_drive(scene, self._separation, config, rows)
        self._people_stop = config.task.terminate_on == "unsafe_contact"
        pushing = self.drive is None and not self._people_stop
        self._sensors = Sensors(scene, self._separation, measure_arm or paid, pushing)
        self._disturbance = Disturbance(disturbance, rows)
        self._servos = Servos(config.randomise, rows, len(scene.joints), config.engine.substeps)
        self._tracker = Tracker(config.randomise, rows)
        parts = (self._servos, self._tracker, self.drive)
        self._planning: list[Servos | Tracker | Drive] = [part for part in parts if part is not None]
        self._parts: list[Any] = [self.source, self._disturbance, *self._planning]
        """Parts with a state that an exact continuation needs."""
        self.walk = humans.begin(config.human, np.zeros((rows, 2)))
        self.state: State | None = None
        self._planned: dict[str, NDArray[Any]] = {}
        self.walks = self.walk  # (N * K,), after each of the K control steps that the decision may take
        self._around: tuple[Array, humans.KeepOut, humans.ArmSource] | None = None
        """Tool (N, 2) m, keep-out discs and arm as the human sees them while a decision lasts: as at its beginning."""

    def begin(self, rows: NDArray[np.int64], probe: Probe, entries: EvaluationSet | None = None) -> Array:
        """Begin the next episode of `rows` (r,); return their joints (r, 2 J): angles rad, velocities rad/s.

        With `entries` (r,) of an evaluation split the rows begin these; the next call without them begins the episode
        that they would have begun now. Draws are repeated until the cell begins free of contact and unsolved.

        Raises:
          ConfigError: no such start was found.
        """
        if entries is None:
            self.episode[rows] += 1
            attempts = {row: self.sampler.attempts(int(row), int(self.episode[row])) for row in rows}
        else:
            sampler = EpisodeSampler(self.scene, self.config, self.subtask, 0, entries)
            attempts = {row: sampler.attempts(index, 0) for index, row in enumerate(rows)}
        pending, moving = rows, 2 * len(self.scene.joints)
        for _ in range(ATTEMPTS):
            for row in pending:
                for name, value in vars(next(attempts[row])).items():
                    getattr(self.draw, name)[row] = value
                rng = self.sampler.generator(int(row), int(self.episode[row]), DISTURBANCE_STREAM)
                self._disturbance.begin(row, self.draw, self.config.human.keep_out_m, rng)
            self.source.draws[pending] = self.draw.level[pending]
            self.source.begin(pending)
            fresh = humans.begin(self.config.human, self.draw.spawn[pending], self.draw.traits[pending])
            self.walk = self.walk.put(pending, fresh)
            begun = self.draw.start[pending]
            targets, limbs = begun[:, moving:], limbs_of(self.scene, fresh)
            still = np.zeros_like(targets) if self.drive is None else self.drive.rated(begun[:, moving // 2 : moving])
            steps = np.zeros(len(pending), dtype=np.int64)
            values = self.values(pending)
            self._servos.begin(pending, values, targets)
            seen = self._tracker.begin(pending, values, self.draw.frames[pending], fresh.position, limbs)
            planned = self._plan(fresh, seen, limbs, SetPoints.unshielded(targets, still, steps), steps)
            # The control holds the robot and the human where they begin.
            objects = self.draw.objects(pending), self.draw.kinds[pending]
            control = self._controls(targets[:, None], planned["limbs"], objects, pending)[:, 0]
            sensed = probe(self.draw.start[pending, :moving], control)
            state = State(
                **self._sensors.read_first(sensed, planned),
                **first_fields(
                    self.draw, pending, self.config.task.precision, self.precision_m,
                    level=self.source.level[pending], tcp_home=self._tcp_home, joint_home=self.scene.home,
                ),
            )  # fmt: skip
            if self.state is None and len(pending) < self.rows:
                raise ConfigError("the first reset must reset every row")
            self.state = state if self.state is None else self.state.put(torch.from_numpy(pending), state)
            if self.drive is not None:
                self.drive.begin(pending, limbs)
            solved = self.subtask.next_stage(state) > 0
            bad = (solved | state.touching | self.subtask.failure(state)).numpy()
            pending = pending[bad]
            if not len(pending):
                self._ready[rows] = True
                return self.draw.start[rows, :moving]
        raise ConfigError(f"no free start for {self.subtask.name} in rows {pending.tolist()} after {ATTEMPTS} attempts")

    def stand(self, walk: humans.Walk) -> None:
        """Let the episodes that have just begun, of all rows, begin with the people of `walk` (N) instead."""
        assert self.state is not None
        self.walk, rows, limbs = walk, np.arange(self.rows), limbs_of(self.scene, walk)
        places = self._tracker.begin(rows, self.values(), self.draw.frames, walk.position, limbs)
        if self.drive is not None:
            self.drive.begin(rows, limbs)
        people = human_fields(walk, places, humans.seen_position(self.config.human, places, self.sampler.spawns))
        self.state = self.state.with_(**{name: torch.from_numpy(value) for name, value in people.items()})

    def rewind(self) -> None:
        """Restart each row from its first episode, which is to begin before the next decision."""
        self.episode[:] = -1
        self._ready[:] = False

    def controls(self, action: Array, joints: Callable[[], Array]) -> Iterator[Array]:
        """Yield the controls (N, T, ncontrol) of the next T physics steps of a decision; action (N, A) in [-1, 1].

        `joints` returns the joints (N, 2 J) as they are when it is called: angles, rad, velocities, rad/s. Joint
        targets are ramped at up to `max_step_deg` a control step, all at once, or control step by control step as
        rating and shield pass it for the measured arm; the human walks on meanwhile.

        Raises:
          RuntimeError: a row has no episode yet.
          ValueError: the actions are of another shape.
        """
        if self.state is None or not self._ready.all():
            raise RuntimeError("there is no episode yet: call reset before step")
        if action.shape != (shape := (self.rows, self.action_dim)):
            raise ValueError(f"actions of shape {action.shape} are not allowed; they must have shape {shape}")
        steps, substeps, joint_target = self.planned_steps, self.config.engine.substeps, self.state.joint_target.numpy()
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        if self._hand is None:
            increment = action * np.radians(self.config.task.max_step_deg)
        else:
            increment = self._hand.increments(joint_target, action)
        times = self.state.steps.numpy()[:, None] + np.arange(steps)
        arm = cache(partial(self._separation.arm.points, self.state.joint_pos.numpy(), self.state.joint_vel.numpy()))
        self._around = self.state.tcp_pos.numpy()[:, :2], self.sampler.keep_out(self.draw.points), arm
        noise = self.draw.noise[np.arange(self.rows)[:, None], np.minimum(times, self.sampler.horizon - 1)]
        objects = rendered_positions(self.state, self.subtask), self.state.kinds.numpy()
        for part in self._planning:
            part.begin_decision()
        if self.drive is None:
            ramp = np.arange(1, steps * substeps + 1) / substeps
            targets = joint_target[:, None] + ramp[:, None] * increment[:, None]
            lowest, highest = self.scene.joint_range.T
            targets = np.minimum(np.maximum(targets, lowest), highest)
            velocity = np.repeat(increment / CONTROL_STEP_S, steps, axis=0)
            ends = targets[:, substeps - 1 :: substeps].reshape(-1, joint_target.shape[1])
            points = SetPoints.unshielded(ends, velocity, times.reshape(-1) + 1)
            self.walks = humans.Walk.along(list(self._walking(times, noise, ends.reshape(self.rows, steps, -1))))
            limbs = limbs_of(self.scene, self.walks)
            self._tracker.follow(times + 1, self.draw.frames, self.walks.position, limbs)
            yield self._controls(self._servos.follow(targets), limbs, objects)
        else:
            points, limbs = yield from self._driven(increment / CONTROL_STEP_S, joints, times, noise, objects)
        places = self._tracker.seen(self.walks.position)
        self._planned = self._plan(self.walks, places, limbs, points, times.reshape(-1) + 1)

    def _driven(
        self, asked: Array, joints: Callable[[], Array], times: NDArray[np.int64], noise: Array, objects: Objects
    ) -> Generator[Array, None, tuple[SetPoints, Array]]:
        """Yield the controls of each control step under the drive, as `controls` does; set the walks.

        Return the set-points (N * K) and limbs (N * K, L, 7). `asked` (N, J) rad/s, `times` (N, K), `noise`
        (N, K, NOISE), `objects` (N).
        """
        assert self.drive is not None and self.state is not None
        points, walks, limbs = [set_points(self.state)], [self.walk], [limbs_of(self.scene, self.walk)]
        for k in range(times.shape[1]):
            moving = joints()
            now = self._separation.encounter(moving[:, : asked.shape[1]], limbs[-1])
            begin, point = self.drive.step(points[-1], asked, moving, now, self._tracker.shown)
            walk = self._walk_on(walks[-1], times[:, k], noise[:, k])
            walk, poses = stop_at_contact(self.scene, self._separation, now, walks[-1], walk)
            points.append(self.drive.beside(point, now, poses))
            walks.append(walk)
            limbs.append(poses)
            self._tracker.see(times[:, k] + 1, self.draw.frames, walks[-1].position, limbs[-1])
            targets = self._servos.follow(point.ramp(begin, self.config.engine.substeps))
            yield self._controls(targets, limbs[-1], objects)
        self.walks = humans.Walk.along(walks[1:])
        beside = np.stack(limbs[1:], axis=1)
        return SetPoints.along(points[1:]), beside.reshape(-1, *beside.shape[2:])

    def advance(self, sensed: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Return the result of a decision from its sensor readings (N, K * substeps, nsensor).

        A decision ends where its stage or its episode does, so that the next one, perhaps of another policy,
        begins there. The caller takes each row's physics from the end of its last valid control step.
        Readings may be those of some `rows` (r,): see `Engine.step`.
        """
        assert self.state is not None
        readings = sensed.reshape(-1, self.config.engine.substeps, sensed.shape[-1])
        beside = limbs_of(self.scene, self.walk)
        moving = self._sensors.read_decision(readings, self._planned, self.state, beside, rows)
        result = compute_step(self.subtask, self._weights, self.max_episode_steps(self.state.level), self.state, moving)
        state = result.state
        if self.config.comfort.source != "none":
            state = state.with_(level=torch.from_numpy(self.source.advance(source_input(self.state, result))))
        state = self._disturbance.applied(update_placed(state, self.state.stage, self.subtask), self.subtask)
        if self.subtask.repeats:
            arriving = self.draw.arriving[np.arange(self.rows), state.steps.numpy() % ARRIVALS]
            drawn = torch.from_numpy(arriving), torch.from_numpy(self.draw.arrivals)
            state = go_on(state, self.state, result.failed, *drawn, self.subtask)
        self.state, last = state, result.decision_steps.numpy() - 1
        self.walk = self.walks.rows(np.arange(self.rows) * self.planned_steps + last)
        for part in self._planning:
            part.end_decision(last)
        return result if state is result.state else replace(result, state=state)

    def values(self, rows: Any = slice(None)) -> Values:
        """Return how the cells of `rows`, all by default, differ from the model."""
        return Values(self.config.randomise, self.draw.world[rows])

    def observe(self) -> Tensor:
        """Return the observations (N, D) of the cells as they are now."""
        assert self.state is not None
        return self.subtask.observe(self.observed(self.state))

    def observed(self, state: State) -> State:
        """Return the present `state` (N rows) as the sensors report it, for policies."""
        return observed(self.config.randomise, self.values(), self.draw.readings, state, self._separation.arm)

    def aim(self, rows: Tensor, index: Tensor) -> None:
        """Make the objects `index` (r,) the targets of `rows` (r,).

        Raises:
          ValueError: a row is not to pick now, or the object has been placed.
        """
        assert self.state is not None
        self.state = choose_target(self.state, rows, index, self.subtask)

    def _walking(self, times: NDArray[np.int64], noise: Array, angles: Array) -> Iterator[humans.Walk]:
        """Yield the K walks over control steps that begin at `times` (N, K) and take arms to `angles` (N, K, J) rad."""
        walk = self.walk
        for k in range(times.shape[1]):
            before, walk = walk, self._walk_on(walk, times[:, k], noise[:, k])
            if self._people_stop:
                now = self._separation.encounter(angles[:, k], limbs_of(self.scene, before))
                walk, _ = stop_at_contact(self.scene, self._separation, now, before, walk)
            yield walk

    def _walk_on(self, walk: humans.Walk, times: NDArray[np.int64], noise: Array) -> humans.Walk:
        """Return `walk` after the control step that begins at `times` (N,); noise (N, NOISE)."""
        assert self._around is not None
        return self._disturbance.walked(walk, humans.advance(self.config.human, walk, noise, *self._around), times)

    def _controls(self, targets: Array, limbs: Array, objects: Objects, rows: Any = slice(None)) -> Array:
        """Return the controls of `rows`; see `pack_controls`."""
        layout, points = self.draw.layout(rows), self.draw.points[rows, : self.subtask.points]
        return pack_controls(self.scene, targets, limbs, layout, *objects, points)

    def max_episode_steps(self, level: Tensor) -> Tensor:
        """Return the time limits (N,) in control steps at levels (N,)."""
        comfort = replace(self.config.comfort, beta=0.0) if self.subtask.repeats else self.config.comfort
        return max_episode_steps(level, self.config.task.max_episode_steps, comfort)

    def _plan(
        self, walk: humans.Walk, places: Array, limbs: Array, points: SetPoints, steps: NDArray[np.int64]
    ) -> dict[str, NDArray[Any]]:
        seen = humans.seen_position(self.config.human, places, self.sampler.spawns)
        return planned_fields(walk, places, seen, limbs, points, steps)

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as tensors and plain numbers."""
        assert self.state is not None
        return {
            "precision_m": self.precision_m,
            "episode": torch.from_numpy(self.episode.copy()),
            "draw": {name: torch.from_numpy(value.copy()) for name, value in vars(self.draw).items()},
            "walk": {name: torch.from_numpy(value.copy()) for name, value in vars(self.walk).items()},
            "state": dict(self.state.fields()),
            "parts": [part.state_dict() for part in self._parts],
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.precision_m = saved["precision_m"]
        self.episode = saved["episode"].numpy().copy()
        for name, value in saved["draw"].items():
            getattr(self.draw, name)[:] = value.numpy()
        self.walk = humans.Walk(**{name: value.numpy().copy() for name, value in saved["walk"].items()})
        self.state = State(**saved["state"])
        for part, its in zip(self._parts, saved["parts"], strict=True):
            part.load_state_dict(its)
        self._ready[:] = True
