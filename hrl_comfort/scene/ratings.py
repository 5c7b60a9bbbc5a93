"""Ratings of the arms: speeds, accelerations and stops, with their sources.

Joint speeds: e-series datasheets. Accelerations: Universal Robots publish none; what the arm can do is read from
the stops of category 0 from 183 deg/s (3.19 rad/s) at full reach and payload in the appendices of the manuals of
UR3 (159, 154 and 92 ms for base, shoulder and elbow) and UR5 (244, 530 and 164 ms), speed over stopping time; the
wrists are given the base's. `full` may use all of it, `collaborative` half, so that a brake has as much in reserve.
The UR10e has the UR5's, which is an assumption: its manual shows curves without figures, and the UR10's gives stopping
times of the whole safety system only, fault detection and brakes included. Tool speed: 1 m/s is the datasheets' typical
one, 1.5 m/s the manuals' default limit of the safety system.
"""

from __future__ import annotations

from dataclasses import dataclass

from hrl_comfort.scene.ur import UR_ARMS

STOPS_S = {"ur3e": (0.159, 0.154, 0.092), "ur5e": (0.244, 0.530, 0.164), "ur10e": (0.244, 0.530, 0.164)}
STOP_SPEED_RAD_S = 3.19


@dataclass(frozen=True)
class ArmRating:
    """Limits of one arm; joints in order."""

    speed_deg_s: tuple[float, ...]
    acceleration_rad_s2: tuple[float, ...]
    tool_speed_m_s: float


def _rated(robot: str, share: float, tool_speed_m_s: float) -> ArmRating:
    base, shoulder, elbow = (share * STOP_SPEED_RAD_S / time for time in STOPS_S[robot])
    return ArmRating(UR_ARMS[robot].speed_deg_s, (base, shoulder, elbow, base, base, base), tool_speed_m_s)


RATINGS: dict[str, dict[str, ArmRating]] = {
    robot: {"collaborative": _rated(robot, 0.5, 1.0), "full": _rated(robot, 1.0, 1.5)} for robot in STOPS_S
}
"""Robot -> value of `robot.rating` -> limits."""
