"""Mixes of policies: some shifts are worked by one and some by another, and means lie on the line between theirs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations

WORK = {"kitting": "orders filled a minute", "shift": "objects a minute"}
"""The throughput of a shift, in words, by its task."""
IDLE = (0.0, 0.0)
"""Throughput and avoidable discomfort of an arm that rests at home."""
Points = Sequence[tuple[float, float]]
"""Throughput and another quantity of each policy."""


def best_mix(points: Points, x: float, best: Callable[[Iterable[float]], float] = max) -> float | None:
    """Return the best y at `x` of the lines between any two points (x, y); None if none reaches so far.

    As a function of x the largest is the upper, with `best=min` the lower convex hull of the points.
    """
    found = [y for at, y in points if at == x]
    for (low, y_low), (high, y_high) in combinations(sorted(points), 2):
        if low <= x <= high and low < high:
            found.append(y_low + (y_high - y_low) * (x - low) / (high - low))
    return best(found) if found else None
