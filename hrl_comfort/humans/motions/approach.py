"""Motion `approach`: a straight walk to the gripper, the paper's critical case."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans.walk import Array, Surroundings, Walk, length


def approach(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Walk at `speed_m_s` towards the tool centre point and face it."""
    offset = around.tcp - walk.position
    distance = length(offset)[:, None]
    stride = np.minimum(config.speed_m_s * CONTROL_STEP_S, distance)
    position = walk.position + offset / np.maximum(distance, 1e-9) * stride
    return position, np.arctan2(offset[:, 1], offset[:, 0])
