"""Computing in some of N rows alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64] | slice


def in_rows(needed: NDArray[np.bool_], compute: Callable[[Rows], Array], otherwise: Array) -> Array:
    """Return `compute(rows)` in the rows where `needed` (N,) holds, `otherwise` (N, ...) elsewhere.

    While numpy's functions are traced, as by `hrl_comfort.studio.web.arrays`, no row can be left out.
    """
    if not isinstance(needed, np.ndarray):
        return np.where(needed.reshape(-1, *[1] * (otherwise.ndim - 1)), compute(slice(None)), otherwise)
    rows = np.flatnonzero(needed)
    if len(rows):
        otherwise = otherwise.copy()
        otherwise[rows] = compute(rows)
    return otherwise
