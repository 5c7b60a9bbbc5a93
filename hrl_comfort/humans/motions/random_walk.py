"""Motion `random_walk`, the paper's "random forward walk".

The paper gives no constants for it. The defaults of `jitter_m`, `forward_m` and `forward_probability` are those
of its released code, which also moves the human along an arc (motion `arc`).
"""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import HumanConfig
from hrl_comfort.humans.walk import Array, Surroundings, Walk, facing_base


def random_walk(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Move up to `jitter_m` along x and y or, with `forward_probability`, `forward_m` towards the base."""
    jitter = (2 * noise[:, :2] - 1) * config.jitter_m
    yaw = facing_base(walk.position)
    forward = config.forward_m * np.array([np.cos(yaw), np.sin(yaw)]).T
    move = np.where(noise[:, 2:] < config.forward_probability, forward, jitter)
    position = walk.position + move
    return position, facing_base(position)
