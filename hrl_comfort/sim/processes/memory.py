"""Arrays of N rows in memory that processes share."""

from __future__ import annotations

from collections.abc import Mapping
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]
"""Name -> rows (n, ...)."""
Layout = dict[str, tuple[str, tuple[int, ...]]]
"""Name -> type and shape (N, ...)."""
ALIGNED = 64
"""Arrays begin at multiples of this, bytes."""


class Memory:
    """Arrays (N, ...) as the layout says; without a `name`, memory of its own, else that of another process."""

    def __init__(self, layout: Layout, name: str | None = None) -> None:
        self.layout, self._places, end = layout, dict[str, int](), 0
        for key, (kind, shape) in layout.items():
            self._places[key] = end
            end += -(-np.dtype(kind).itemsize * int(np.prod(shape)) // ALIGNED) * ALIGNED
        self._size = max(end, 1)
        self._shared = SharedMemory(name, create=name is None, size=self._size)

    @property
    def name(self) -> str:
        """Name under which other processes find the memory until `forget`."""
        return self._shared.name

    @property
    def _bytes(self) -> memoryview:
        assert self._shared.buf is not None  # it is not closed
        return self._shared.buf

    def forget(self) -> None:
        """Let the memory go with the last process that uses it."""
        self._shared.unlink()

    def write(self, begin: int, rows: Arrays) -> None:
        """Write some arrays' `rows` (n, ...) from row `begin` on."""
        for name, value in rows.items():
            self._view(name, self._bytes)[begin : begin + len(value)] = value

    def read(self) -> dict[str, NDArray[Any]]:
        """Return a copy of the arrays."""
        copied = np.frombuffer(self._bytes, np.uint8, self._size).copy().data
        return {name: self._view(name, copied) for name in self.layout}

    def _view(self, name: str, memory: memoryview) -> NDArray[Any]:
        kind, shape = self.layout[name]
        return np.ndarray(shape, kind, memory, self._places[name])
