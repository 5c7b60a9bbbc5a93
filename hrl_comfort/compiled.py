"""Compiled twins of numpy functions.

The numpy function is the definition: it also obeys numpy's protocols, by which the page is recorded. Its kernel does
the same operations in the same order, so that both agree in every bit. Sines, exponentials and products of matrices
stay in numpy: its vector instructions round them in another way than the compiler's library.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Kernel = Callable[..., Any]
FLOAT = np.dtype(np.float64)


def kernel(function: Kernel) -> Kernel:
    """Return `function` compiled when it is first called.

    The machine code is kept beside the module or in the user's cache folder. Where neither can be written, every
    process compiles anew.
    """
    try:
        compiled: Kernel = njit(function, cache=True, error_model="numpy")
    except RuntimeError:  # no folder for the cache
        compiled = njit(function, error_model="numpy")
    return compiled


def plain(*arrays: Any) -> bool:
    """Return whether all `arrays` are numpy's own, of float64, which kernels take."""
    return all([type(array) is np.ndarray and array.dtype == FLOAT for array in arrays])  # noqa: C419, faster


def contiguous(*arrays: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return `arrays` in C order, for which alone kernels are compiled; without a copy where they are."""
    return [array if array.flags.c_contiguous else np.ascontiguousarray(array) for array in arrays]
