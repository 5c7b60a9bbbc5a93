"""Stopping between two decisions at SIGTERM, the signal by which a cluster preempts a job, and with the parent."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PR_SET_PDEATHSIG = 1
"""linux/prctl.h"""
LIBC = ctypes.CDLL(None)


class Preempted(BaseException):
    """A training stopped at SIGTERM, after writing a checkpoint.

    It is no `Exception`, so that a sweep, which records the failures of its jobs, stops too.
    """


@contextmanager
def asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether SIGTERM has come; outside the main thread it never does."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return
    before = signal.signal(signal.SIGTERM, lambda *_: asked.set())
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGTERM, before)


def end_with_parent(parent: int) -> None:
    """Let the kernel kill this process when its `parent` ends, at once if it has ended (Linux only)."""
    if sys.platform == "linux":
        LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os.kill(os.getpid(), signal.SIGKILL)
