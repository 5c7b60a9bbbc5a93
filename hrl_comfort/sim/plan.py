"""What N arms are commanded, and where their people go: an action becomes controls, before the physics runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.config import CONTROL_STEP_S, EnvConfig, HumanConfig
from hrl_comfort.safety.drive import Drive, SetPoints, make_drive
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.cartesian import CartesianHand, action_dim
from hrl_comfort.sim.controls import limbs_of, pack_controls
from hrl_comfort.sim.episode_sampler import Draw, EpisodeSampler
from hrl_comfort.sim.objects import rendered_positions
from hrl_comfort.sim.people import stop_at_contact
from hrl_comfort.sim.variation.disturbance import Disturbance
from hrl_comfort.sim.variation.randomisation import Servos, Values
from hrl_comfort.sim.variation.tracker import Tracker
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]
Joints = Callable[[], Array]
"""Joints (N, 2 J) as they are when it is called: angles, rad, velocities, rad/s."""
SET_POINTS = {"angles": "joint_target", "velocity": "target_vel"}
"""Field of `SetPoints` -> field of `State`, where they differ."""


@dataclass(frozen=True)
class Planned:
    """What is known of K control steps of N cells before the physics runs; of episodes that begin, of one instant."""

    fields: dict[str, NDArray[Any]]
    """Fields of State, (N, K, ...)."""
    limbs: Array
    """(N, K, L, 7) poses of the people's limbs, m and quaternion."""


class Plan:
    """Commands and people of N cells.

    Args:
      scene: with the arm.
      separation: of arm and people.
      config: of the cells.
      subtask: of their episodes.
      sampler: of their starts.
      disturbance: which may hold people where they are.
      rows: number N of cells.
      steps: control steps of a decision.
      takes_back: whether set-points jump back to an arm that does not follow them (`Drive`).
    """

    def __init__(
        self,
        scene: Scene,
        separation: Separation,
        config: EnvConfig,
        subtask: Subtask,
        sampler: EpisodeSampler,
        disturbance: Disturbance,
        rows: int,
        steps: int,
        takes_back: bool,
    ) -> None:
        self._scene, self._separation, self._task, self._subtask = scene, separation, config.task, subtask
        self._sampler, self._disturbance, self._rows, self.steps = sampler, disturbance, rows, steps
        self._substeps, self.human = config.engine.substeps, config.human
        self.action_dim = action_dim(scene, config.task)
        """Size A of an action."""
        self._hand = CartesianHand(scene, config.task) if config.task.action == "cartesian" else None
        self.drive = make_drive(scene, separation, config, rows, takes_back=takes_back)
        self.people_stop = config.task.terminate_on == "unsafe_contact"
        """Whether people stop where they touch an arm without a drive; beside one with a drive they always do."""
        self._servos = Servos(config.randomise, rows, len(scene.joints), self._substeps)
        self.tracker = Tracker(config.randomise, rows)
        parts = (self._servos, self.tracker, self.drive)
        self._parts: list[Servos | Tracker | Drive] = [part for part in parts if part is not None]
        self.walk = humans.begin(config.human, np.zeros((rows, 2)))
        """People (N) as the decision begins."""
        self.walks: list[humans.Walk] = []
        """People (N) after each of the K control steps of the decision."""
        self._ends = np.zeros((3, len(separation.person.radius), 2, rows))
        """m, ends of the capsules of people as last seen, as the decision begins."""
        self._pace = np.zeros_like(self._ends)
        """m/s, their mean velocity over the decision before."""
        self.planned = Planned({}, np.empty(0))
        """Of the decision, once its controls have been made."""

    def begin(self, rows: NDArray[np.int64], draw: Draw, values: Values) -> tuple[Planned, Array]:
        """Begin episodes in `rows` (r,), drawn as `draw` (N); `values` (r) are how their cells differ from the model.

        Return what is known of their first instant, and the control (r, ncontrol) that holds arm and people there.
        """
        fresh = humans.begin(self.human, draw.spawn[rows], draw.traits[rows])
        self.walk = self.walk.put(rows, fresh)
        _, velocity, targets = np.split(draw.start[rows], 3, axis=1)
        still = np.zeros_like(targets) if self.drive is None else self.drive.rated(velocity)
        steps, limbs = np.zeros((len(rows), 1), dtype=np.int64), limbs_of(self._scene, fresh)
        self._servos.begin(rows, values, targets)
        measured = self.tracker.begin(rows, values, draw.frames[rows], fresh.position, limbs)
        self._ends[..., rows], self._pace[..., rows] = self._seen_ends()[..., rows], 0.0
        points = [SetPoints.unshielded(targets, still, steps[:, 0])]
        planned = self._planned(
            fresh.position[:, None], fresh.yaw[:, None], measured[:, None], limbs[:, None], points, steps
        )
        return planned, self._controls(draw, targets[:, None], limbs, draw.objects(rows), draw.kinds[rows], rows)[:, 0]

    def accepted(self, rows: NDArray[np.int64], planned: Planned) -> None:
        """Begin the drive of `rows` (r,), whose episodes began as `planned`."""
        if self.drive is not None:
            self.drive.begin(rows, planned.limbs[:, 0])

    def controls(self, state: State, draw: Draw, action: Array, joints: Joints) -> Iterator[Array]:
        """Yield the controls (N, T, ncontrol) of the next T physics steps of a decision; action (N, A) in [-1, 1].

        Joint targets are ramped at up to `max_step_deg` a control step, all at once, or control step by control step
        as rating and shield pass it for the measured arm; the human walks on meanwhile. Afterwards `planned` is there.
        """
        joint_target = state.joint_target.numpy()
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        if self._hand is None:
            increment = action * np.radians(self._task.max_step_deg)
        else:
            increment = self._hand.increments(joint_target, action)
        times = state.steps.numpy()[:, None] + np.arange(self.steps)
        arm = cache(partial(self._separation.arm.points, state.joint_pos.numpy(), state.joint_vel.numpy()))
        discs, tool = self._sampler.keep_out(draw.points, draw.goals), state.tcp_pos.numpy()[:, :2]
        around = humans.Surroundings(tool, discs, arm, draw.stations)
        noise = draw.noise[np.arange(self._rows)[:, None], np.minimum(times, self._sampler.horizon - 1)]
        objects, kinds = rendered_positions(state, self._subtask), state.kinds.numpy()
        for part in self._parts:
            part.begin_decision()
        points, walks, limbs = [set_points(state)], [self.walk], [limbs_of(self._scene, self.walk)]
        waiting: list[Array] = []
        for k in range(self.steps):
            now = None
            if self.drive is None:
                targets, point = self._ramp(joint_target, increment, k, times[:, k] + 1)
                if self.people_stop:
                    now = self._separation.encounter(point.angles, limbs[-1])
            else:
                moving = joints()
                now = self._separation.encounter(moving[:, : joint_target.shape[1]], limbs[-1])
                asked, seen = increment / CONTROL_STEP_S, self.tracker.shown
                begin, point = self.drive.step(points[-1], asked, moving, now, seen)
                targets = point.ramp(begin, self._substeps)
            walk = humans.advance(self.human, walks[-1], noise[:, k], around)
            walk = self._disturbance.walked(walks[-1], walk, times[:, k])
            if now is None:
                poses = limbs_of(self._scene, walk)
            else:
                walk, poses = stop_at_contact(self._scene, self._separation, now, walks[-1], walk)
            if self.drive is not None:
                assert now is not None
                point = self.drive.beside(point, now, poses)
            points.append(point)
            walks.append(walk)
            limbs.append(poses)
            self.tracker.see(times[:, k] + 1, draw.frames, walk.position, poses)
            waiting.append(self._controls(draw, self._servos.follow(targets), poses, objects, kinds))
            if self.drive is not None or k == self.steps - 1:  # set-points of a free arm do not depend on its motion
                yield waiting[0] if len(waiting) == 1 else np.concatenate(waiting, axis=1)
                waiting = []
        self.walks = walks[1:]
        place, yaw = (np.stack([getattr(walk, name) for walk in self.walks], axis=1) for name in ("position", "yaw"))
        self.planned = self._planned(
            place, yaw, self.tracker.seen(place), np.stack(limbs[1:], axis=1), points[1:], times + 1
        )

    def end(self, last: NDArray[np.int64]) -> None:
        """End a decision whose last valid control step is `last` (N,), counted from 0."""
        self.walk = humans.Walk.chosen(self.walks, last)
        for part in self._parts:
            part.end_decision(last)
        ends = self._seen_ends()
        self._ends, self._pace = ends, (ends - self._ends) / ((last + 1) * CONTROL_STEP_S)

    def _seen_ends(self) -> Array:
        """Return the ends (3, Q, 2, N) m of the capsules of people as the tracker sees them now."""
        shown = self.tracker.shown
        return self._separation.person.ends(self.limbs if shown is None else shown)

    def bodies(self, joints: Array, rows: Any = slice(None)) -> dict[str, Array]:
        """Return the fields of State about the bodies of arms at `joints` (r, J) rad and of people in `rows`."""
        arm, person = self._separation.arm, self._separation.person
        return {
            "arm_body": capsules(arm.pose(joints).ends, arm.radius),
            "humans_body": capsules(self._ends[..., rows], person.radius),
            "humans_body_vel": self._pace[..., rows].transpose(3, 1, 2, 0).reshape(-1, len(person.radius), 6),
        }

    @property
    def limbs(self) -> Array:
        """(N, L, 7) poses of the people's limbs as the decision begins."""
        return limbs_of(self._scene, self.walk)

    def shown(self, places: Array) -> Array:
        """Return where policies see people (..., 2) m who are measured at `places` (..., 2) m."""
        return humans.seen_position(self.human, places.reshape(-1, 2), self._sampler.spawns).reshape(places.shape)

    def people_fields(self, places: Array, yaw: Array, measured: Array) -> dict[str, NDArray[Any]]:
        """Return the fields of State of people at `places` (..., 2) m, `yaw` (...) rad, `measured` at (..., 2) m."""
        seen = self.shown(measured)
        whole = (seen == measured).all(axis=-1)
        return {"human_pos": places, "human_yaw": yaw, "human_seen": seen, "human_shown": whole}

    def stand(self, walk: humans.Walk, draw: Draw, values: Values) -> dict[str, NDArray[Any]]:
        """Begin the episodes of all rows with the people of `walk` (N) instead; return their fields of State."""
        self.walk, rows = walk, np.arange(self._rows)
        measured = self.tracker.begin(rows, values, draw.frames, walk.position, self.limbs)
        if self.drive is not None:
            self.drive.begin(rows, self.limbs)
        return self.people_fields(walk.position, walk.yaw, measured)

    def go_on_as(self, human: HumanConfig) -> None:
        """Let people go on from where they are as `human` says; beside nobody they come in where they would begin."""
        if self.human.motion == "none":
            self.walk = humans.begin(human, self.walk.spawn)
        elif human.motion != "none":
            self.walk = replace(self.walk, spawn=self.walk.position.copy())
        self.human = human

    def _planned(
        self,
        place: Array,
        yaw: Array,
        measured: Array,
        limbs: Array,
        points: Sequence[SetPoints],
        steps: NDArray[np.int64],
    ) -> Planned:
        """Return what is known: people at `place` (N, K, 2) m, `yaw` (N, K) rad, with `limbs`, measured at (N, K, 2) m.

        `points` are the K set-points (N), `steps` (N, K) the control steps of the episodes.
        """
        moving = {name: np.stack([getattr(each, name) for each in points], axis=1) for name in vars(points[0])}
        named = {SET_POINTS.get(name, name): value for name, value in moving.items()}
        return Planned({**named, **self.people_fields(place, yaw, measured), "steps": steps}, limbs)

    def _ramp(self, before: Array, increment: Array, k: int, steps: NDArray[np.int64]) -> tuple[Array, SetPoints]:
        """Return the targets (N, substeps, J) rad of control step `k` of an arm without a drive, and its set-points.

        From `before` (N, J) rad on, by `increment` (N, J) rad a control step; `steps` (N,) are those of the episodes.
        """
        ramp = np.arange(k * self._substeps + 1, (k + 1) * self._substeps + 1) / self._substeps
        lowest, highest = self._scene.joint_range.T
        targets = np.minimum(np.maximum(before[:, None] + ramp[:, None] * increment[:, None], lowest), highest)
        return targets, SetPoints.unshielded(targets[:, -1], increment / CONTROL_STEP_S, steps)

    def _controls(
        self,
        draw: Draw,
        targets: Array,
        limbs: Array,
        objects: Array,
        kinds: NDArray[np.int64],
        rows: Any = slice(None),
    ) -> Array:
        """Return the controls of `rows` over a control step; see `pack_controls`."""
        points = draw.points[rows, : self._subtask.points]
        return pack_controls(self._scene, targets, limbs, draw.layout(rows), objects, kinds, points)

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        walk = {name: torch.from_numpy(value.copy()) for name, value in vars(self.walk).items()}
        seen = {"ends": torch.from_numpy(self._ends.copy()), "pace": torch.from_numpy(self._pace.copy())}
        return {"walk": walk, "seen": seen, "parts": [part.state_dict() for part in self._parts]}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.walk = humans.Walk(**{name: value.numpy().copy() for name, value in saved["walk"].items()})
        self._ends, self._pace = (saved["seen"][name].numpy().copy() for name in ("ends", "pace"))
        for part, its in zip(self._parts, saved["parts"], strict=True):
            part.load_state_dict(its)


def capsules(ends: Array, radius: Array) -> Array:
    """Return capsules (N, C, 7), ends of the axis and radius, m, from their ends (3, C, 2, N) and radii (C,)."""
    both = ends.transpose(3, 1, 2, 0).reshape(ends.shape[3], -1, 6)
    return np.concatenate([both, np.broadcast_to(radius[:, None], (*both.shape[:2], 1))], axis=2)


def set_points(state: State) -> SetPoints:
    """Return the set-points (N) of a state."""
    named = (SET_POINTS.get(field.name, field.name) for field in fields(SetPoints))
    return SetPoints(*(getattr(state, name).numpy() for name in named))
