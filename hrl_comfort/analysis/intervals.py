"""95 % intervals of means over episodes, which are not independent: they share training seeds and spawns.

One kind of interval for one kind of number. Over two or more training seeds: Student's t over the seeds'
means. Within one seed: the percentile bootstrap over spawn points (`scipy.stats.bootstrap`), which speaks of
that policy, not of the method. Where all seeds, or all spawn points, agree there is no interval: their spread
says nothing about it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import scipy  # its stats are loaded when they are needed
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.files.documents import Estimate
from hrl_comfort.files.tables import Floats, column

RESAMPLES = 2000
AT_ONCE = 4096
"""Largest number of columns times clusters that are resampled together, which bounds the memory."""
Bounds = tuple[float, float]
SHARE: Bounds = (0.0, 1.0)
"""Bounds of a share."""
UNBOUNDED: Bounds = (-math.inf, math.inf)
Statistic = Callable[..., Any]
"""Means of one or more quantities, each (...), to a number (...)."""


def identity(mean: Any) -> Any:
    """Return the mean."""
    return mean


@dataclass(frozen=True)
class Clusters:
    """The training seed and the spawn point that each of n episodes belongs to, numbered from 0, (n,)."""

    seed: NDArray[np.intp]
    spawn: NDArray[np.intp]

    @classmethod
    def of(cls, episodes: DataFrame) -> Clusters:
        """Return the clusters of episodes (n); one without a spawn point is a cluster of its own."""
        seeds, spawns = (column(episodes, name) for name in ("train_seed", "spawn_id"))
        alone = np.flatnonzero(np.isnan(spawns))
        spawns[alone] = -1.0 - alone
        return cls(*(pd.factorize(each, use_na_sentinel=False)[0] for each in (seeds, spawns)))

    @classmethod
    def of_runs(cls, count: int) -> Clusters:
        """Return the clusters of values that are of a training seed each."""
        return cls(np.arange(count), np.arange(count))

    def bands(self, *columns: Floats, statistic: Statistic = identity) -> tuple[Floats, Floats, Floats]:
        """Return a statistic's mean, low and high, each (T,), NaN where they cannot be told.

        Args:
          *columns: K quantities, each (n, T). A row counts at t where it has all of them; else it is NaN.
          statistic: the number, from the means of the K quantities, each (...).
        """
        there = np.isfinite(columns).all(axis=0)
        several = self.seed.max(initial=0) > 0
        groups = self.seed if several else self.spawn
        sums = [DataFrame(each).groupby(groups).sum().to_numpy() for each in (*np.where(there, columns, 0), there)]
        parts = [each.T for each in sums]  # (T, clusters)

        def whole(*parts: Floats, axis: int = -1) -> Any:
            # In a copy the numbers of one t lie together, so that their sum is the same with other t beside it.
            *totals, count = (np.ascontiguousarray(part).sum(axis=axis) for part in parts)
            return statistic(*(total / count for total in totals))

        with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", scipy.stats.DegenerateDataWarning)  # all spawn points agree: no interval
            if several:  # each seed's own number, NaN where it has no value
                each = DataFrame(statistic(*(total / parts[-1] for total in parts[:-1])).T)
                mean = each.mean().to_numpy()
                half = each.sem().to_numpy() * scipy.stats.t.ppf(0.975, each.count() - 1)
                return mean, mean - half, mean + half
            mean = np.asarray(whole(*parts))
            if parts[0].shape[1] < 2:
                return mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)
            options: dict[str, Any] = {"n_resamples": RESAMPLES, "batch": 200, "rng": np.random.default_rng(0)}
            options |= {"axis": -1, "paired": True, "method": "percentile"}
            found = scipy.stats.bootstrap(parts, whole, **options).confidence_interval
        return mean, found.low, found.high

    def estimate(
        self, *columns: Floats, statistic: Statistic = identity, bounds: Bounds = UNBOUNDED
    ) -> Estimate | None:
        """Return a statistic of the means of columns (n,) and its interval; None where it has no value."""
        mean, low, high = (each[0] for each in self.bands(*(c[:, None] for c in columns), statistic=statistic))
        return _estimate(mean, low, high, bounds)

    def estimates(self, values: DataFrame, bounds: Mapping[str, Bounds] | None = None) -> dict[str, Estimate]:
        """Return the mean of each column of `values` (n) that has one, with its interval within its bounds, if any."""
        limits = {**dict.fromkeys(values, UNBOUNDED), **(bounds or {})}
        names = list(values)
        found: dict[str, Estimate | None] = {}
        at_once = max(1, AT_ONCE // (1 + int(self.spawn.max(initial=0))))
        for some in (names[start : start + at_once] for start in range(0, len(names), at_once)):
            bands = zip(*self.bands(np.stack([column(values, name) for name in some], axis=1)), strict=True)
            found |= {name: _estimate(*band, limits[name]) for name, band in zip(some, bands, strict=True)}
        return {name: estimate for name, estimate in found.items() if estimate is not None}


def _estimate(mean: float, low: float, high: float, bounds: Bounds) -> Estimate | None:
    if not np.isfinite(mean):
        return None
    told = np.isfinite(low) and np.isfinite(high) and not math.isclose(low, high, rel_tol=1e-9, abs_tol=1e-12)
    return {"mean": float(mean), "ci95": np.clip((low, high), *bounds).tolist() if told else None}
