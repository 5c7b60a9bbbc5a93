"""Surroundings of people in tests: by default stations of the paper's cell, and an arm that is its tool, at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.humans.retreat import RETREAT_STEPS

STATIONS = [[-1.01, -0.12], [1.05, -0.09], [0.23, 0.84]]
"""m, of the paper's cell."""


def around(
    tcp: np.ndarray, keep_out: humans.KeepOut, arm: humans.ArmSource | None = None, stations: object = None
) -> humans.Surroundings:
    """Return the surroundings of n people: tool (n, 2) m, arm and stations (S, 2) m."""
    point = np.concatenate([tcp, np.zeros((len(tcp), 1))], axis=1)[:, None]
    given = np.array(STATIONS if stations is None else stations)
    still = lambda: (point, np.zeros_like(point))  # noqa: E731
    stations, nothing = np.broadcast_to(given, (len(tcp), *given.shape)), np.full(len(tcp), -1)
    return humans.Surroundings(tcp, keep_out, arm or still, stations, nothing)


def begin_retreat(walk: humans.Walk, touching: NDArray[np.int64]) -> humans.Walk:
    """Return `walk` with the retreats of the rows `touching` at their beginning."""
    left = walk.retreat.copy()
    left[touching] = RETREAT_STEPS
    return replace(walk, retreat=left)
