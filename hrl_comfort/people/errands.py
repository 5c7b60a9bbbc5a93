"""Somebody who wanders about, and then goes off to work at the tables."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.people.random_walk import random_walk
from hrl_comfort.people.rounds import at_station, rounds, way_round
from hrl_comfort.people.walk import Array, Walk


def errands(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Wander as `random_walk` does for `stay_s` on average, and from then on go from table to table.

    So a training has both those who hardly move and those who cross the cell. (They set off in what would
    have been a step forward.)
    """
    wanders = (way_round(walk) == 0) & ~at_station(config, walk)
    wanders &= noise[:, 2] * config.stay_s >= CONTROL_STEP_S
    wandered, facing = random_walk(config, walk, noise, tcp)
    gone, yaw = rounds(config, walk, noise, tcp)
    return np.where(wanders[:, None], wandered, gone), np.where(wanders, facing, yaw)
