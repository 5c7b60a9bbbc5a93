"""95 % intervals of means over episodes, which are not independent: they share training seeds and spawns.

One kind of interval for one kind of number. Over two or more training seeds: Student's t over the seeds'
means. Within one seed: the percentile bootstrap over spawn points (`scipy.stats.bootstrap`), which speaks of
that policy, not of the method. Where all seeds, or all spawn points, agree there is no interval: their spread
says nothing about it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas import DataFrame
from scipy import stats

from hrl_comfort.files.tables import Floats, column

RESAMPLES = 2000
SHARE = (0.0, 1.0)
"""Bounds of a share."""
UNBOUNDED = (-math.inf, math.inf)
Statistic = Callable[..., Any]
"""Means of one or more quantities, each (...), to a number (...)."""


class Estimate(TypedDict):
    """A mean and its 95 % interval, None where none can be told."""

    mean: float
    ci95: list[float] | None


def student(values: Floats, bounds: tuple[float, float] = UNBOUNDED) -> list[float] | None:
    """Return Student's 95 % interval of the mean of `values` (n,), one a seed; None of fewer than two."""
    low, high = _student(values[:, None])
    return _interval(low[0], high[0], bounds)


def _student(values: Floats) -> tuple[Floats, Floats]:
    """Return Student's interval (T,) of the means of values (S, T), NaN left out; NaN of fewer than two."""
    count = np.isfinite(values).sum(axis=0)
    frame = DataFrame(values)
    half = frame.sem().to_numpy() * stats.t.ppf(0.975, np.where(count > 1, count - 1, np.nan))
    mean = frame.mean().to_numpy()
    return mean - half, mean + half


def _interval(low: float, high: float, bounds: tuple[float, float]) -> list[float] | None:
    """Return the interval within its bounds; None where it is not finite or has no width."""
    if not (np.isfinite(low) and np.isfinite(high)) or math.isclose(low, high, rel_tol=1e-9, abs_tol=1e-12):
        return None
    return [float(bound) for bound in np.clip((low, high), *bounds)]


def itself(mean: Any) -> Any:
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

    def bands(self, *columns: Floats, statistic: Statistic = itself) -> tuple[Floats, Floats, Floats]:
        """Return a statistic's mean, low and high, each (T,), NaN where they cannot be told.

        Args:
          *columns: K quantities, each (n, T). A row counts at t where it has all of them; else it is NaN.
          statistic: the number, from the means of the K quantities, each (...).
        """
        values = np.stack(columns)
        there = np.isfinite(values).all(axis=0)
        several = self.seed.max(initial=0) > 0
        groups = self.seed if several else self.spawn
        size = int(groups.max(initial=0)) + 1
        sums, counts = np.zeros((len(values), size, values.shape[2])), np.zeros((size, values.shape[2]))
        for total, value in zip((*sums, counts), (*np.where(there, values, 0.0), there), strict=True):
            np.add.at(total, groups, value)
        with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # all spawn points agree: no interval
            if several:  # each seed's own number, NaN where it has no value
                each = np.asarray(statistic(*(sums / counts)))
                return (DataFrame(each).mean().to_numpy(), *_student(each))

            def whole(*parts: Floats, axis: int = 0) -> Any:
                *totals, count = (part.sum(axis=axis) for part in parts)
                return statistic(*(total / count for total in totals))

            mean = np.asarray(whole(*sums, counts))
            if size < 2:
                return mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)
            found = stats.bootstrap(
                (*sums, counts),
                whole,
                paired=True,
                n_resamples=RESAMPLES,
                batch=200,
                method="percentile",
                rng=np.random.default_rng(0),
            ).confidence_interval
        return mean, found.low, found.high

    def estimate(
        self, *columns: Floats, statistic: Statistic = itself, bounds: tuple[float, float] = UNBOUNDED
    ) -> Estimate | None:
        """Return a statistic of the means of columns (n,) and its interval; None where it has no value."""
        mean, low, high = (each[0] for each in self.bands(*(c[:, None] for c in columns), statistic=statistic))
        if not np.isfinite(mean):
            return None
        return {"mean": float(mean), "ci95": _interval(low, high, bounds)}
