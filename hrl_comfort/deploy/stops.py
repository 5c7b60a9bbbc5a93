"""Stops of a deployment: why the arm was brought to rest, and the exit code that says so."""

from __future__ import annotations

STOPPED, INTERRUPTED = 3, 130
"""Exit codes: the arm was stopped by a condition of docs/robot.md, or by Ctrl-C."""


class StoppedError(Exception):
    """The arm was brought to rest before the plan was done; the message says why."""

    def __init__(self, why: str, code: int = STOPPED) -> None:
        super().__init__(why)
        self.code = code


class GripLostError(StoppedError):
    """The fingers no longer hold what they held; the episode counts a drop."""
