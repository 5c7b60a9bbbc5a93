"""The released code's motion: an arc round the robot whose radius wanders."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import HumanConfig
from hrl_comfort.humans.random_walk import random_walk
from hrl_comfort.humans.walk import Array, Walk, facing_base


def arc(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Swing the bearing along `arc_deg` in `arc_steps` and back; the radius takes the random walk's."""
    wandered, _ = random_walk(config, walk, noise, tcp)
    radius = np.linalg.norm(wandered, axis=-1)
    turns = (walk.step + 1) / config.arc_steps
    share = 1.0 - np.abs(1.0 - turns % 2.0)
    bearing = np.arctan2(walk.spawn[:, 1], walk.spawn[:, 0]) + np.radians(config.arc_deg) * share
    position = radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return position, facing_base(position)
