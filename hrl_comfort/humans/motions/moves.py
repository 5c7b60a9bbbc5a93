"""Moves of which the compiled motions are made: walking, ways round the robot and reaching."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans.body import FARTHEST_M, FOREARM_M, NEAREST_M, POLE, SHOULDERS, SIDES, UPPER_ARM_M
from hrl_comfort.humans.kernels import reach, stepped
from hrl_comfort.humans.steering import CARRYING, SLOWEST

Array = NDArray[np.float64]
NUMBERS = (
    "speed_m_s", "acceleration_m_s2", "stay_s", "jitter_m", "forward_m", "forward_probability", "curiosity", "arc_deg",
    "arc_steps",
)  # fmt: skip
"""Numbers of a motion, keys of `HumanConfig`; an acceleration of None is NaN."""
SPEED, ACCELERATION, STAY, JITTER, FORWARD, FORWARD_PROBABILITY, CURIOSITY, ARC, ARC_STEPS = range(len(NUMBERS))
FULL_TURN = 2 * math.pi
INTO_M = 0.4
"""From the station to the hands' place, towards the robot: stations lie that far behind the objects' places."""
APART_M = 0.06
"""Of each hand from between them."""
STRAIGHT_M = 0.3
"""Distance from the goal below which people walk straight to it."""


@kernel
def towards(dx: float, dy: float, speed_m_s: float, acceleration_m_s2: float) -> tuple[float, float]:
    """Return the velocity (vx, vy) m/s towards an offset (dx, dy) m, of somebody who can stop there."""
    distance, brake = math.sqrt(dx * dx + dy * dy), acceleration_m_s2 * CONTROL_STEP_S
    arriving = math.sqrt(brake * brake + 2 * acceleration_m_s2 * distance) - brake
    share = min(speed_m_s, arriving) / max(distance, 1e-9)
    return dx * share, dy * share


@kernel
def pace(who: Array, of: Array) -> float:
    """Return the walking speed, m/s, of people whose `traits` differ: 60 to 100 % of `speed_m_s`."""
    return of[SPEED] * (SLOWEST + (1 - SLOWEST) * who[8])


@kernel
def walking(who: Array, of: Array, wx: float, wy: float, discs: Array, radius_m: float) -> tuple[float, float]:
    """See `steering.step`: somebody who wants (wx, wy) m/s beside discs."""
    return stepped(who[0], who[1], who[3], who[4], wx, wy, discs, radius_m, of[SPEED], of[ACCELERATION])


@kernel
def minimum_jerk(share: float) -> float:
    """Return the part of a reach that is done after a `share` of its time."""
    share = min(max(share, 0.0), 1.0)
    return share * share * share * (10 - 15 * share + 6 * (share * share))


@kernel
def way_round(x: float, y: float, gx: float, gy: float) -> tuple[float, float]:
    """Return the way, m, from (x, y) to (gx, gy): the shorter one round the robot, near the goal the straight one."""
    dx, dy = gx - x, gy - y
    if math.sqrt(dx * dx + dy * dy) >= STRAIGHT_M:
        bearing, radius = math.atan2(y, x), math.sqrt(x * x + y * y)
        left = (math.atan2(gy, gx) - bearing + math.pi) % FULL_TURN - math.pi
        outwards, aside = math.sqrt(gx * gx + gy * gy) - radius, radius * left
        cos, sin = math.cos(bearing), math.sin(bearing)
        dx, dy = cos * outwards - sin * aside, sin * outwards + cos * aside
    return dx, dy


@kernel
def before(sx: float, sy: float) -> tuple[float, float]:
    """Return where (x, y) m the hands of somebody at the station (sx, sy) m go."""
    into = 1 - INTO_M / max(math.sqrt(sx * sx + sy * sy), INTO_M)
    return sx * into, sy * into


@kernel
def reach_out(
    limbs: Array, x: float, y: float, yaw: float, tx: float, ty: float, share: float, height_m: float, across_m: float
) -> None:
    """Bring both hands a `share` of the way from before the body to (tx, ty) m, `height_m` above the floor.

    They are `across_m` to the left of it.
    """
    cos, sin, dx, dy = math.cos(yaw), math.sin(yaw), tx - x, ty - y
    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
    for side in range(2):
        limbs[side, 0] = limbs[side, 1] = limbs[side, 2] = np.nan
        hx, hy, hz = CARRYING[side]
        across = aside + across_m + APART_M * SIDES[side]
        hand = hx + share * (ahead - hx), hy + share * (across - hy), hz + share * (height_m - hz)
        reach(
            hand, SHOULDERS[side], POLE[side], limbs[2 + side], limbs[4 + side], UPPER_ARM_M, FOREARM_M, NEAREST_M,
            FARTHEST_M,
        )  # fmt: skip
