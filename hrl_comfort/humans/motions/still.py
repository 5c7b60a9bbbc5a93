"""Motion `still`: a standing human."""

from __future__ import annotations

from hrl_comfort.config import HumanConfig
from hrl_comfort.humans.walk import Array, Surroundings, Walk, facing_base


def still(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Stay at the spawn point and face the robot."""
    return walk.position, facing_base(walk.position)
