"""Values at the last valid instant of a decision, of each of N rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


def ended_early(last: Rows, count: int) -> list[tuple[int, Rows]]:
    """Return the instants at which rows ended that are not the last of `count`, and these rows; few, as a rule.

    `last` (N,) are the instants at which they ended.
    """
    rows = np.flatnonzero(last < count - 1)
    return [(int(k), rows[last[rows] == k]) for k in np.unique(last[rows])]


def chosen(each: Sequence[NDArray[Any]], early: Sequence[tuple[int, Rows]], rows_last: bool = False) -> NDArray[Any]:
    """Return a value (N, ...), or (..., N) if `rows_last`: that of `each` instant at which the rows ended.

    `early` are those of `ended_early`.
    """
    values = each[-1].copy()
    for k, rows in early:
        at = (..., rows) if rows_last else rows
        values[at] = each[k][at]
    return values
