"""Set-points at 500 Hz between the control steps, checked against the rating before each is sent.

The set-points of control steps are the control points of a quadratic spline. Its velocity runs linearly from one
control step's to the next one's, so that its acceleration is within the rating wherever theirs is. It follows the
polygon of the control steps half a control step later.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, DeployConfig, EnvConfig
from hrl_comfort.deploy.arms import PERIOD_S, Arm, Reading
from hrl_comfort.safety.drive import following_bound, rating_of
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.safety.rating import Rating
from hrl_comfort.scene.workcell import Scene

Array = NDArray[np.float64]
TICKS = round(CONTROL_STEP_S / PERIOD_S)
"""Set-points of a control step."""
ROUNDING = 1e-6
"""Share of a limit by which set-points may exceed it."""
LATE_STEPS = 2
"""Control steps in a row that came too late, at which the arm is stopped."""
COLUMNS = ("time_s", "late_s", "step", "tick", "planned")
"""Of the log, before the set-points (J), rad, and the measured angles (J), rad. `planned` is 1 under a planned control
step, 0 where none was asked for, -1 where it was late and -2 in a stop."""
HAND_COLUMNS = ("hand_sent", "hand", "fingers")
"""Of the log of an arm with a hand, the last ones: set-point and position, 0 open to 1 closed, and `Fingers`."""


@dataclass(frozen=True)
class Limits:
    """Limits of set-points."""

    rating: Rating
    arm: ArmGeometry
    low: Array
    high: Array
    """(J,) rad, range of the joints."""
    following: Array
    """(J,) rad, largest distance of the measured joints from the set-points."""

    @classmethod
    def of(cls, config: EnvConfig | DeployConfig, scene: Scene) -> Limits:
        """Return the limits of the arm of `config`, whose servos are as late as the shield allows for."""
        rating = rating_of(config.robot)
        following = following_bound(rating, config.safety.lag_s + config.safety.latency_s)
        low, high = scene.joint_range.T
        return cls(rating, ArmGeometry(scene), low, high, following)

    def broken(self, before: Array, velocity: Array, angles: Array) -> str:
        """Return which limit the set-point `angles` (J,) breaks after `before` (J,) rad; empty for none.

        `velocity` (J,) rad/s is that with which the set-points got to `before`.
        """
        speed = (angles - before) / PERIOD_S
        over = {
            "speed": np.abs(speed) / self.rating.speed_rad_s,
            "acceleration": np.abs(speed - velocity) / PERIOD_S / self.rating.acceleration_rad_s2,
        }
        for name, share in over.items():
            if not (share <= 1 + ROUNDING).all():  # NaN too
                joint = int(np.argmax(share))
                return f"{name} of joint {joint} at {100 * share[joint]:.4g} % of its limit"
        if not ((angles >= self.low - ROUNDING) & (angles <= self.high + ROUNDING)).all():
            return "a joint beyond its range"
        fastest = float(self.arm.speeds(self.arm.pose(angles[None]), speed[None]).max())
        if fastest > self.rating.tool_speed_m_s * (1 + ROUNDING):
            return f"a point of the arm at {fastest:.3f} m/s"
        return ""


@dataclass(frozen=True)
class Report:
    """State of the streamer as a control step begins, for the plan of the next one."""

    step: int
    point: Array
    """(J,) rad, set-point of the control step, which the next one is planned from."""
    velocity: Array
    """(J,) rad/s, with which it is reached."""
    reading: Reading
    stopped: str
    """Reason why the arm was stopped; empty while it follows the plan."""
    at_rest: bool
    """The set-points stand still."""


class Streamer:
    """Set-points of an arm, one a call of `tick`.

    Args:
      arm: that follows them.
      limits: that they keep to; one that would break them is not sent, and the arm is stopped.
      log: file of rows of COLUMNS and angles, float64.
    """

    def __init__(self, arm: Arm, limits: Limits, log: BinaryIO) -> None:
        self.arm, self._limits, self._log = arm, limits, log
        self._reading = arm.read()
        self._closed = None if self._reading.hand is None else self._reading.hand.closed
        self.step = 0
        self.point = self._sent = self._reading.angles.copy()
        self.velocity = np.zeros_like(self.point)
        self._speed = np.zeros_like(self.point)
        self._planned = 0
        self._misses = 0
        self.stopped = self._reading.trouble
        self._brake = (self.point, self.velocity, 0.0)

    def begin_step(self, target: Array | None, late: bool = False) -> None:
        """Begin a control step to `target` (J,) rad; None, or a `late` plan, brakes as the rating says.

        Of an arm with a hand, `target` is (J + 1,); fingers that are not told anything new keep their set-point.
        """
        self._from, self._before = self._sent, self.velocity
        if target is not None and self._closed is not None:
            target, self._closed = target[:-1], float(target[-1])
        if target is None or late:
            self.velocity = self._limits.rating.brake(self.velocity[None])[0]
        else:
            self.velocity = (target - self.point) / CONTROL_STEP_S
        self.point = self.point + self.velocity * CONTROL_STEP_S
        if not self.stopped:  # the report of this control step tells it already
            self._check(self._between(1 / TICKS))
        self._planned = -1 if late else int(target is not None)
        self.step += abs(self._planned)
        self._misses = self._misses + 1 if late else 0
        if self._misses >= LATE_STEPS:
            self.stop(f"late cycle: {LATE_STEPS} control steps in a row had no set-point in time")

    def tick(self, number: int, late_s: float = 0.0) -> None:
        """Send the set-point `number`, 0 to TICKS - 1, of the control step; `late_s` goes to the log."""
        share = (number + 1) / TICKS
        if not self.stopped:
            angles = self._between(share)
            self._check(angles)
        if self.stopped:
            angles = self._braked()
        self._speed = (angles - self._sent) / PERIOD_S
        self._sent = angles
        try:
            self.arm.send(angles if self._closed is None else np.append(angles, self._closed))
            self._reading = self.arm.read()
            if self._reading.trouble:
                self.stop(self._reading.trouble)
            self._check_following()
        except ConnectionError as error:
            self.stop(f"lost connection: {error}")
        code = -2 if self.stopped else self._planned
        row = [time.monotonic(), late_s, self.step, number, code, *self._sent, *self._reading.angles]
        if self._closed is not None and (hand := self._reading.hand) is not None:
            row += [self._closed, hand.closed, hand.fingers]
        self._log.write(np.array(row, dtype=np.float64).tobytes())

    def _between(self, share: float) -> Array:
        """Return the set-point (J,) rad when the `share` of the control step has passed."""
        way = self._before * share + (self.velocity - self._before) * share * share / 2
        return self._from + way * CONTROL_STEP_S

    def _check(self, angles: Array) -> None:
        """Stop the arm where the set-point `angles` (J,) rad, the next one, would break a limit."""
        if broken := self._limits.broken(self._sent, self._speed, angles):
            self.stop(f"limit: the next set-point has {broken}")

    def _check_following(self) -> None:
        """Stop the arm where a joint is too far from its set-point: something holds it, or it does not follow."""
        share = np.abs(self._sent - self._reading.angles) / self._limits.following
        if not (share <= 1).all():  # NaN too
            joint = int(np.argmax(share))
            degrees = np.degrees(self._sent - self._reading.angles)[joint]
            self.stop(f"following error: joint {joint} is {degrees:.3g} degrees from its set-point")

    def stop(self, why: str) -> None:
        """Bring the set-points to rest by the rated brake and hold them there; the first reason counts."""
        if not self.stopped:
            self.stopped = why
            self._brake = (self._sent, self._speed, 0.0)

    def _braked(self) -> Array:
        start, velocity, passed = self._brake
        lasts = float(self._limits.rating.stopping_time(velocity[None])[0])
        passed = min(passed + PERIOD_S, lasts)
        self._brake = (start, velocity, passed)
        return start + velocity * (passed - passed * passed / (2 * max(lasts, 1e-12)))

    def report(self) -> Report:
        """Return the state for the plan of the next control step, once this one has begun."""
        still = not self._speed.any() and (bool(self.stopped) or not self.velocity.any())
        return Report(self.step, self.point, self.velocity, self._reading, self.stopped, still)
