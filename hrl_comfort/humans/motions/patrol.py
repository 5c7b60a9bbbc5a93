"""Motion `patrol`: a human who walks from station to station around the robot."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import steering
from hrl_comfort.humans.walk import Array, Stride, Surroundings, Walk, facing_base, length

FULL_TURN_RAD = 2 * np.pi
EPSILON_RAD = EPSILON_M = 1e-9
NEAR_M = 0.02
"""With an acceleration: distance at which a station is reached."""


def patrol(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk around the robot to the next of the stations, stay there for `stay_s` on average, and repeat.

    The stay has an exponential distribution; away from a station the human leaves at once. The direction is
    drawn on leaving. A working human faces the robot, a walking one the direction. With `acceleration_m_s2` the
    human turns before walking off, starts and stops gradually, and carries the arms before the body; without it
    they change direction and speed at once. Memory: way (1 anticlockwise, -1 clockwise, 0 staying), goal.
    """
    smooth = config.acceleration_m_s2 is not None
    stations, rows = around.stations, np.arange(len(walk.position))
    gaps = length(walk.position[:, None] - stations)
    away = gaps.min(axis=1) > (5 * NEAR_M if smooth else EPSILON_M)
    bearing = np.arctan2(walk.position[:, 1], walk.position[:, 0])
    way, goal = walk.memory[:, 0], walk.memory[:, 1].astype(np.int64)
    leaving = (way == 0) & (away | (noise[:, 2] * config.stay_s < CONTROL_STEP_S))
    way = np.where(leaving, np.where(noise[:, 0] < 0.5, 1.0, -1.0), way)

    ahead = (np.arctan2(stations[..., 1], stations[..., 0]) - bearing[:, None]) * way[:, None] % FULL_TURN_RAD
    here = (ahead < EPSILON_RAD) | (smooth & (gaps < 5 * NEAR_M))
    goal = np.where(leaving, np.where(here, ahead + FULL_TURN_RAD, ahead).argmin(axis=1), goal)
    left = ahead[rows, goal]

    radius = length(walk.position)
    outwards = length(stations)[rows, goal] - radius
    span = np.hypot(radius * left, outwards)
    share = np.minimum(1.0, config.speed_m_s * CONTROL_STEP_S / np.maximum(span, EPSILON_M))
    turned, reached = bearing + way * left * share, radius + outwards * share
    there = reached[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=-1)

    walking, memory = way != 0, walk.memory.copy()
    arrived = span < NEAR_M if smooth else share == 1.0
    memory[:, 0], memory[:, 1] = np.where(arrived, 0.0, way), goal
    if config.acceleration_m_s2 is not None:
        wanted = _wanted(walk, walking & ~arrived, there, span, stations[rows, gaps.argmin(axis=1)], config)
        position = steering.step(walk, wanted, config, around)
        heading = steering.bearing_of(there - walk.position)
        yaw = steering.turn(walk, np.where(walking & ~arrived, heading, facing_base(walk.position)))
        return Stride(position, yaw, memory=memory)
    there = np.where(arrived[:, None], stations[rows, goal], there)
    position = np.where(walking[:, None], there, walk.position)
    facing = facing_base(position)
    return Stride(position, np.where(walking & ~arrived, facing - way * np.pi / 2, facing), memory=memory)


def _wanted(walk: Walk, walking: Array, there: Array, span: Array, station: Array, config: HumanConfig) -> Array:
    """Return the wanted velocity (n, 2) m/s: along the path, once the human faces it, or back to the station."""
    assert config.acceleration_m_s2 is not None
    path = there - walk.position
    path = path / np.maximum(length(path), EPSILON_M)[:, None]
    facing = (path * np.stack([np.cos(walk.yaw), np.sin(walk.yaw)], axis=-1)).sum(axis=1)
    speed = steering.pace(config, walk)
    # Half of the acceleration is left for the bend of the path.
    ahead = steering.towards(path * span[:, None], speed, config.acceleration_m_s2 / 2)
    staying = steering.towards(station - walk.position, speed, config.acceleration_m_s2 / 2)
    return np.where(walking[:, None], ahead * np.maximum(facing, 0.0)[:, None], staying)
