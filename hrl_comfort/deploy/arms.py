"""Arms that follow set-points, one every PERIOD_S."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PERIOD_S = 0.002
"""Time between set-points: 500 Hz, as the controllers of UR's e-series have it."""


@dataclass(frozen=True)
class Reading:
    """State of an arm of J joints."""

    angles: Array
    """(J,) rad."""
    velocity: Array
    """(J,) rad/s."""
    trouble: str = ""
    """Why the arm follows no set-points; empty where it does."""


class Arm(Protocol):
    """An arm that follows set-points."""

    def read(self) -> Reading:
        """Return the newest state; raise ConnectionError where the connection is lost."""

    def send(self, angles: Array) -> None:
        """Give the set-point (J,) rad; raise ConnectionError where the connection is lost."""

    def close(self) -> None:
        """End the connection; the arm stays where it is."""


class SimulatedArm:
    """The arm of a scene, one physics step a set-point.

    Args:
      model: of the cell.
      start: (J,) rad, where it stands at first.
    """

    def __init__(self, model: mujoco.MjModel, start: Array) -> None:
        self._model = model
        self._model.opt.timestep = PERIOD_S
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = self._data.ctrl[:] = start
        mujoco.mj_forward(model, self._data)

    def read(self) -> Reading:
        """See `Arm`."""
        return Reading(self._data.qpos.copy(), self._data.qvel.copy())

    def send(self, angles: Array) -> None:
        """See `Arm`."""
        self._data.ctrl[:] = angles
        mujoco.mj_step(self._model, self._data)

    def close(self) -> None:
        """See `Arm`."""
