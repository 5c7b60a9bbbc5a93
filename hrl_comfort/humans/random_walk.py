"""The paper's random forward walk (its code: `people.arc`)."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import HumanConfig
from hrl_comfort.humans.walk import Array, Walk, facing_base


def random_walk(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Jitter by up to `jitter_m` an axis or, with `forward_probability`, step `forward_m` to the base."""
    jitter = (2 * noise[:, :2] - 1) * config.jitter_m
    yaw = facing_base(walk.position)
    forward = config.forward_m * np.array([np.cos(yaw), np.sin(yaw)]).T
    move = np.where(noise[:, 2:] < config.forward_probability, forward, jitter)
    position = walk.position + move
    return position, facing_base(position)
