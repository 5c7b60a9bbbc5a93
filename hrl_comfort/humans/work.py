"""Motion `work`: a human who works at one table."""

from __future__ import annotations

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans.walk import Array, Walk, facing_base


def work(config: HumanConfig, walk: Walk, noise: Array, tcp: Array) -> tuple[Array, Array]:
    """Walk at `speed_m_s` to the station nearest to the spawn point; add jitter of up to `jitter_m` along x and y."""
    stations = np.array(config.stations_m, dtype=np.float64)
    nearest = np.linalg.norm(walk.spawn[:, None] - stations, axis=-1).argmin(axis=1)
    offset = stations[nearest] - walk.position
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    stride = np.minimum(config.speed_m_s * CONTROL_STEP_S, distance)
    jitter = (2 * noise[:, :2] - 1) * config.jitter_m
    position = walk.position + offset / np.maximum(distance, 1e-9) * stride + jitter
    return position, facing_base(position)
