"""An arm in simulation that fails at a given set-point."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError
from hrl_comfort.deploy.arms import Reading, SimulatedArm

FAULTS = ("protective stop", "emergency stop", "connection", "slow", "held")


def refused() -> SimulatedArm:
    raise ConfigError("no such arm")


class Interrupted:
    """Opens an arm; the process that it is sent to gets SIGINT as it starts."""

    def __init__(self, open_arm: Callable[[], SimulatedArm]) -> None:
        self.open_arm = open_arm

    def __setstate__(self, state: dict[str, Any]) -> None:
        signal.raise_signal(signal.SIGINT)
        vars(self).update(state)

    def __call__(self) -> SimulatedArm:
        return self.open_arm()


class FaultyArm(SimulatedArm):
    """See `SimulatedArm`; from the set-point `at` on it has a fault of FAULTS."""

    def __init__(self, model: mujoco.MjModel, start: NDArray[np.float64], fault: str, at: int) -> None:
        super().__init__(model, start)
        self._fault, self._left = fault, at

    def read(self) -> Reading:
        reading = super().read()
        stopped = self._left <= 0 and self._fault.endswith("stop")
        return replace(reading, trouble=self._fault if stopped else "")

    def send(self, angles: NDArray[np.float64]) -> None:
        moving = bool(np.abs(angles - self._data.ctrl).max() > 1e-5)
        self._left -= moving
        if self._left <= 0 and self._fault == "connection":
            raise ConnectionError("no answer")
        if -25 < self._left <= 0 and self._fault == "slow":
            time.sleep(0.012)
        super().send(self._data.ctrl if self._left <= 0 and self._fault == "held" else angles)
