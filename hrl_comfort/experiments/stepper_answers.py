"""What the process of a `StepperApart` answers."""

from __future__ import annotations

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
        torch.set_num_threads(1)
        torchrl.logger.setLevel("WARNING")
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
