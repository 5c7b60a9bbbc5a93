"""The rest of an episode drawn anew: people walk, and objects and orders arrive, by other random numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.variation.random_streams import random_stream

FUTURE_STREAM = 64
"""Stream of random numbers of futures, beside those of `sim.episode_sampler`."""


def redraw(episodes: Episodes, futures: NDArray[np.int64]) -> None:
    """Let the rest of the episodes of N cells be that of the `futures` (N,).

    Cells at one step of one episode have the same future of a number. Who people are stays.
    """
    assert episodes.state is not None
    draw, steps = episodes.draw, episodes.state.steps.tolist()
    stays = np.empty(draw.noise.shape[::2])
    for row, (now, future) in enumerate(zip(steps, futures.tolist(), strict=True)):
        rng = random_stream(int(draw.key[row]), (FUTURE_STREAM << 48) + (now << 16) + future)
        later = draw.noise[row, now:]
        later[:] = rng.random(later.shape)
        order = rng.permutation(len(draw.due[row]))
        draw.arriving[row], draw.due[row] = draw.arriving[row, order], draw.due[row, order]
        stays[row] = rng.random(len(stays[row]))
    episodes.people.stay(stays)
