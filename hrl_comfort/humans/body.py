"""Measures of the human's body, and arms that reach to a place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import contiguous, plain
from hrl_comfort.humans import kernels

Array = NDArray[np.float64]

# An upright adult of 1.75 m; proportions: middle of the ranges of Drillis and Contini (1966).
HEIGHT_M = 1.75
HIP_M = 0.93
SHOULDER_M = 1.43
ARM_RADIUS_M = 0.04
ARM_LENGTH_M = 0.62
UPPER_ARM_M = 0.186 * HEIGHT_M
FOREARM_M = ARM_LENGTH_M - ARM_RADIUS_M - UPPER_ARM_M
"""From the elbow to the centre of the fist."""
SHOULDER_HALF_WIDTH_M = 0.18
SIDES = np.array([1.0, -1.0])
"""Left and right."""
SHOULDERS = np.stack([np.zeros(2), SHOULDER_HALF_WIDTH_M * SIDES, np.full(2, SHOULDER_M)], axis=-1)
"""(2, 3) m in the person's frame: x forward, y left, z above the floor."""
STRETCH = 0.97
"""Largest share of the arm's length that is used: the elbow of a straight arm would be infinitely fast."""
POLE = np.stack([np.full(2, -0.3), 0.5 * SIDES, np.full(2, -0.8)], axis=-1)
"""(2, 3), where the elbows point, in the person's frame."""

NEAREST_M, FARTHEST_M = abs(UPPER_ARM_M - FOREARM_M) + 0.05, STRETCH * (UPPER_ARM_M + FOREARM_M)
"""Distances of the hands from the shoulders."""
HANGING = SHOULDERS - [0.0, 0.0, STRETCH * (UPPER_ARM_M + FOREARM_M)]
"""(2, 3) m, the hands of hanging arms, in the person's frame."""


def hands(limbs: Array) -> Array:
    """Return the hands (n, 2, 3) m, in their frame, of people with `limbs` (n, 6, 3) as `Walk.limbs`."""
    return np.asarray(SHOULDERS + UPPER_ARM_M * limbs[:, 2:4] + FOREARM_M * limbs[:, 4:])


def reaching(hands: Array) -> Array:
    """Return limbs (n, 6, 3), as `Walk.limbs`, of people with hands at (n, 2, 3) m in their frame; the legs walk.

    Two-link inverse kinematics; the elbows point down and outwards. A hand that is out of reach stops on the way.
    """
    if plain(hands):
        return kernels.reaching(*contiguous(hands), SHOULDERS, POLE, UPPER_ARM_M, FOREARM_M, NEAREST_M, FARTHEST_M)
    offset = hands - SHOULDERS
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    along = offset / np.maximum(distance, 1e-9)
    distance = np.clip(distance, NEAREST_M, FARTHEST_M)
    forth = (distance**2 + UPPER_ARM_M**2 - FOREARM_M**2) / (2 * distance)
    aside = np.sqrt(UPPER_ARM_M**2 - forth**2)
    out = POLE - (POLE * along).sum(axis=-1, keepdims=True) * along
    elbow = forth * along + aside * out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-9)
    limbs = np.full((len(hands), 6, 3), np.nan)
    limbs[:, 2:4] = elbow / UPPER_ARM_M
    limbs[:, 4:] = (distance * along - elbow) / FOREARM_M
    return limbs
