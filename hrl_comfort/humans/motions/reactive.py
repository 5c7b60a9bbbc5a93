"""Motion `reactive`: a human who walks between stations and yields to the moving arm, or comes to look at it."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import steering
from hrl_comfort.humans.walk import Array, Stride, Surroundings, Walk, length

RELAXATION_S = 0.5
"""Time in which people reach their desired velocity (Helbing and Molnár, Physical Review E 51, 1995)."""
IMPORTANCE, RANGE, SHARP, SHARPER, FACTOR_M_S2 = 2.0, 0.35, 2.0, 3.0, 5.1
"""λ, γ, n, n′ (Moussaïd et al., Proceedings of the Royal Society B 276, 2009) and the strength that pedsim uses."""
LOOKING_M = 0.7
"""Distance from the tool at which a curious human stops: the arm's length of two people who talk."""
NEAR_M = 0.1


def reactive(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk between the stations under social forces, one of which is the moving arm's.

    `curiosity` 0 is afraid: the nearest moving link repels twice as another person would. At 0.5 it repels as one. 1
    is curious: nothing repels, and the human goes to look at the tool. Memory: goal (station number), remaining stay
    (s).
    """
    assert config.acceleration_m_s2 is not None
    stations, rows = around.stations, np.arange(len(walk.position))
    count = stations.shape[1]
    memory = walk.memory.copy()
    at_start = walk.step == 0
    goal = np.where(at_start, np.floor(noise[:, 0] * count), memory[:, 0]).astype(np.int64)
    there = length(stations[rows, goal] - walk.position) < NEAR_M
    leaving = there & (noise[:, 2] * config.stay_s < CONTROL_STEP_S)
    goal = np.where(leaving, (goal + 1 + np.floor(noise[:, 0] * (count - 1))) % count, goal)
    goal = goal.astype(np.int64)
    memory[:, 0] = goal

    speed = steering.pace(config, walk)
    desired = steering.round_robot(walk.position, stations[rows, goal], speed, config.acceleration_m_s2 / 2)
    to_tool = around.tcp - walk.position
    looking = to_tool * (1 - LOOKING_M / np.maximum(length(to_tool), LOOKING_M))[:, None]
    look = steering.towards(looking, speed, config.acceleration_m_s2 / 2)
    desired = desired + max(2 * config.curiosity - 1, 0.0) * (look - desired)

    points, moving = around.arm()
    velocity = walk.velocity[:, :2]
    repulsion = social_force(walk.position[:, None] - points[..., :2], velocity[:, None] - moving[..., :2])
    strongest = length(repulsion).argmax(axis=1)
    repulsion = repulsion[np.arange(len(strongest)), strongest] * 2 * (1 - config.curiosity)
    force = (desired - velocity) / RELAXATION_S + repulsion
    position = steering.step(walk, velocity + force * CONTROL_STEP_S, config, around)
    going = length(desired) > 0.1
    yaw = steering.turn(walk, steering.bearing_of(np.where(going[:, None], desired, to_tool)))
    return Stride(position, yaw, memory=memory)


def social_force(apart: Array, approach: Array) -> Array:
    """Return the acceleration (..., 2) m/s² by which a person avoids something.

    `apart` (..., 2) m leads from it to the person, `approach` (..., 2) m/s is the person's velocity less its own
    (Moussaïd et al. 2009, equations 3 to 6).
    """
    distance = np.maximum(length(apart), 1e-9)
    away = apart / distance[..., None]
    interaction = away - IMPORTANCE * approach
    size = np.maximum(length(interaction), 1e-9)
    along = interaction / size[..., None]
    turned = np.arctan2(along[..., 1], along[..., 0]) - np.arctan2(away[..., 1], away[..., 0])
    theta = (turned + np.pi) % (2 * np.pi) - np.pi
    reach = RANGE * size
    braking = np.exp(-distance / reach - (SHARPER * reach * theta) ** 2)
    evading = -np.sign(theta) * np.exp(-distance / reach - (SHARP * reach * theta) ** 2)
    left = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    return np.asarray(FACTOR_M_S2 * (braking[..., None] * along + evading[..., None] * left))
