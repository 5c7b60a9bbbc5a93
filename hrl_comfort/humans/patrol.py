"""Somebody who goes from table to table."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans.walk import Array, Walk, facing_base, length

WHOLE_RAD = 2 * np.pi
NEGLIGIBLE_RAD = NEGLIGIBLE_M = 1e-9


def patrol(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Go round the robot to the next of `stations_m`, work there for `stay_s` on average, and so on.

    Whoever works faces the robot, whoever walks faces the way round they take, drawn when they set off: so
    their yaw says what they are at. They leave as likely at any moment; from anywhere else they go at once.
    """
    stations = np.array(config.stations_m, dtype=np.float64)
    away = np.linalg.norm(walk.position[:, None] - stations, axis=-1).min(axis=1) > NEGLIGIBLE_M
    bearing = np.arctan2(walk.position[:, 1], walk.position[:, 0])
    way = np.sign(np.round(np.sin(facing_base(walk.position) - walk.yaw), 3))
    leaving = (way == 0) & (away | (noise[:, 2] * config.stay_s < CONTROL_STEP_S))
    way = np.where(leaving, np.where(noise[:, 0] < 0.5, 1.0, -1.0), way)

    ahead = (np.arctan2(stations[:, 1], stations[:, 0]) - bearing[:, None]) * way[:, None] % WHOLE_RAD
    ahead = np.where(ahead < NEGLIGIBLE_RAD, WHOLE_RAD, ahead)  # the one they leave is a whole round away
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
