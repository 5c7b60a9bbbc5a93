"""Motion `worker`: a human who walks to a table and reaches into it with both hands."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import body, steering
from hrl_comfort.humans.walk import Array, Stride, Surroundings, Walk, length

NEAR_M = 0.05
REACH_S, STAY_S, PAUSE_S = 1.2, 0.8, 0.8
"""Reaching out, handling and pausing: reaches of 0.5 m take about a second (Jeannerod, Journal of Motor Behavior 16,
1984); the profile is that of minimum jerk (Flash and Hogan, Journal of Neuroscience 5, 1985), whose largest speed here
is 0.9 m/s."""
LOWEST_M, HIGHEST_M = 1.0, 1.25
"""Of the hands above the floor; the balls of the paper's cell lie at 1.04 m."""
INTO_M = 0.4
"""From the station to the hands' place, towards the robot: stations lie that far behind the objects' places."""
ASIDE_M = 0.10
"""Farthest of a hand from the middle of the table to its side."""


def worker(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk to the station nearest to the spawn point, and there reach again and again to the place of the objects.

    Memory: time in the cycle of reaching (s), and the hands' height and offset to the side (m) of this reach.
    """
    assert config.acceleration_m_s2 is not None
    nearest = length(walk.spawn[:, None] - around.stations).argmin(axis=1)
    station = around.stations[np.arange(len(nearest)), nearest]
    offset = station - walk.position
    there = length(offset) < NEAR_M
    speed = steering.pace(config, walk)
    wanted = steering.towards(offset, speed, config.acceleration_m_s2 / 2)
    position = steering.step(walk, wanted, config, around)
    table = station * (1 - INTO_M / np.maximum(length(station), INTO_M))[:, None]
    yaw = steering.turn(walk, np.where(there, steering.bearing_of(table - position), steering.bearing_of(offset)))

    memory = walk.memory.copy()
    clock = np.where(there | (memory[:, 0] > 0), memory[:, 0] + CONTROL_STEP_S, 0.0)
    begins = (clock > 2 * REACH_S + STAY_S + PAUSE_S) | (walk.memory[:, 0] == 0)
    memory[:, 0] = np.where(clock > 2 * REACH_S + STAY_S + PAUSE_S, CONTROL_STEP_S, clock)
    drawn = np.stack([LOWEST_M + (HIGHEST_M - LOWEST_M) * noise[:, 0], ASIDE_M * (2 * noise[:, 1] - 1)], axis=-1)
    memory[:, 1:3] = np.where(begins[:, None], drawn, memory[:, 1:3])
    return Stride(position, yaw, body.reaching(_hands(config, walk, memory, table - walk.position)), memory)


def _hands(config: HumanConfig, walk: Walk, memory: Array, table: Array) -> Array:
    """Return the hands (n, 2, 3) m in the person's frame; `table` (n, 2) m is where its middle is from the person."""
    out = np.clip(memory[:, 0] / REACH_S, 0.0, 1.0)
    back = np.clip((memory[:, 0] - REACH_S - STAY_S) / REACH_S, 0.0, 1.0)
    share = _minimum_jerk(out) - _minimum_jerk(back)
    cos, sin = np.cos(walk.yaw), np.sin(walk.yaw)
    ahead, aside = cos * table[:, 0] + sin * table[:, 1], cos * table[:, 1] - sin * table[:, 0]
    target = np.empty((len(table), 2, 3))
    target[..., 0] = ahead[:, None]
    target[..., 1] = (aside + memory[:, 2])[:, None] + 0.06 * body.SIDES
    target[..., 2] = memory[:, 1:2]
    return np.asarray(steering.CARRYING + share[:, None, None] * (target - steering.CARRYING))


def _minimum_jerk(share: Array) -> Array:
    return np.asarray(share**3 * (10 - 15 * share + 6 * share**2))
