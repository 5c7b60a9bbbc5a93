"""A person whose level falls when a near arm moves fast, and recovers: `comfort.source=frightened`.

Fright is f = max(0, 1 - d / near) min(v / fast, 1), d the arm distance and v the tool's speed: an arm at rest frightens
nobody, nor does a far one. The level follows d(level)/dt = (N_c - level) / recovery_s - (N_c - 1) f / stress_s. Model
and numbers (`comfort.person`) are chosen, not fitted to people: they make the level depend on what the arm does, to
compare a robot that is told of it with one that is not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, ComfortConfig

Floats = NDArray[np.float64]


def level_rate(level: Floats, arm_distance_m: Floats, speed_m_s: Floats, config: ComfortConfig) -> Floats:
    """Return the change (N,) of levels (N,), 1/s, at arm distances (N,) and tool speeds (N,)."""
    person, top = config.person, float(config.levels)
    fright = np.maximum(0.0, 1.0 - arm_distance_m / person.near_m) * np.minimum(speed_m_s / person.fast_m_s, 1.0)
    rate: Floats = (top - level) / person.recovery_s - (top - 1.0) * fright / person.stress_s
    return rate


def mean_level(arm_distance: Floats, tool: Floats, config: ComfortConfig) -> float:
    """Return this person's mean level beside an arm that takes no notice of it.

    `arm_distance` (T + 1,) m and `tool` (T + 1, 3) m are those of an episode's instants.
    """
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=-1) / CONTROL_STEP_S
    # The rate is linear in the level: what fright takes a step, and what is left of the gap to N_c.
    taken = -level_rate(np.full(len(speed), float(config.levels)), arm_distance[1:], speed, config) * CONTROL_STEP_S
    left, gap, total = 1.0 - CONTROL_STEP_S / config.person.recovery_s, 0.0, 0.0
    for each in taken.tolist():
        gap = min(max(left * gap + each, 0.0), config.levels - 1.0)
        total += gap
    return config.levels - total / len(taken)
