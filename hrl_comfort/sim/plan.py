"""Commands to N arms, and the ways of their people: an action becomes controls, before the physics runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.safety import kernels
from hrl_comfort.safety.drive import Drive, SetPoints, make_drive
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.cartesian import CartesianHand, action_dim
from hrl_comfort.sim.controls import pack_controls
from hrl_comfort.sim.episode_sampler import Draw, EpisodeSampler
from hrl_comfort.sim.hand.gripping import Gripping
from hrl_comfort.sim.objects import rendered_positions
from hrl_comfort.sim.people import Crowd, People
from hrl_comfort.sim.variation.disturbance import Disturbance
from hrl_comfort.sim.variation.randomisation import Servos, Values
from hrl_comfort.sim.variation.tracker import Tracker
from hrl_comfort.tasks import ObjectAt, State, Subtask

Array = NDArray[np.float64]
Joints = Callable[[], Array]
"""Joints (N, 2 J) as they are when it is called: angles, rad, velocities, rad/s."""
SET_POINTS = {"angles": "joint_target", "velocity": "target_vel"}
"""Field of `SetPoints` -> field of `State`, where they differ."""


NOT_BEGUN = np.empty((0, 0))
"""Value of `Planned.bodies` where no episode begins."""


@dataclass(frozen=True)
class Planned:
    """Plan of K control steps of N cells, before the physics runs; of episodes that begin, of one instant."""

    fields: dict[str, NDArray[Any]]
    """Fields of State, (N, K, ...)."""
    limbs: Array
    """(N, K, L, 7) poses of the people's limbs, m and quaternion."""
    bodies: Array = field(default_factory=lambda: NOT_BEGUN)
    """(N, nq + nv) positions and velocities of the bodies in which episodes begin; NOT_BEGUN of a decision."""


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
        self._sampler, self._rows, self.steps, self._substeps = sampler, rows, steps, config.substeps
        self.action_dim = action_dim(scene, config.task)
        """Size A of an action."""
        self._hand = CartesianHand(scene, config.task) if config.task.action == "cartesian" else None
        self.drive = make_drive(scene, separation, config, rows, takes_back=takes_back)
        self.people_stop = config.task.terminate_on == "unsafe_contact"
        """Whether people stop where they touch an arm without a drive; beside one with a drive they always do."""
        self._servos = Servos(config.randomise, rows, len(scene.joints), self._substeps)
        self.people = People(scene, separation, config.human, disturbance, rows)
        self.tracker = Tracker(config.randomise, rows, len(self.people.everyone))
        parts = (self._servos, self.tracker, self.drive)
        self._parts: list[Servos | Tracker | Drive] = [part for part in parts if part is not None]
        self._ends = np.zeros((3, len(separation.person.radius), 2, rows))
        """m, ends of the capsules of people as last seen, as the decision begins."""
        self._pace = np.zeros_like(self._ends)
        """m/s, their mean velocity over the decision before."""
        self._habits = np.zeros((2, len(self.people.everyone), rows))
        """`humans_stood` s and `humans_side` of people, as the decision begins."""
        self._hand_capsules = scene.hand_capsules
        self._gripping = None if scene.gripper is None else Gripping(scene, subtask, sampler.horizon)
        self.planned = Planned({}, np.empty(0))
        """Of the decision, once its controls have been made."""

    def begin(self, rows: NDArray[np.int64], draw: Draw, values: Values) -> tuple[Planned, Array]:
        """Begin episodes in `rows` (r,), drawn as `draw` (N); `values` (r) are how their cells differ from the model.

        Return what is known of their first instant, and the control (r, ncontrol) that holds arm and people there.
        """
        fresh = self.people.begin(rows, draw.spawn[rows], draw.traits[rows])
        angles, velocity, targets = np.split(draw.start[rows], 3, axis=1)
        bodies, grip = np.concatenate([angles, velocity], axis=1), None
        if self._gripping is not None:
            bodies, grip = self._gripping.begin(draw, rows)
        still = np.zeros_like(targets) if self.drive is None else self.drive.rated(velocity)
        steps, objects = np.zeros((len(rows), 1), dtype=np.int64), draw.objects(rows)
        self._servos.begin(rows, values, targets)
        measured = self.tracker.begin(rows, values, draw.frames[rows], fresh.places, fresh.limbs)
        self._ends[..., rows], self._pace[..., rows] = self._seen_ends()[..., rows], 0.0
        self._habits[..., rows] = 0.0
        points = [SetPoints.unshielded(targets, still, steps[:, 0])]
        grips = None if grip is None else [grip]
        planned = self._planned([fresh], measured[:, None], points, steps, grips, bodies)
        standing = draw.layout(rows), objects, draw.kinds[rows], draw.points[rows, : self._subtask.points]
        control = self._with_grip(targets[:, None], grip, grip)
        return planned, pack_controls(self._scene, control, fresh.limbs, *standing)[:, 0]

    def accepted(self, rows: NDArray[np.int64], limbs: Array) -> None:
        """Begin the drive of `rows` (r,), whose episodes begin beside people with `limbs` (r, L, 7)."""
        if self.drive is not None:
            self.drive.begin(rows, limbs)

    def controls(self, state: State, draw: Draw, action: Array, joints: Joints) -> Iterator[Array]:
        """Yield the controls (N, T, ncontrol) of the next T physics steps of a decision; action (N, A) in [-1, 1].

        Joint targets are ramped at up to `max_step_deg` a control step, all at once, or control step by control step
        as rating and shield pass it for the measured arm; the human walks on meanwhile. Afterwards `planned` is there.
        """
        joint_target = state.joint_target.numpy()
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        grips: list[Array] | None = None
        if self._gripping is not None:
            action, command, grips = action[:, :-1], action[:, -1], [state.grip_target.numpy()]
        if self._hand is None:
            increment = action * math.radians(self._task.max_step_deg)
        else:
            increment = self._hand.increments(joint_target, action)
        asked = increment / CONTROL_STEP_S
        times = state.steps.numpy()[:, None] + np.arange(self.steps)
        joints_now = state.joint_pos.numpy(), state.joint_vel.numpy()
        arm = cache(lambda: self._separation.arm.points(*joints_now))
        discs = self._sampler.keep_out(draw.points, draw.goals)
        tool = np.ascontiguousarray(state.tcp_pos.numpy()[:, :2])
        holds = self._subtask.object_at(ObjectAt.TOOL, state.stage).numpy()
        held = np.where(holds, state.target_kind.numpy(), -1)
        self.people.begin_decision(humans.Surroundings(tool, discs, arm, draw.stations, held))
        index = np.minimum(times, self._sampler.horizon - 1).T
        noise = draw.noise[np.arange(self._rows), index]
        objects, kinds = rendered_positions(state, self._subtask), state.kinds.numpy()
        standing = state.layout.numpy(), objects, kinds, draw.points[:, : self._subtask.points]
        for part in self._parts:
            part.begin_decision()
        points, crowd, waiting = [set_points(state)], self.people.now, list[Array]()
        for k in range(self.steps):
            now = None
            if self.drive is None:
                targets, point = self._ramp(joint_target, increment, k, times[:, k] + 1)
                if self.people_stop:
                    now = self._separation.beside(point.angles, crowd.ends)
            else:
                moving = joints()
                now = self._separation.beside(moving[:, : joint_target.shape[1]], crowd.ends)
                begin, point = self.drive.step(points[-1], asked, moving, now, self.tracker.shown, draw.tops)
                targets = point.ramp(begin, self._substeps)
            crowd = self.people.step(noise[k], times[:, k], now)
            if self.drive is not None:
                assert now is not None
                point = self.drive.beside(point, now, crowd.ends, self.people.way)
            points.append(point)
            if self.tracker.active:
                self.tracker.see(times[:, k] + 1, draw.frames, crowd.places, crowd.limbs)
            followed = self._servos.follow(targets)
            if self._gripping is not None and grips is not None:
                grips.append(self._gripping.fingers.follow(grips[-1], command))
                followed = self._with_grip(followed, *grips[-2:])
            waiting.append(pack_controls(self._scene, followed, crowd.limbs, *standing))
            if self.drive is not None or k == self.steps - 1:  # set-points of a free arm do not depend on its motion
                yield waiting[0] if len(waiting) == 1 else np.concatenate(waiting, axis=1)
                waiting = []
        grips = None if grips is None else grips[1:]
        self.planned = self._planned(self.people.course[1:], self.tracker.seen(), points[1:], times + 1, grips)

    def _with_grip(self, targets: Array, before: Array | None, after: Array | None) -> Array:
        """Return `targets` (n, T, J) rad with those of the hand, whose set-point goes from `before` to `after`."""
        if self._gripping is None or before is None or after is None:
            return targets
        return np.concatenate([targets, self._gripping.fingers.ramp(before, after, targets.shape[1])], axis=2)

    def end(self, last: NDArray[np.int64]) -> None:
        """End a decision whose last valid control step is `last` (N,), counted from 0."""
        before, lasted = self.people.now.places, np.asarray((last + 1) * CONTROL_STEP_S)
        self.people.end_decision(last)
        for part in self._parts:
            part.end_decision(last)
        ends = self._seen_ends()
        self._ends, self._pace = ends, (ends - self._ends) / lasted
        self._habits = humans.habits(self._habits[0], self._habits[1], before, self.people.now.places, lasted)

    def lay(self, state: State, arrived: NDArray[np.bool_], physics: Array) -> None:
        """See `Gripping.lay`; objects that ride on the tool are not in the physics."""
        if self._gripping is not None:
            self._gripping.lay(state, arrived, physics)

    def _seen_ends(self) -> Array:
        """Return the ends (3, Q, 2, N) m of the capsules of people as the tracker sees them now."""
        shown = self.tracker.shown
        return self.people.now.ends if shown is None else self._separation.person.ends(shown)

    def bodies(self, joints: Array, rows: Any = slice(None)) -> dict[str, Array]:
        """Return the fields of State about the bodies of arms at `joints` (r, J) rad and of people in `rows`."""
        return arm_bodies(self._separation.arm, joints, self._hand_capsules) | self.people_bodies(rows)

    def people_bodies(self, rows: Any = slice(None)) -> dict[str, Array]:
        """Return the fields of State about the bodies of people in `rows`."""
        radius = self._separation.person.radius
        return {
            "humans_body": capsules(self._ends[..., rows], radius),
            "humans_body_vel": capsules(self._pace[..., rows], np.empty(0)),
            **dict(zip(("humans_stood", "humans_side"), self._habits[..., rows].swapaxes(1, 2), strict=True)),
        }

    def shown(self, places: Array) -> Array:
        """Return where policies see people (..., P, 2) m who are measured at `places` (..., P, 2) m."""
        seen = [
            humans.seen_position(human, places[..., index, :].reshape(-1, 2), spawns).reshape(*places.shape[:-2], 2)
            for index, (human, spawns) in enumerate(zip(self.people.everyone, self._sampler.spawns, strict=True))
        ]
        return seen[0][..., None, :] if len(seen) == 1 else np.stack(seen, axis=-2)

    def people_fields(self, crowds: Sequence[Crowd], measured: Array | None) -> dict[str, NDArray[Any]]:
        """Return the fields (N, K, ...) of State of the people of K instants.

        They are `measured` at (N, K, P, 2) m, by default where they are.
        """
        everyone = [*zip(*(crowd.walks for crowd in crowds), strict=True)]

        def of(name: str) -> Array:
            each = [instants([getattr(walk, name) for walk in walks]) for walks in everyone]
            return each[0][:, :, None] if len(each) == 1 else np.stack(each, axis=2)

        places, yaw, velocity = of("position"), of("yaw"), of("velocity")
        measured = places if measured is None else measured
        seen = self.shown(measured)
        same = seen == measured
        whole = same[..., 0] & same[..., 1]
        return {
            "humans_pos": places, "humans_yaw": yaw, "humans_vel": velocity[..., :2], "humans_seen": seen,
            "humans_shown": whole,
        }  # fmt: skip

    def stand(self, walk: humans.Walk, draw: Draw, values: Values) -> dict[str, NDArray[Any]]:
        """Begin the episodes of all rows with the first person as `walk` (N); return the people's fields of State."""
        crowd, rows = self.people.stand(walk), np.arange(self._rows)
        measured = self.tracker.begin(rows, values, draw.frames, crowd.places, crowd.limbs)
        self.accepted(rows, crowd.limbs)
        self._ends, self._pace[:], self._habits[:] = self._seen_ends(), 0.0, 0.0
        fields = self.people_fields([crowd], measured[:, None])
        return {name: value[:, 0] for name, value in fields.items()} | self.people_bodies()

    def _planned(
        self, crowds: Sequence[Crowd], measured: Array | None, points: Sequence[SetPoints], steps: NDArray[np.int64],
        grips: Sequence[Array] | None, bodies: Array = NOT_BEGUN,
    ) -> Planned:  # fmt: skip
        """Return what is known of the people of K instants, `measured` as of `people_fields`, and of the K set-points.

        `steps` (N, K) are the control steps of the episodes, `grips` the K set-points of the hands.
        """
        moving = {name: instants([getattr(each, name) for each in points]) for name in vars(points[0])}
        named = {SET_POINTS.get(name, name): value for name, value in moving.items()}
        limbs = instants([crowd.limbs for crowd in crowds])
        hand = {} if grips is None else {"grip_target": instants(grips)}
        return Planned({**named, **self.people_fields(crowds, measured), "steps": steps, **hand}, limbs, bodies)

    def _ramp(self, before: Array, increment: Array, k: int, steps: NDArray[np.int64]) -> tuple[Array, SetPoints]:
        """Return the targets (N, substeps, J) rad of control step `k` of an arm without a drive, and its set-points.

        From `before` (N, J) rad on, by `increment` (N, J) rad a control step; `steps` (N,) are those of the episodes.
        """
        ramp = np.arange(k * self._substeps + 1, (k + 1) * self._substeps + 1) / self._substeps
        lowest, highest = self._scene.joint_range.T
        targets = np.minimum(np.maximum(before[:, None] + ramp[:, None] * increment[:, None], lowest), highest)
        return targets, SetPoints.unshielded(targets[:, -1], increment / CONTROL_STEP_S, steps)

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, rows first."""
        every = {"ends": self._ends, "pace": self._pace, "habits": self._habits}
        seen = {name: torch.from_numpy(np.moveaxis(each, -1, 0).copy()) for name, each in every.items()}
        parts = [part.state_dict() for part in self._parts]
        return {"people": self.people.state_dict(), "seen": seen, "parts": parts}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.people.load_state_dict(saved["people"])
        kept = (np.moveaxis(saved["seen"][name].numpy(), 0, -1) for name in ("ends", "pace", "habits"))
        self._ends, self._pace, self._habits = (np.ascontiguousarray(each) for each in kept)
        for part, its in zip(self._parts, saved["parts"], strict=True):
            part.load_state_dict(its)


def arm_bodies(arm: ArmGeometry, joints: Array, of_hand: int) -> dict[str, Array]:
    """Return the fields of State about arms at `joints` (r, J) rad; their last `of_hand` capsules are a gripper's."""
    every = capsules(arm.pose(joints).ends, arm.radius)
    own = len(arm.radius) - of_hand
    return {"arm_body": every[:, :own], "hand_body": every[:, own:]} if of_hand else {"arm_body": every}


def capsules(ends: Array, radius: Array) -> Array:
    """Return capsules (N, C, 7), ends of the axis and radius, m, from their ends (3, C, 2, N) and radii (C,).

    Without radii return the ends (N, C, 6) alone.
    """
    if plain(ends, radius):
        return kernels.capsules(*contiguous(ends, radius))
    (parts, _, n), axes = ends.shape[1:], ends.transpose(3, 1, 2, 0)
    found = axes.reshape(n, parts, 6)
    return np.concatenate([found, np.tile(radius[:, None], (n, 1, 1))], axis=2) if len(radius) else found


def instants(each: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return values (N, K, ...) of K instants from those (N, ...) of each, which lie one after the other in memory."""
    return np.concatenate(each).reshape(len(each), *each[0].shape).swapaxes(0, 1)


def set_points(state: State) -> SetPoints:
    """Return the set-points (N) of a state."""
    named = (SET_POINTS.get(field.name, field.name) for field in fields(SetPoints))
    return SetPoints(*(getattr(state, name).numpy() for name in named))
