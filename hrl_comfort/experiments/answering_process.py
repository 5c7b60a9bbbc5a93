"""A process of one's own that answers. Light to import, so that it can begin before all else is imported."""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import weakref
from typing import Any

from hrl_comfort.experiments.own_process import PYTHON, KilledError, ended_by, same_paths

CELLS = "hrl_comfort.experiments.stepper_process"
"""What a training steps, if not itself (`stepper_apart`)."""
GRACE_S = 5.0
"""For a process that has closed its ends to be over."""


class AnsweringProcess:
    """Runs a module that answers every question, both pickled, for as long as this lasts.

    `send` and `receive` raise KilledError if the process is over, and `receive` whatever went wrong there.
    """

    def __init__(self, module: str) -> None:
        # It is deaf from its first moment: a training that is told to stop still has to save its state.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self.process = subprocess.Popen(
                [*PYTHON, module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=same_paths()
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.close = weakref.finalize(self, _end, self.process)
        """Ends the process."""

    def send(self, question: object) -> None:
        """Ask."""
        assert self.process.stdin is not None
        try:
            pickle.dump(question, self.process.stdin, pickle.HIGHEST_PROTOCOL)
            self.process.stdin.flush()
        except BrokenPipeError as error:
            raise self._ended() from error

    def receive(self) -> Any:
        """Wait for the answer to the oldest question that has none; return it."""
        assert self.process.stdout is not None
        try:
            answer = pickle.load(self.process.stdout)  # of a process of our own
        except (EOFError, pickle.UnpicklingError) as error:
            raise self._ended() from error
        try:
            if isinstance(answer, Exception):
                raise answer
            return answer
        finally:
            del answer  # an error would keep this, and the process, alive

    def _ended(self) -> KilledError:
        try:
            code = self.process.wait(GRACE_S)
        except subprocess.TimeoutExpired:  # what it said cannot be read, and it goes on
            self.process.kill()
            code = self.process.wait()
        return KilledError(f"the process of the cells {ended_by(code)}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process; it has nothing to save."""
    assert process.stdin is not None and process.stdout is not None
    process.kill()
    process.wait()
    with contextlib.suppress(BrokenPipeError):
        process.stdin.close()
    process.stdout.close()
