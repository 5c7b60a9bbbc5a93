"""The process of a `StepperApart`: (question, *about) come in, and every one is answered."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import traceback
from typing import Any

import torch
import torchrl

from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.stepper import Shape, Stepper
from hrl_comfort.experiments.train_cell import stepper_of


class Answers:
    """To the questions of a `StepperApart`, each named as what is asked; what is sent is numpy's."""

    def __init__(self) -> None:
        self._stepper: Stepper | None = None

    @property
    def stepper(self) -> Stepper:
        """What `make` has made."""
        assert self._stepper is not None
        return self._stepper

    def make(self, config: TrainConfig) -> Shape:
        """Make the cells of a training."""
        self._stepper = stepper_of(config)
        return self.stepper.shape

    def reset(self, precision_m: float) -> Any:
        """Return the observation (N, D)."""
        return self.stepper.reset(precision_m).numpy()

    def step(self, action: Any, precision_m: float) -> dict[str, Any]:
        """Return the fields of a `Step`."""
        self.stepper.start(torch.from_numpy(action), precision_m)
        return {name: value.numpy() for name, value in vars(self.stepper.finish()).items()}

    def state_dict(self) -> dict[str, Any]:
        """Return what the stepper's does."""
        return self.stepper.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> Any:
        """Return the observation (N, D)."""
        return self.stepper.load_state_dict(state).numpy()


def main() -> None:
    """Answer the process that started this one, until nothing more comes."""
    asked, told = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else is printed
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # without a word, should whoever asked be gone
    torch.set_num_threads(1)
    torchrl.logger.setLevel("WARNING")
    answers = Answers()
    while True:
        try:
            question, *about = pickle.load(asked)
        except EOFError:
            return
        said: object
        try:
            said = getattr(answers, question)(*about)
        except Exception as error:  # noqa: BLE001  it is raised where the answer is waited for
            error.add_note(traceback.format_exc())  # tracebacks cannot be sent
            said = error
        pickle.dump(said, told, pickle.HIGHEST_PROTOCOL)
        told.flush()


if __name__ == "__main__":
    main()
