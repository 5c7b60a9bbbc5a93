"""Stopping between two decisions at SIGTERM, the signal by which a cluster preempts a job."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


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
