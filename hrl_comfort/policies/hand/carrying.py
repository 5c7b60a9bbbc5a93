"""Speed at which an arm carries an object: a faster hand loses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.safety.geometry import ArmGeometry

Array = NDArray[np.float64]
CARRY_M_S = 1.0
"""Largest speed of a tool that carries an object."""


def carried(arm: ArmGeometry, joints: Array, move: Array, spent_s: float) -> Array:
    """Return joint increments (N, J) rad from `joints` (N, J) rad, in `spent_s`, along `move` (N, J) rad.

    They are shorter where the tool would be faster than CARRY_M_S.
    """
    way = np.linalg.norm(arm.tool(joints + move) - arm.tool(joints), axis=1)
    return move * np.minimum(1.0, CARRY_M_S * spent_s / np.maximum(way, 1e-9))[:, None]
