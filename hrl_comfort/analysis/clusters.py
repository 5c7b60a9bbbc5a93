"""Intervals of means over episodes that are not independent: they share training seeds and spawn points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.analysis.intervals import RESAMPLES, SEED, Floats


@dataclass(frozen=True)
class Clusters:
    """Bootstrap of means over entries that share training seeds and spawn points.

    `nested`: training seeds are drawn with replacement and, within each drawn one, its spawn points. It takes
    what happens at a spawn point for independent from one seed to the next.
    `two_way`: seeds and, on their own, spawn points; an entry counts as often as its seed was drawn times as
    often as its spawn was (Owen, The pigeonhole bootstrap, 2007). It lets a spawn point do the same to all
    seeds, which more seeds then do not average out.
    With one seed both are the bootstrap over spawn points, and speak of that policy only.
    """

    cell: NDArray[np.int64]
    """(n,) which (seed, spawn) each entry belongs to."""
    weights: Floats
    """(resamples, cells) how often each cell was drawn; cells without an entry may be among them."""

    @classmethod
    def nested(cls, seed: NDArray[Any], spawn: NDArray[Any], resamples: int = RESAMPLES) -> Clusters:
        """Return the clusters of entries by their seed (n,) and, within it, spawn (n,)."""
        rng = np.random.default_rng(SEED)
        names, place = np.unique(seed, return_inverse=True)
        drawn = _drawn(rng, len(names), np.full(resamples, len(names)))
        cell, weights, first = np.empty(len(seed), dtype=np.int64), [], 0
        for i in range(len(names)):
            spawns, own = np.unique(spawn[place == i], return_inverse=True)
            cell[place == i] = first + own
            # A seed that is drawn twice has its spawn points drawn anew for each.
            weights.append(_drawn(rng, len(spawns), len(spawns) * drawn[:, i]))
            first += len(spawns)
        return cls(cell, np.concatenate(weights, axis=1).astype(np.float64))

    @classmethod
    def two_way(cls, seed: NDArray[Any], spawn: NDArray[Any], resamples: int = RESAMPLES) -> Clusters:
        """Return the clusters of entries by their seed (n,) and spawn (n,), each drawn on its own."""
        rng = np.random.default_rng(SEED)
        (seeds, place), (spawns, where) = (np.unique(each, return_inverse=True) for each in (seed, spawn))
        drawn = [_drawn(rng, len(each), np.full(resamples, len(each))) for each in (seeds, spawns)]
        weights = (drawn[0][:, :, None] * drawn[1][:, None, :]).reshape(resamples, -1)
        return cls(place * len(spawns) + where, weights.astype(np.float64))

    def means(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the means (K,) of values (n, K) and of each resample (resamples, K); NaN is left out."""
        there = np.isfinite(values)
        sums, counts = np.zeros((2, self.weights.shape[1], values.shape[1]))
        np.add.at(sums, self.cell, np.where(there, values, 0.0))
        np.add.at(counts, self.cell, there.astype(np.float64))
        with np.errstate(invalid="ignore", divide="ignore"):
            return sums.sum(axis=0) / counts.sum(axis=0), (self.weights @ sums) / (self.weights @ counts)

    def interval(self, draws: Floats) -> list[float] | None:
        """Return the percentile 95 % interval of draws (resamples,); None from one cluster or no value."""
        kept = draws[np.isfinite(draws)]
        if self.weights.shape[1] < 2 or len(kept) == 0:
            return None
        low, high = np.percentile(kept, (2.5, 97.5))
        return [float(low), float(high)]


def _drawn(rng: np.random.Generator, kinds: int, draws: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how often each of `kinds` comes up in so many draws (resamples,), (resamples, kinds)."""
    return rng.multinomial(draws, np.full(kinds, 1 / kinds))
