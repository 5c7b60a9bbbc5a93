"""What a training steps, in a process of its own (`stepper_process`): the learner learns meanwhile."""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import sys
import weakref
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.stepper import Shape, Step

COMMAND = (sys.executable, "-m", "hrl_comfort.experiments.stepper_process")


class StepperApart:
    """Steps the cells of a training as its `Stepper` does, in a process that lasts as long as this.

    Whatever is asked of it raises what went wrong there, and RuntimeError if the process was killed.

    Raises:
        ConfigError: see `train_cell.stepper_of`.
    """

    def __init__(self, config: TrainConfig) -> None:
        # It is deaf from its first moment: a training that is told to stop still has to save its state.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self._process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.close = weakref.finalize(self, _end, self._process)
        """Ends the process."""
        self._send(("make", config))
        self.shape: Shape = self._receive()

    def reset(self, precision_m: float) -> Tensor:
        """Begin episodes at this precision in every row; return the observation (N, D)."""
        self._send(("reset", precision_m))
        return self._observation()

    def start(self, action: Tensor, precision_m: float) -> None:
        """Let a decision (N, A) in [-1, 1] begin; episodes that begin after it are at this precision."""
        self._send(("step", action.numpy(), precision_m))

    def finish(self) -> Step:
        """Wait for the decision begun; return what it led to."""
        return Step(**{name: torch.from_numpy(value) for name, value in self._receive().items()})

    def state_dict(self) -> dict[str, Any]:
        """Return everything a bit-for-bit continuation needs, between two decisions."""
        self._send(("state_dict",))
        state: dict[str, Any] = self._receive()
        return state

    def load_state_dict(self, state: dict[str, Any]) -> Tensor:
        """Continue from `state_dict`; return the observation (N, D)."""
        self._send(("load_state_dict", state))
        return self._observation()

    def _observation(self) -> Tensor:
        return torch.from_numpy(self._receive())

    def _send(self, what: object) -> None:
        assert self._process.stdin is not None
        try:
            pickle.dump(what, self._process.stdin, pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise self._killed() from error

    def _receive(self) -> Any:
        assert self._process.stdout is not None
        try:
            answer = pickle.load(self._process.stdout)  # of a process of our own
        except (EOFError, pickle.UnpicklingError) as error:
            raise self._killed() from error
        try:
            if isinstance(answer, Exception):
                raise answer
            return answer
        finally:
            del answer  # an error would keep this, and the process, alive

    def _killed(self) -> RuntimeError:
        self._process.kill()  # should it still be there
        return RuntimeError(f"the process of the cells has ended, with exit code {self._process.wait()}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process; it has nothing to save."""
    assert process.stdin is not None and process.stdout is not None
    process.kill()
    process.wait()
    with contextlib.suppress(BrokenPipeError):
        process.stdin.close()
    process.stdout.close()
