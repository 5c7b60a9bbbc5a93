"""Motion `none`: no human in the cell."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import FAR_AWAY_M, HumanConfig
from hrl_comfort.humans.walk import Array, Surroundings, Walk


def none(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Stay far away."""
    return np.tile([FAR_AWAY_M, 0.0], (len(walk.yaw), 1)), np.zeros(len(walk.yaw))
