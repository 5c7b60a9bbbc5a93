"""Signals of the compiled model: control vectors, and sensor readings as fields of State."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.workcell import Scene, ball_props
from hrl_comfort.sim.arm_distance import ArmDistance
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
COLLISIONS = {"human_collision": "human", "table_collision": "table", "self_collision": "self"}
"""Field of State -> sensors whose contact it reports."""
MEASURED = ("joint_pos", "joint_vel", "tcp_pos")


def limbs_of(scene: Scene, walk: humans.Walk) -> Array:
    """Return the limb poses (n, 5, 7) of n people."""
    phase, swing = humans.gait(walk)
    x, y = walk.position.T
    return limb_poses(x, y, walk.yaw, phase, swing, scene.floor_z)


def pack_controls(
    scene: Scene, targets: Array, limbs: Array, balls: Array, colours: NDArray[np.int64], points: Array
) -> Array:
    """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

    targets (n, K * s, J) rad, s to a control step; limbs (n * K, 5, 7) stay put over a control step; balls
    (n, B, 3) m, of colours (n, B), and points (n, P, 3) m over all of them. Balls are absent if there are points.
    """
    n, steps, joints = len(targets), len(limbs) // len(targets), targets.shape[-1]
    places = joints + 3 * len(scene.mocap)
    control = np.empty((n, steps, targets.shape[1] // steps, scene.ncontrol))
    control[..., :joints] = targets.reshape(*control.shape[:3], joints)
    position = control[..., joints:places].reshape(*control.shape[:3], -1, 3)
    quaternion = control[..., places:].reshape(*control.shape[:3], -1, 4)
    limbs = limbs.reshape(n, steps, 1, len(LIMBS), 7)
    position[..., : len(LIMBS), :], quaternion[..., : len(LIMBS), :] = limbs[..., :3], limbs[..., 3:]
    props = position[..., len(LIMBS) :, :]
    props[...], quaternion[..., len(LIMBS) :, :] = (FAR_AWAY_M, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    if count := points.shape[1]:
        props[..., 2 : 2 + count, :] = points[:, None, None]
    else:
        for index in range(balls.shape[1]):
            prop = ball_props(index)[colours[:, index]]
            props[np.arange(n), :, :, prop] = balls[:, index, None, None]
    return control.reshape(n, -1, scene.ncontrol)


class Sensors:
    """Fields of State that change within an episode; `arm_distance` is NaN unless `measure_arm`."""

    def __init__(self, scene: Scene, measure_arm: bool) -> None:
        self._at = scene.sensors
        self._arm = ArmDistance(scene) if measure_arm else None

    def read(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields (n, ...) of readings (n, nsensor); `planned` are those known beforehand, and `limbs`."""
        fields = {name: value for name, value in planned.items() if name != "limbs"}
        fields |= {name: sensed[:, self._at[name]] for name in MEASURED}
        fields |= {name: np.asarray(sensed[:, self._at[key]].any(axis=1)) for name, key in COLLISIONS.items()}
        fields["arm_distance"] = np.full(len(sensed), np.nan)
        if self._arm is not None:
            fields["arm_distance"] = self._arm(fields["joint_pos"], planned["limbs"])
        return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in fields.items()}

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
