"""People's arms: no faster than people are, and drawn back from where the robot touches them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans.body import FOREARM_M, UPPER_ARM_M
from hrl_comfort.humans.kernels import RETREAT_SPEED

Array = NDArray[np.float64]
FASTEST_M_S = 1.6
"""Speed of people: that of walking (ISO 13855:2010, section 6.2.2)."""
SPAN_M = 0.75
"""Largest distance of a hand from the person's axis."""
BACK_M_S = 0.5
"""Speed of a straight arm's hand that is drawn back. Chosen, not measured."""
FIRST_ARM = 3
"""Index in `scene.human.LIMBS` of the first limb of an arm; left and right take turns."""
TOLERANCE_M, PASSES = 1e-6, 10
"""Excess of a limited way that is let pass, and how often a way is shortened at most: the first time leaves arcs."""


@kernel
def limit_arms(bent: Array, limbs: Array, moved: Array, limits: Array, traits: Array) -> None:
    """Limit elbows and hands to what the motion `moved` of the person leaves of `FASTEST_M_S`.

    `limbs` and `bent`, which is changed, are `Walk.limbs` before and after a control step. The others are as in
    `kernels.settle`; arms of people who do as their source says are left as they are.
    """
    for m in range(len(bent)):
        if limits[int(traits[m, 0] * len(limits)), RETREAT_SPEED] == 0.0:
            continue
        pace = math.sqrt(moved[m, 0] ** 2 + moved[m, 1] ** 2) + SPAN_M * abs(moved[m, 2])
        allowed = max(FASTEST_M_S - pace, 0.0) * CONTROL_STEP_S
        for upper in (2, 3):
            for _ in range(PASSES):
                way = arm_way(bent[m], limbs[m], upper)
                if not way > allowed + TOLERANCE_M:  # NaN of an arm that swings in its gait
                    break
                for limb in (upper, upper + 2):
                    size = 0.0
                    for axis in range(3):
                        change = bent[m, limb, axis] - limbs[m, limb, axis]
                        bent[m, limb, axis] = limbs[m, limb, axis] + allowed / way * change
                        size += bent[m, limb, axis] ** 2
                    for axis in range(3):
                        bent[m, limb, axis] /= max(math.sqrt(size), 1e-9)


@kernel
def arm_way(bent: Array, limbs: Array, upper: int) -> float:
    """Return how far, m, elbow or hand of the arm of the limb `upper` goes from `limbs` to `bent` (6, 3)."""
    elbow, hand = 0.0, 0.0
    for axis in range(3):
        bend = UPPER_ARM_M * (bent[upper, axis] - limbs[upper, axis])
        elbow += bend**2
        hand += (bend + FOREARM_M * (bent[upper + 2, axis] - limbs[upper + 2, axis])) ** 2
    return math.sqrt(max(elbow, hand))


@kernel
def drawn_back(limbs: Array, cosine: float, sine: float, touched: int, away: Array) -> Array:
    """Return the limbs (6, 3) of `Walk.limbs` a control step later, of somebody whom the robot touches.

    It touches the limb `touched`, an index of `scene.human.LIMBS`; if that is of an arm that does not swing in its
    gait, the whole arm goes in the direction of the unit vector `away` (3,), cell frame. `cosine` and `sine` are those
    of the person's yaw.
    """
    moved = limbs.copy()
    if touched < FIRST_ARM:
        return moved
    x, y, z = away
    share = BACK_M_S * CONTROL_STEP_S / (UPPER_ARM_M + FOREARM_M)
    step = (cosine * x + sine * y) * share, (cosine * y - sine * x) * share, z * share
    upper = 2 + (touched - FIRST_ARM) % 2
    for limb in (upper, upper + 2):
        a, b, c = limbs[limb, 0] + step[0], limbs[limb, 1] + step[1], limbs[limb, 2] + step[2]
        size = math.sqrt(a * a + b * b + c * c)
        moved[limb, 0], moved[limb, 1], moved[limb, 2] = a / size, b / size, c / size
    return moved
