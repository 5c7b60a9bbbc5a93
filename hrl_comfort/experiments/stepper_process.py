"""The process of a `StepperApart`, as whoever asks it sees it.

Light to import, so that the process can begin before what a training needs is imported here.
"""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import weakref
from typing import Any

from hrl_comfort.experiments.own_process import PYTHON, KilledError, ended_by, same_paths

COMMAND = (*PYTHON, "hrl_comfort.experiments.stepper_main")
GRACE_S = 5.0
"""For a process that has closed its ends to be over."""


class StepperProcess:
    """A process that imports what cells need and then answers, for as long as this lasts.

    Questions and answers are pickled. Both `send` and `receive` raise KilledError if the process is over.
    """

    def __init__(self) -> None:
        # It is deaf from its first moment: a training that is told to stop still has to save its state.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self.process = subprocess.Popen(
                COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=same_paths()
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.close = weakref.finalize(self, _end, self.process)
        """Ends the process; a second time, nothing."""

    def send(self, question: object) -> None:
        """Ask."""
        assert self.process.stdin is not None
        try:
            pickle.dump(question, self.process.stdin, pickle.HIGHEST_PROTOCOL)
            self.process.stdin.flush()
        except BrokenPipeError as error:
            raise self._ended() from error

    def receive(self) -> Any:
        """Return the answer to the oldest question that has none yet, or raise what went wrong there."""
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
