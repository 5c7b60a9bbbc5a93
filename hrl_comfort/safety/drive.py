"""From the motion that a policy asks for to the set-points of the arm: rating, then shield."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EnvConfig, RobotConfig
from hrl_comfort.safety import drive_kernels
from hrl_comfort.safety.allowances import check_allowances, largest_lateness
from hrl_comfort.safety.clearance import Clearance
from hrl_comfort.safety.geometry import ArmPose, gaps
from hrl_comfort.safety.rating import Rating
from hrl_comfort.safety.rows import InRows, Rows, in_rows
from hrl_comfort.safety.separation import Encounter, Separation
from hrl_comfort.safety.shield import Memory, Motion, Shield
from hrl_comfort.scene.ratings import RATINGS
from hrl_comfort.scene.servos import SERVO_LAG_S
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
TRANSIENT_RAD = 0.05
"""Following error that the rated accelerations may add to what the servos' lateness makes of the rated speeds."""


@dataclass(frozen=True)
class SetPoints:
    """Set-points of N arms at the end of a control step."""

    angles: Array
    """(N, J) rad."""
    velocity: Array
    """(N, J) rad/s, with which they got there."""
    share: Array
    """(N,) of the asked speed that was passed, in [0, 1]; 1 if none was asked."""
    share_sum: Array
    """(N,) its sum over the episode."""
    braking: NDArray[np.bool_]
    """(N,) whether the shield commanded the rated brake, or the set-points were taken back to the arm."""
    protective_stops: NDArray[np.int64]
    """(N,) how often in the episode it began to."""
    human_beyond_bound: NDArray[np.int64]
    """(N,) control steps of the episode in which the person came nearer to a link than the shield assumes."""

    @classmethod
    def unshielded(cls, angles: Array, velocity: Array, steps: NDArray[np.int64]) -> SetPoints:
        """Return set-points that pass all that is asked for, `steps` (N,) control steps after the episode began."""
        n = len(steps)
        none = np.zeros(n, dtype=bool)
        count = np.zeros(n, dtype=np.int64)
        return cls(angles, velocity, np.ones(n), steps.astype(float), none, count, count)

    def ramp(self, before: Array, substeps: int) -> Array:
        """Return the targets (N, substeps, J) rad of the control step, from `before` (N, J) rad on."""
        return drive_kernels.ramp(*contiguous(before, self.angles), substeps)


class Drive:
    """Set-points of N arms, one control step at a time.

    Where the arm does not follow them, they stop and are taken back to it, as in a controller's protective stop: a
    servo that is released from farther away would fling the arm.

    Args:
      scene: with the arm.
      separation: of arm and person.
      config: of the cell.
      rows: number N of arms.
      within: how something is computed in some rows alone.
      takes_back: whether set-points jump back to an arm that does not follow; those of a real arm brake, and the run
        ends.
    """

    def __init__(
        self,
        scene: Scene,
        separation: Separation,
        config: EnvConfig,
        rows: int,
        within: InRows = in_rows,
        takes_back: bool = True,
    ) -> None:
        self._rating, self._in_rows = rating_of(config.robot), within
        self.arm, self._separation = separation.arm, separation
        self._low, self._high = scene.joint_range.T
        self._late_s = largest_lateness(config)
        self.following_rad = following_bound(self._rating, self._late_s)
        """(J,) rad, largest following error of each joint as a control step begins."""
        self.error_rad = self.following_rad + self._rating.speed_rad_s * CONTROL_STEP_S
        """(J,) rad, the same at any time: within a control step it grows by the joint's rated way at most."""
        self._takes_back = takes_back
        self.shield: Shield | None = None
        if config.safety.kind == "ssm":
            self.shield = Shield(separation, self._rating, config.safety, rows, within)
        clearance = config.safety.clearance_m
        self._clearance = None if clearance is None else Clearance(scene, self.arm, clearance)
        limits = (0.0,) * 9 if self.shield is None else self.shield.limits
        self._constants = [
            *self.arm.compiled, self.arm.radius, self.arm.lever, separation.person.radius,
            np.stack([
                self._rating.speed_rad_s, self._rating.acceleration_rad_s2, self._low, self._high, self.following_rad
            ]),
            np.array([self._rating.tool_speed_m_s, self._late_s, takes_back, self.shield is not None, *limits]),
        ]  # fmt: skip
        """The fields of `drive_kernels.Arm` and `Limits`, as the kernel takes them."""

    def begin(self, rows: NDArray[np.int64], limbs: Array) -> None:
        """Begin an episode in `rows` (r,), beside people at `limbs` (r, L, 7)."""
        if self.shield is not None:
            self.shield.begin(rows, limbs)

    def rated(self, velocity: Array) -> Array:
        """Return velocities (N, J) rad/s slowed to the rated joint speeds."""
        over = (np.abs(velocity) / self._rating.speed_rad_s).max(axis=1)
        return velocity / np.maximum(over, 1.0)[:, None]

    def reach(self, angles: Array, velocity: Array, limbs: Array) -> Array:
        """Return `Shield.reach` (N,) m, 0 without one; arms at `angles` (N, J) rad, people at `limbs` (N, L, 7)."""
        if self.shield is None:
            return np.zeros(len(angles))
        return self.shield.reach(self._separation.encounter(angles, limbs), velocity)

    def begin_decision(self) -> None:
        """Begin a decision, of which some control steps may turn out void."""
        if self.shield is not None:
            self.shield.begin_decision()

    def end_decision(self, last: NDArray[np.int64]) -> None:
        """End a decision whose last valid control step is `last` (N,), counted from 0."""
        if self.shield is not None:
            self.shield.end_decision(last)

    def step(
        self,
        before: SetPoints,
        asked: Array,
        joints: Array,
        now: Encounter,
        limbs: Array | None = None,
        tops: Array | None = None,
    ) -> tuple[Array, SetPoints]:
        """Return where the set-points of the next control step begin (N, J) rad, and they at its end.

        `asked` (N, J) rad/s is the motion that the policy wants, `joints` (N, 2 J) the measured angles, rad, and
        velocities, rad/s, `now` the arms there beside the people. The shield sees the people at `limbs` (N, L, 7)
        instead, if given. `tops` (N, F, 6), as `State.tops`, is what the arm keeps clear of where it keeps a clearance.
        """
        if self._clearance is None:
            return self._passed(before, asked, joints, now, limbs)
        if tops is None:
            raise ValueError("an arm that keeps a clearance needs to know the tops of what stands there")
        asked = self._clearance.damped(before.angles, asked, tops)
        begin, after = self._passed(before, asked, joints, now, limbs)
        clear = self._clearance.keeps(begin, begin + self._rating.way(after.velocity), tops)
        return begin, self._kept_clear(before, begin, after, clear)

    def _kept_clear(self, before: SetPoints, begin: Array, after: SetPoints, clear: NDArray[np.bool_]) -> SetPoints:
        """Return the set-points `after` a step from `begin` (N, J) rad; where those are not `clear` (N,), the brake's.

        Set-points that were taken back to the arm stand, and stay.
        """
        velocity = np.where(clear[:, None], after.velocity, self._rating.brake(before.velocity))
        angles = np.clip(begin + velocity * CONTROL_STEP_S, self._low, self._high)
        speed, passed = np.linalg.norm(velocity, axis=1), np.linalg.norm(after.velocity, axis=1)
        braked = np.minimum(after.share * speed / np.maximum(passed, 1e-9), 1.0)
        share = np.where(clear, after.share, braked)
        if self.shield is not None:
            self.shield.sent(self.arm.speeds(self.arm.pose(begin), velocity))
        return replace(after, angles=angles, velocity=velocity, share=share, share_sum=before.share_sum + share)

    def _passed(
        self, before: SetPoints, asked: Array, joints: Array, now: Encounter, limbs: Array | None
    ) -> tuple[Array, SetPoints]:
        """Return what rating and shield let pass; see `step`."""
        if plain(joints, now.apart):
            return self._stepped(before, asked, joints, now, now if limbs is None else self._seen(now, limbs))
        measured, moving = joints[:, : self.arm.joints], joints[:, self.arm.joints :]
        error = before.angles - measured
        held = (np.abs(error) / self.following_rad).max(axis=1) > 1.0
        if self.shield is not None:
            seen, motion = self._seen(now, limbs), self._motion(now.pose, error, moving)
            held = held | self.shield.swings(seen, motion)
        back, begin, velocity = held[:, None], before.angles, before.velocity
        if self._takes_back:
            begin = np.where(back, np.clip(measured, self._low, self._high), begin)
            velocity = np.where(back, 0.0, velocity)
        pose = self.arm.pose(begin)
        limited = self._rating.limited(self.arm, pose, asked)
        limited = self._rating.within(self._low, self._high, begin, limited)
        wanted = self._rating.follow(velocity, limited)
        braking = held
        if self.shield is not None:
            wanted, passed = self.shield.step(seen, motion, pose, velocity, wanted)
            braking = braking | (passed == 0.0)
        wanted = self._yielding(begin, velocity, wanted, now)
        kept = self._rating.keeps(self._low, self._high, begin, wanted)
        wanted = np.where(kept[:, None], wanted, self._rating.brake(velocity))
        wanted = np.where(back, self._rating.brake(velocity), wanted)
        speed, most = np.linalg.norm(wanted, axis=1), np.linalg.norm(limited, axis=1)
        share = np.where(most > 0, np.minimum(speed / np.maximum(most, 1e-9), 1.0), 1.0)
        stops = before.protective_stops + (braking & ~before.braking)
        angles = np.clip(begin + wanted * CONTROL_STEP_S, self._low, self._high)
        share_sum, beyond = before.share_sum + share, before.human_beyond_bound
        return begin, SetPoints(angles, wanted, share, share_sum, braking, stops, beyond)

    def _stepped(
        self, before: SetPoints, asked: Array, joints: Array, now: Encounter, seen: Encounter
    ) -> tuple[Array, SetPoints]:
        """Return what `step` does, by its kernel; `seen` are the arms beside the people whom the shield sees."""
        shield, pose = self.shield, now.pose
        memory = Memory(now.person, np.zeros((len(self.arm.radius), 1, 1))) if shield is None else shield.memory
        given = contiguous(
            before.angles, before.velocity, before.share_sum, before.braking, before.protective_stops, asked, joints,
            pose.axis, pose.anchor, pose.ends, now.person, now.apart, seen.person, seen.apart, *vars(memory).values(),
        )  # fmt: skip
        begin, angles, velocity, share, share_sum, braking, stops, trail = drive_kernels.drive(*given, *self._constants)
        if shield is not None:
            shield.remember(seen.person, trail)
        return begin, SetPoints(angles, velocity, share, share_sum, braking, stops, before.human_beyond_bound)

    def beside(self, points: SetPoints, now: Encounter, after: Array, way: float) -> SetPoints:
        """Return the set-points of a control step in which people move on from `now`, their capsules' ends to `after`.

        These are (3, P, 2, N) m; none of them went farther than `way` m.
        """
        if self.shield is None:
            return points
        beyond = self.shield.beyond_bound(now, after, way)
        if not beyond.any():
            return points
        return replace(points, human_beyond_bound=points.human_beyond_bound + beyond)

    def _motion(self, pose: ArmPose, error: Array, moving: Array) -> Motion:
        """Return what the servos may make of an `error` (N, J) rad of arms at `pose` that move at (N, J) rad/s.

        A servo whose damping is `SERVO_LAG_S` times its stiffness drives a joint at error / SERVO_LAG_S at most. What
        lateness explains of the error, between 0 and its time times the joint's velocity, is no drive.
        """
        late = moving * self._late_s
        more = error - np.minimum(np.maximum(error, np.minimum(late, 0.0)), np.maximum(late, 0.0))
        way = self.arm.speeds(pose, error) + self.arm.bending(error) / 2
        return Motion(way, self.arm.speeds(pose, moving + more / SERVO_LAG_S))

    def _seen(self, now: Encounter, limbs: Array | None) -> Encounter:
        if limbs is None:
            return now
        person = self._separation.person.ends(limbs)
        return Encounter(now.pose, person, gaps(self.arm, now.pose.ends, self._separation.person, person))

    def _yielding(self, angles: Array, before: Array, wanted: Array, now: Encounter) -> Array:
        """Return `wanted` (N, J) rad/s, or the rated brake where the arm touches the person and would press on.

        An arm that presses on is pushed away from its set-points, and hits again as it springs back.
        """

        def yielding(rows: Rows) -> Array:
            here, there = (
                gaps(self.arm, self.arm.pose(at).ends, self._separation.person, now.person[..., rows]).min(axis=0)
                for at in (angles[rows], angles[rows] + wanted[rows] * CONTROL_STEP_S)
            )
            return np.where((there < here)[:, None], self._rating.brake(before[rows]), wanted[rows])

        return self._in_rows(now.apart.min(axis=0) <= 0.0, yielding, wanted)

    def state_dict(self) -> dict[str, Tensor]:
        """Return what an exact continuation needs."""
        return {} if self.shield is None else self.shield.state_dict()

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        if self.shield is not None:
            self.shield.load_state_dict(saved)


def following_bound(rating: Rating, late_s: float) -> Array:
    """Return the largest following error (J,) rad of arms whose servos are late by `late_s`.

    Universal Robots stop an arm protectively where its position deviates (codes C153 and C157) and publish no figure;
    drives let it be set (following error window, CiA 402, object 6065h). This is what a joint at its rated speed is
    behind, and TRANSIENT_RAD.
    """
    return rating.speed_rad_s * late_s + TRANSIENT_RAD


def rating_of(robot: RobotConfig) -> Rating:
    """Return the limits of a robot that has a rating."""
    rated = RATINGS[robot.name][robot.rating]
    speed = np.radians(np.array(rated.speed_deg_s))
    return Rating(speed, np.array(rated.acceleration_rad_s2), rated.tool_speed_m_s)


def make_drive(
    scene: Scene,
    separation: Separation,
    config: EnvConfig,
    rows: int,
    within: InRows = in_rows,
    takes_back: bool = True,
) -> Drive | None:
    """Return the drive of `config`, None for the paper's world, whose set-points are what the policy asks for.

    Raises:
      ConfigError: a rating or a shield is asked for of an arm without a known rating, a shield of the paper's arm,
        which has no brake, or one that allows for less than `randomise` does.
    """
    robot, kind = config.robot, config.safety.kind
    check_allowances(config)
    if config.safety.clearance_m is not None and robot.gripper.holds:
        raise ConfigError(
            f"safety.clearance_m={config.safety.clearance_m} does not go with robot.gripper.name={robot.gripper.name}, "
            "which must touch what an object lies on; choose safety.clearance_m=null, or gripper=none"
        )
    if robot.name not in RATINGS and (robot.rating, kind) != ("paper", "none"):
        raise ConfigError(
            f"robot.name={robot.name} has no rating: robot.rating={robot.rating} safety.kind={kind} are for "
            f"{', '.join(RATINGS)}; choose robot.rating=paper safety.kind=none"
        )
    if robot.rating != "paper":
        return Drive(scene, separation, config, rows, within, takes_back)
    if config.safety.clearance_m is not None:
        raise ConfigError(
            f"safety.clearance_m={config.safety.clearance_m} needs an arm that brakes within its rating; "
            "choose robot.rating=collaborative or full instead of paper, or safety.clearance_m=null"
        )
    if kind != "none":
        raise ConfigError(
            f"safety.kind={kind} needs an arm that brakes within its rating; "
            "choose robot.rating=collaborative or full instead of paper"
        )
    return None
