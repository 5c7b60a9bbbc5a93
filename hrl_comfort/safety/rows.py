"""Computing in some of N rows alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64] | slice
InRows = Callable[[NDArray[np.bool_], Callable[[Rows], Array], Array], Array]
"""(needed (N,), compute, otherwise (N, ...)) -> `compute(rows)` where `needed` holds, `otherwise` elsewhere."""


def in_rows(needed: NDArray[np.bool_], compute: Callable[[Rows], Array], otherwise: Array) -> Array:
    """Return what `InRows` says; nothing is computed in the other rows."""
    rows = np.flatnonzero(needed)
    if len(rows):
        otherwise = otherwise.copy()
        otherwise[rows] = compute(rows)
    return otherwise
