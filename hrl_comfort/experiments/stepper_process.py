"""The process of a `StepperApart`: (question, *about) come in, and every one is answered."""

from __future__ import annotations

import os
import pickle
import signal
import traceback
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torchrl
from numpy.typing import NDArray

from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.stepper import Shape, Stepper
from hrl_comfort.experiments.train_cell import stepper_of


class Answers:
    """To the questions of a `StepperApart`, by name; tensors are sent as numpy's arrays."""

    def __init__(self) -> None:
        self._stepper: Stepper
        self.to: dict[str, Callable[..., Any]] = {
            "make": self._make,
            "reset": self._reset,
            "step": self._step,
            "state_dict": lambda: self._stepper.state_dict(),
            "load_state_dict": lambda state: self._stepper.load_state_dict(state).numpy(),
        }

    def _make(self, config: TrainConfig) -> Shape:
        self._stepper = stepper_of(config)
        return self._stepper.shape

    def _reset(self, precision_m: float) -> NDArray[np.float32]:
        observation: NDArray[np.float32] = self._stepper.reset(precision_m).numpy()
        return observation

    def _step(self, action: NDArray[np.float32], precision_m: float) -> dict[str, NDArray[Any]]:
        self._stepper.start(torch.from_numpy(action), precision_m)
        return {name: value.numpy() for name, value in vars(self._stepper.finish()).items()}


def main() -> None:
    """Answer the process that started this one, until nothing more comes."""
    asked, told = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # whatever else is read
    os.dup2(2, 1)  # or printed
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # without a word, should whoever asked be gone
    warnings.formatwarning = lambda message, *_, **__: f"hrl-comfort: {message}\n"
    torch.set_num_threads(1)
    torchrl.logger.setLevel("WARNING")
    answers = Answers()
    while True:
        try:
            question, *about = pickle.load(asked)
        except (EOFError, pickle.UnpicklingError):  # whoever asked is gone, maybe in the middle of it
            return
        said: object
        try:
            said = answers.to[question](*about)
        except Exception as error:  # noqa: BLE001  it is raised where the answer is waited for
            said = _sent(error)
        pickle.dump(said, told, pickle.HIGHEST_PROTOCOL)
        told.flush()


def _sent(error: Exception) -> Exception:
    """Return what of an error arrives: its kind if that can be made again, and where it was raised."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  whatever hinders it
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(traceback.format_exc())  # tracebacks cannot be sent
    return error


if __name__ == "__main__":
    main()
