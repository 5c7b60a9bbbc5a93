"""Motion `arc`, as in the paper's released code: an arc around the robot with a random-walk radius."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import HumanConfig
from hrl_comfort.humans.motions.random_walk import random_walk
from hrl_comfort.humans.walk import Array, Surroundings, Walk, facing_base


def arc(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Move the bearing by `arc_deg` over `arc_steps` and back; take the radius from `random_walk`."""
    wandered, _ = random_walk(config, walk, noise, around)
    radius = np.linalg.norm(wandered, axis=-1)
    turns = (walk.step + 1) / config.arc_steps
    share = 1.0 - np.abs(1.0 - turns % 2.0)
    bearing = np.arctan2(walk.spawn[:, 1], walk.spawn[:, 0]) + np.radians(config.arc_deg) * share
    position = radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return position, facing_base(position)
