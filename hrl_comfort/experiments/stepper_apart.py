"""What a training steps, in a process of its own (`stepper_main`): the learner learns meanwhile."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.stepper import Shape, Step
from hrl_comfort.experiments.stepper_process import StepperProcess


class StepperApart:
    """Steps the cells of a training as its `Stepper` does, in `process`, which ends with it.

    Whatever is asked of it raises what went wrong there, and KilledError if the process is over.

    Raises:
        ConfigError: see `train_cell.stepper_of`.
    """

    def __init__(self, config: TrainConfig, process: StepperProcess) -> None:
        self._process = process
        self.close = process.close
        """Ends the process."""
        try:
            self.shape: Shape = self._ask("make", config)
        except BaseException:
            self.close()
            raise

    def reset(self, precision_m: float) -> Tensor:
        """See `Steps`."""
        return torch.from_numpy(self._ask("reset", precision_m))

    def start(self, action: Tensor, precision_m: float) -> None:
        """See `Steps`."""
        self._process.send(("step", action.numpy(), precision_m))

    def finish(self) -> Step:
        """See `Steps`."""
        return Step(**{name: torch.from_numpy(value) for name, value in self._process.receive().items()})

    def state_dict(self) -> dict[str, Any]:
        """See `Steps`."""
        state: dict[str, Any] = self._ask("state_dict")
        return state

    def load_state_dict(self, state: dict[str, Any]) -> Tensor:
        """See `Steps`."""
        return torch.from_numpy(self._ask("load_state_dict", state))

    def _ask(self, question: str, *about: object) -> Any:
        self._process.send((question, *about))
        return self._process.receive()
