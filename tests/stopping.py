"""Trainings that end in the middle, as if killed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.point_env import Stopped


@contextmanager
def stopping(training: type, method: str, when: Callable[[Any], bool]) -> Iterator[None]:
    """Expect a training to end at a call of its `method` for which `when` returns true."""
    call = getattr(training, method)

    def stop(self: Any, *given: Any) -> Any:
        if when(self):
            raise Stopped
        return call(self, *given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, method, stop)
        with pytest.raises(Stopped):
            yield
