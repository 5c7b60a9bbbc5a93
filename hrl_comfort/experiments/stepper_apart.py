"""What a training steps, in a process of its own (`stepper_process`): the learner learns meanwhile."""

from __future__ import annotations

import contextlib
import pickle
import signal
import subprocess
import weakref
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.own_process import PYTHON, KilledError, ended_by, same_paths
from hrl_comfort.experiments.stepper import Shape, Step

COMMAND = (*PYTHON, "hrl_comfort.experiments.stepper_process")
GRACE_S = 5.0
"""For a process that has closed its ends to be over."""


class StepperApart:
    """Steps the cells of a training as its `Stepper` does, in a process that lasts as long as this.

    Whatever is asked of it raises what went wrong there, and KilledError if the process is over.

    Raises:
        ConfigError: see `train_cell.stepper_of`.
    """

    def __init__(self, config: TrainConfig) -> None:
        # It is deaf from its first moment: a training that is told to stop still has to save its state.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self._process = subprocess.Popen(
                COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=same_paths()
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.close = weakref.finalize(self, _end, self._process)
        """Ends the process."""
        try:
            self._send(("make", config))
            self.shape: Shape = self._receive()
        except BaseException:
            self.close()
            raise

    def reset(self, precision_m: float) -> Tensor:
        """See `Steps`."""
        self._send(("reset", precision_m))
        return self._observation()

    def start(self, action: Tensor, precision_m: float) -> None:
        """See `Steps`."""
        self._send(("step", action.numpy(), precision_m))

    def finish(self) -> Step:
        """See `Steps`."""
        return Step(**{name: torch.from_numpy(value) for name, value in self._receive().items()})

    def state_dict(self) -> dict[str, Any]:
        """See `Steps`."""
        self._send(("state_dict",))
        state: dict[str, Any] = self._receive()
        return state

    def load_state_dict(self, state: dict[str, Any]) -> Tensor:
        """See `Steps`."""
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
            raise self._ended() from error

    def _receive(self) -> Any:
        assert self._process.stdout is not None
        try:
            answer = pickle.load(self._process.stdout)  # of a process of our own
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
            code = self._process.wait(GRACE_S)
        except subprocess.TimeoutExpired:  # what it said cannot be read, and it goes on
            self._process.kill()
            code = self._process.wait()
        return KilledError(f"the process of the cells {ended_by(code)}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process; it has nothing to save."""
    assert process.stdin is not None and process.stdout is not None
    process.kill()
    process.wait()
    with contextlib.suppress(BrokenPipeError):
        process.stdin.close()
    process.stdout.close()
