"""Threads that roll physics out, in every process that uses them."""

from __future__ import annotations

import ctypes
import os
from typing import Any

from mujoco import rollout


class Threads:
    """`mujoco.rollout` on `count` threads, 1 for none but the caller's.

    A forked process has none of its parent's threads and would wait for them for ever: it starts its own.
    """

    def __init__(self, count: int) -> None:
        self._count = count if count > 1 else 0
        self._start()

    def _start(self) -> None:
        self._process, self._pool = os.getpid(), rollout.Rollout(nthread=self._count)

    def rollout(self, *args: Any, **options: Any) -> Any:
        """See `mujoco.rollout.Rollout.rollout`."""
        if self._process != os.getpid():
            # Its end would wait for its threads, too.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._pool.rollout_))
            self._start()
        return self._pool.rollout(*args, **options)

    def close(self) -> None:
        """Stop the threads of this process."""
        if self._process == os.getpid():
            self._pool.close()
