"""Sensor readings of the compiled model as fields of State."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.arm_distance import ArmDistance
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
COLLISIONS = {"human_collision": "human", "table_collision": "table", "self_collision": "self"}
"""Field of State -> sensors whose contact it reports."""


class Sensors:
    """Fields of State that change within an episode; `arm_distance` is NaN unless `measure_arm`."""

    def __init__(self, scene: Scene, measure_arm: bool) -> None:
        self._at = scene.sensors
        self._arm = ArmDistance(scene) if measure_arm else None

    def read(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields (n, ...) of readings (n, nsensor); `planned` are those known beforehand, and `limbs`."""
        arrays = {name: value for name, value in planned.items() if name != "limbs"}
        for name in ("joint_pos", "joint_vel", "tcp_pos"):
            arrays[name] = sensed[:, self._at[name]]
        if self._arm is None:
            arrays["arm_distance"] = np.full(len(sensed), np.nan)
        else:
            arrays["arm_distance"] = self._arm(arrays["joint_pos"], planned["limbs"])
        tensors = {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in arrays.items()}
        for name, key in COLLISIONS.items():
            tensors[name] = torch.from_numpy(sensed[:, self._at[key]].any(axis=1))
        return tensors

    def read_rows(
        self, sensed: Array, planned: dict[str, NDArray[Any]], rows: NDArray[np.int64], state: State
    ) -> dict[str, Tensor]:
        """Return the fields (N * K, ...) of readings (r * K, nsensor) of `rows` (r,); those of `state` elsewhere."""
        count = len(sensed) // len(rows)
        at = (rows[:, None] * count + np.arange(count)).reshape(-1)
        fields = self.read(sensed, {name: value[at] for name, value in planned.items()})
        for name, value in fields.items():
            still = getattr(state, name).repeat_interleave(count, dim=0)
            fields[name] = still.index_copy(0, torch.from_numpy(at), value)
        return fields
