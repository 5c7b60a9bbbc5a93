"""Comfort metrics of an episode, computed from its trajectory (see docs/metrics.md).

An undefined value is None, never zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S

Floats = NDArray[np.float64]

INTIMATE_M, PERSONAL_M, SOCIAL_M = 0.45, 1.2, 3.6
"""Outer radii of the zones around a person (Hall, The Hidden Dimension, 1966)."""
BESIDE_M = 1.0
"""Arm distance within which the tool's speed counts as beside the person."""
SLOW_M_S = 0.01
"""A slower tool counts as waiting."""
SMOOTHING_S = 0.2
"""Time over which speeds of time to contact and separation are averaged: one step's speed is mostly servo ripple."""
SHORT_CONTACT_S = 0.5
CLOSING_M_S = 1e-3
"""Time to contact is infinite at lower closing speeds."""
ROUNDING = 1e-12
"""A smaller dimensionless jerk is a rounding error."""

# Speed and separation monitoring: ISO/TS 15066, since 2025 in ISO 10218-2; terms as in Marvel and Norcross (NIST,
# 2017, PMC5117641). The human's speed is that of the standard, the robot's numbers are those of this simulation.
# The margins compare runs; they are no certification.
WORST_HUMAN_M_S = 1.6
REACTION_S = 0.1
"""One decision of five control steps."""
DECELERATION_M_S2 = 5.0
"""Assumed braking of the tool."""
INTRUSION_M = 0.0
"""C: the body parts are known exactly at every step."""
UNCERTAINTY_M = 0.0
"""Z_d + Z_r: positions are exact in simulation."""


@dataclass(frozen=True)
class Trajectory:
    """One episode of T control steps of 20 ms: T + 1 instants."""

    tool: Floats
    """(T + 1, 3) m, tool centre point."""
    people: Floats
    """(T + 1, P, 2) m, axes of the people."""
    joint_target: Floats
    """(T + 1, J) rad."""
    arm_distance: Floats
    """(T + 1,) m, smallest distance between any link and any body part."""
    human_here: bool


def metrics(path: Trajectory) -> dict[str, float | None]:
    """Return every metric by its column name; those of the human are None if there is no human."""
    moved = {**of_motion(path), "log_dimensionless_jerk": log_dimensionless_jerk(path.tool)}
    person = of_person(path)
    return {**moved, **(person if path.human_here else dict.fromkeys(person))}


def of_motion(path: Trajectory) -> dict[str, float | None]:
    """Return path length (m) and waiting share of the tool, and joint increments (degrees)."""
    lengths = np.linalg.norm(np.diff(path.tool, axis=0), axis=-1)
    increments = np.degrees(np.abs(np.diff(path.joint_target, axis=0)).max(axis=-1))
    return {
        "tool_path_m": float(lengths.sum()),
        "waiting_share": float((lengths < SLOW_M_S * CONTROL_STEP_S).mean()),
        "joint_increment_mean_deg": float(increments.mean()),
        "joint_increment_max_deg": float(increments.max()),
    }


def of_person(path: Trajectory) -> dict[str, float | None]:
    """Return distances from the nearest human, zones, speed near them, time to contact and separation margins."""
    lengths = np.linalg.norm(np.diff(path.tool, axis=0), axis=-1)
    distance = np.linalg.norm(path.tool[1:, None, :2] - path.people[1:], axis=-1).min(axis=-1)
    arm, speed = path.arm_distance[1:], lengths / CONTROL_STEP_S
    near, beside = arm < INTIMATE_M, arm < BESIDE_M
    contact = time_to_contact(path.arm_distance)
    tool = np.linalg.norm(smoothed_rate(path.tool), axis=-1)
    fastest = np.linalg.norm(smoothed_rate(path.people), axis=-1).max(axis=-1)
    worst, observed = (arm - protective_distance(tool, each) for each in (WORST_HUMAN_M_S, fastest))
    return {
        "human_distance_mean_m": float(distance.mean()),
        "human_distance_min_m": float(distance.min()),
        "human_distance_by_path_m": _ratio((distance * lengths).sum(), lengths.sum()),
        "arm_distance_mean_m": float(arm.mean()),
        "arm_distance_min_m": float(arm.min()),
        "zone_intimate": float(near.mean()),
        "zone_personal": float(((arm >= INTIMATE_M) & (arm < PERSONAL_M)).mean()),
        "zone_social": float(((arm >= PERSONAL_M) & (arm < SOCIAL_M)).mean()),
        "tool_speed_near_m_s": float(speed[near].mean()) if near.any() else None,
        "tool_speed_beside_m_s": float(speed[beside].mean()) if beside.any() else None,
        "time_to_contact_min_s": float(contact.min()) if np.isfinite(contact).any() else None,
        "time_to_contact_short": float((contact < SHORT_CONTACT_S).mean()),
        "separation_margin_min_m": float(worst.min()),
        "separation_margin_negative": float((worst < 0).mean()),
        "separation_margin_observed_min_m": float(observed.min()),
        "separation_margin_observed_negative": float((observed < 0).mean()),
    }


def time_to_contact(distance: Floats) -> Floats:
    """Return d / -d' (T,) s for distances (T + 1,) m, d' over SMOOTHING_S; infinite where they do not shrink."""
    closing = -smoothed_rate(distance)
    return np.where(closing > CLOSING_M_S, np.maximum(distance[1:], 0.0) / np.maximum(closing, 1e-9), np.inf)


def smoothed_rate(values: Floats) -> Floats:
    """Return the mean rate (T, ...) 1/s of values (T + 1, ...) over the last SMOOTHING_S, at first over less."""
    now = np.arange(1, len(values))
    before = np.maximum(now - round(SMOOTHING_S / CONTROL_STEP_S), 0)
    spent = (now - before).reshape(-1, *[1] * (values.ndim - 1)) * CONTROL_STEP_S
    return np.asarray((values[now] - values[before]) / spent)


def protective_distance(robot_m_s: Floats, human_m_s: Floats | float) -> Floats:
    """Return S_p = v_h (T_r + T_s) + v_r T_r + v_r^2 / 2a + C + Z_d + Z_r, m, with T_s = v_r / a."""
    stopping_s = robot_m_s / DECELERATION_M_S2
    braking_m = robot_m_s**2 / (2 * DECELERATION_M_S2)
    travelled = human_m_s * (REACTION_S + stopping_s) + robot_m_s * REACTION_S + braking_m
    return np.asarray(travelled + INTRUSION_M + UNCERTAINTY_M)


def log_dimensionless_jerk(tool: Floats) -> float | None:
    """Return -ln[(T^3 / v_peak^2) integral of |v''|^2 dt] of positions (T + 1, 3) m; higher is smoother.

    Balasubramanian et al., J. NeuroEngineering and Rehabilitation 12 (2015). None for fewer than 3 steps, a tool
    that waits throughout, or no jerk.
    """
    velocity = np.diff(tool, axis=0) / CONTROL_STEP_S
    peak = np.linalg.norm(velocity, axis=-1).max(initial=0.0)
    if len(velocity) < 3 or peak < SLOW_M_S:
        return None
    jerk = np.diff(velocity, n=2, axis=0) / CONTROL_STEP_S**2
    duration = len(velocity) * CONTROL_STEP_S
    dimensionless = duration**3 / peak**2 * (jerk**2).sum() * CONTROL_STEP_S
    return float(-np.log(dimensionless)) if dimensionless > ROUNDING else None


def _ratio(above: float, below: float) -> float | None:
    return float(above / below) if below > 0 else None


_STILL = Trajectory(np.zeros((2, 3)), np.ones((2, 1, 2)), np.zeros((2, 6)), np.ones(2), human_here=True)
MEASURES = tuple(metrics(_STILL))
"""Names of the values of `metrics`, in order."""
