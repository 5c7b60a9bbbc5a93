"""Motion `adversary`: a human who heads for the nearest link of the arm, and draws back at times."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import steering
from hrl_comfort.humans.walk import Array, Stride, Surroundings, Walk, length

BOUT_S = 1.6
"""Mean time for which the human heads for the arm or draws back."""
RETREAT_SHARE, FARTHEST_M = 1 / 3, 1.5
"""Share of bouts in which the human draws back, and how far from the nearest link."""
HANGING = np.array([0.0, 0.0, -1.0])


def adversary(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Head for the nearest link at up to `speed_m_s`, within `acceleration_m_s2`; draw back in a third of bouts.

    Speed and acceleration of `conf/human/adversary.yaml` are the bounds that the shield assumes. The human does not
    turn, and the limbs hang, so that no part is faster than the body. Memory: 1 while drawing back.
    """
    assert config.acceleration_m_s2 is not None
    points = around.arm()[0][..., :2]
    offset = points - walk.position[:, None]
    nearest = (offset * offset).sum(axis=-1).argmin(axis=1)
    offset = offset[np.arange(len(offset)), nearest]
    memory = walk.memory.copy()
    changes = noise[:, 0] * BOUT_S < CONTROL_STEP_S
    memory[:, 0] = np.where(changes, noise[:, 1] < RETREAT_SHARE, memory[:, 0])
    distance = length(offset)[:, None]
    towards = offset / np.maximum(distance, 1e-9)
    back = (memory[:, :1] > 0) & (distance < FARTHEST_M)
    wanted = np.where(back, -towards, towards) * config.speed_m_s
    position, limbs = steering.step(walk, wanted, config, None), np.broadcast_to(HANGING, walk.limbs.shape)
    return Stride(position, walk.yaw, limbs, memory)
