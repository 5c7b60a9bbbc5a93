"""Compiled twins of numpy functions.

The numpy function is the definition: where it also obeys numpy's protocols, by which the page is recorded, it is kept
in the package; elsewhere it is in the tests. Its kernel does the same operations in the same order, so that both agree
in every bit, but for sines, exponentials and sums of products, which numpy's vector instructions round in another way
than the compiler's library.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

Kernel = Callable[..., Any]
FLOAT = np.dtype(np.float64)


def kernel(function: Kernel) -> Kernel:
    """Return `function` compiled when it is first called.

    The machine code is kept beside the module or in the user's cache folder until the module, a constant that it uses
    or the module of a kernel that it calls changes. Where neither folder can be written, every process compiles anew.
    """
    try:
        compiled: Kernel = njit(function, cache=True, error_model="numpy")
    except RuntimeError:  # no folder for the cache
        return njit(function, error_model="numpy")  # type: ignore[no-any-return]
    used = [function.__globals__.get(name) for name in function.__code__.co_names]
    kept = [getattr(each._cache, "_cache_file", None) for each in (compiled, *used) if isinstance(each, Dispatcher)]
    if kept and kept[0] is not None:  # numba's own stamp is of the module alone
        constants = [repr(each) for each in used if isinstance(each, int | float | tuple | np.ndarray)]
        stamps = [each._source_stamp for each in kept if each is not None]
        kept[0]._source_stamp = (*stamps, *constants)
    return compiled


def plain(*arrays: Any) -> bool:
    """Return whether all `arrays` are numpy's own, of float64, which kernels take."""
    return all([type(array) is np.ndarray and array.dtype == FLOAT for array in arrays])  # noqa: C419, faster


def contiguous(*arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """Return `arrays` in C order, for which alone kernels are compiled; without a copy where they are."""
    return [array if array.flags.c_contiguous else np.ascontiguousarray(array) for array in arrays]
