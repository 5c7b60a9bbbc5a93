"""People who have touched the arm step back from it and wait, or they would stand in its way for ever."""

from __future__ import annotations

from hrl_comfort.config import HumanConfig
from hrl_comfort.humans.motions import bounds

RETREAT_STEPS = 100
"""Control steps of a retreat, 2 s; at its end people stand (`kernels.WAIT_STEPS`)."""
SPEED_M_S, ACCELERATION_M_S2 = 0.5, 2.0
"""Of a step backwards, about half a metre in all. Chosen, not measured."""
STAYING = ("adversary", "live", "recorded")
"""Motions of people who stay where they touch the arm, or do as their source says."""


def retreat_limits(config: HumanConfig) -> tuple[float, float]:
    """Return the largest speed (m/s) and acceleration (m/s²) of a retreat; 0 of those who stay."""
    if config.motion in STAYING:
        return 0.0, 0.0
    speed, acceleration = bounds(config)
    return min(speed, SPEED_M_S), min(acceleration, ACCELERATION_M_S2)
