"""Motion `patrol`: a human who walks from station to station around the robot."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans.walk import Array, Walk, facing_base, length

FULL_TURN_RAD = 2 * np.pi
EPSILON_RAD = EPSILON_M = 1e-9


def patrol(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Walk around the robot to the next of `stations_m`, stay there for `stay_s` on average, and repeat.

    The stay has an exponential distribution; away from a station the human leaves at once. The direction is
    drawn on leaving. Yaw holds the state: a working human faces the robot, a walking one the direction.
    """
    stations = np.array(config.stations_m, dtype=np.float64)
    away = np.linalg.norm(walk.position[:, None] - stations, axis=-1).min(axis=1) > EPSILON_M
    bearing = np.arctan2(walk.position[:, 1], walk.position[:, 0])
    way = np.sign(np.round(np.sin(facing_base(walk.position) - walk.yaw), 3))
    leaving = (way == 0) & (away | (noise[:, 2] * config.stay_s < CONTROL_STEP_S))
    way = np.where(leaving, np.where(noise[:, 0] < 0.5, 1.0, -1.0), way)

    ahead = (np.arctan2(stations[:, 1], stations[:, 0]) - bearing[:, None]) * way[:, None] % FULL_TURN_RAD
    ahead = np.where(ahead < EPSILON_RAD, FULL_TURN_RAD, ahead)  # the current station is a full turn away
    goal = ahead.argmin(axis=1)
    left = ahead[np.arange(len(goal)), goal]

    radius = length(walk.position)
    outwards = length(stations)[goal] - radius
    share = np.minimum(1.0, config.speed_m_s * CONTROL_STEP_S / np.hypot(radius * left, outwards))
    turned, reached = bearing + way * left * share, radius + outwards * share
    there = reached[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=-1)

    walking, arrived = way != 0, share == 1.0
    there = np.where(arrived[:, None], stations[goal], there)
    position = np.where(walking[:, None], there, walk.position)
    facing = facing_base(position)
    return position, np.where(walking & ~arrived, facing - way * np.pi / 2, facing)
