"""Configuration of the shield between policy and arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hrl_comfort.config.checks import choice, within


@dataclass(frozen=True)
class SafetyConfig:
    """Speed and separation monitoring; its guarantee and assumptions are in docs/safety.md."""

    kind: Annotated[str, choice("none", "ssm")]
    """`ssm` slows the arm so that the person cannot reach it while it is fast; `none` lets every action through."""
    bound: Annotated[str, choice("worst", "observed")]
    """Assumption about the person: `worst` lets them move at `human_speed_m_s` at any time, `observed` lets them speed
    up from their measured speed."""
    human_speed_m_s: Annotated[float, within(0.1, 5.0)]
    """Largest speed of any part of the person, m/s (ISO 13855: 1.6)."""
    human_acceleration_m_s2: Annotated[float, within(0.1, 100.0)]
    """`observed`: largest acceleration of any part of the person, m/s²."""
    safe_speed_m_s: Annotated[float, within(0.01, 1.0)]
    """Speed below which a moving arm may meet the person, m/s (ISO 10218-1: 0.25)."""
    delay_s: Annotated[float, within(0.0, 1.0)]
    """Age of the person's measured position, s."""
    lag_s: Annotated[float, within(0.0, 2.0)]
    """Lag of the servos behind a ramp of set-points, s."""
    latency_s: Annotated[float, within(0.0, 2.0)]
    """Time from a set-point until the servos have it, s. In `deploy` it is the time from sending a set-point until the
    resulting angles are measured, minus `lag_s`."""
    clearance_m: Annotated[float, within(0.001, 0.2)] | None
    """Distance that set-points of a rated arm keep from places, obstacles, the floor and the arm's own links, by
    braking in time, m; null: the arm may run into them."""
    margin_m: Annotated[float, within(0.0, 0.5)]
    """Largest error of the measured positions of person and arm, m."""
