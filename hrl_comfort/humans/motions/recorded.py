"""Motion `recorded`: people of CSV and BVH files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError, HumanConfig
from hrl_comfort.humans.recordings import Recording, read_recordings
from hrl_comfort.humans.walk import Array, Stride, Surroundings, Walk, facing_base

AHEAD = 500
"""Control steps (10 s) that are left after the latest time at which an episode begins in a BVH recording."""


def recorded(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Follow the recording of `file`, held at its end; spawn, bound and keep-out do not apply to a CSV.

    A BVH recording is placed with its median place at the spawn point, facing the robot on average; its first instant
    and, in a folder, the recording are the episode's `traits`.
    """
    return pose_at(config, walk.spawn, walk.traits, walk.step + 1)


def pose_at(config: HumanConfig, spawn: Array, traits: Array, step: NDArray[np.int64]) -> Stride:
    """Return the recorded pose at control steps (n,) of people at spawn (n, 2) m with `traits` (n, TRAITS)."""
    assert config.file is not None
    recordings = read_recordings(config.file)
    count = len(recordings)
    if config.partitioned and count % 5:
        raise ConfigError(f"human.file={config.file!r} holds {count} recordings; human.partitioned needs 5, 10, 15, …")
    chosen = np.minimum((traits[:, 1] * count).astype(np.int64), count - 1)
    position, yaw, limbs = np.empty((len(step), 2)), np.empty(len(step)), np.empty((len(step), 6, 3))
    for index in np.unique(chosen):
        rows = np.flatnonzero(chosen == index)
        place = _sample(recordings[index], spawn[rows], traits[rows, 2], step[rows])
        position[rows], yaw[rows], limbs[rows] = place
    return Stride(position, yaw, limbs)


def _sample(recording: Recording, spawn: Array, begin: Array, step: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    last = len(recording.yaw) - 1
    if not recording.placed:
        step = step + (begin * max(last - AHEAD, 0)).astype(np.int64)
    at = np.minimum(step, last)
    position, yaw, limbs = recording.position[at], recording.yaw[at], recording.limbs[at]
    if recording.placed:
        return position, yaw, limbs
    turn = facing_base(spawn)
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = position.T
    return spawn + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1), yaw + turn, limbs
