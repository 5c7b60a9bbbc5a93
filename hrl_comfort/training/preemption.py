"""SIGTERM, by which a cluster takes its machine back, as a wish to stop between two decisions."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Preempted(BaseException):
    """A training has stopped because it was told to; its checkpoint says where it goes on.

    No `Exception`: a sweep that notes the failures of its jobs stops too.
    """


@contextmanager
def asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Yield what tells whether SIGTERM has come since; outside the main thread, it never has."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return
    before = signal.signal(signal.SIGTERM, lambda *_: asked.set())
    try:
        yield asked.is_set
    finally:
        signal.signal(signal.SIGTERM, before)
