"""Signals of the compiled model: control vectors, and sensor readings as fields of State."""

from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.safety.separation import UNSAFE_SPEED_M_S, Separation
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.workcell import Scene, ball_props
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
COLLISIONS = {"touching": "human", "table_collision": "table", "self_collision": "self"}
"""Field of State -> sensors whose contact it reports."""
MEASURED = ("joint_pos", "joint_vel", "tcp_pos")


def limbs_of(scene: Scene, walk: humans.Walk) -> Array:
    """Return the limb poses (n, 7, 7) of n people."""
    phase, swing = humans.gait(walk)
    x, y = walk.position.T
    return limb_poses(x, y, walk.yaw, phase, swing, scene.floor_z, walk.limbs)


def pack_controls(
    scene: Scene, targets: Array, limbs: Array, balls: Array, colours: NDArray[np.int64], points: Array
) -> Array:
    """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

    targets (n, K * s, J) rad, s to a control step; limbs (n * K, 7, 7) stay put over a control step; balls
    (n, B, 3) m, of colours (n, B), and points (n, P, 3) m over all of them. Balls are absent if there are points.
    """
    n, steps, joints = len(targets), len(limbs) // len(targets), targets.shape[-1]
    places = joints + 3 * len(scene.mocap)
    control = np.empty((n, steps, targets.shape[1] // steps, scene.ncontrol))
    control[..., :joints] = targets.reshape(*control.shape[:3], joints)
    # Whole runs of numbers at once: numpy is slow on many short ones.
    position, quaternion = control[..., joints:places], control[..., places:]
    props, limbs = len(scene.mocap) - len(LIMBS), limbs.reshape(n, steps, 1, len(LIMBS), 7)
    position[..., : 3 * len(LIMBS)] = limbs[..., :3].reshape(n, steps, 1, -1)
    position[..., 3 * len(LIMBS) :] = _absent(props)[0]
    quaternion[..., : 4 * len(LIMBS)] = limbs[..., 3:].reshape(n, steps, 1, -1)
    quaternion[..., 4 * len(LIMBS) :] = _absent(props)[1]
    balls_at = position[..., 3 * len(LIMBS) :].reshape(*control.shape[:3], props, 3)
    if count := points.shape[1]:
        balls_at[..., 2 : 2 + count, :] = points[:, None, None]
    else:
        for index in range(balls.shape[1]):
            prop = ball_props(index)[colours[:, index]]
            balls_at[np.arange(n), :, :, prop] = balls[:, index, None, None]
    return control.reshape(n, -1, scene.ncontrol)


@cache
def _absent(props: int) -> tuple[Array, Array]:
    """Return position (3 * props,) m and quaternion (4 * props,) of props that are not there."""
    return np.tile((FAR_AWAY_M, 0.0, 0.0), props), np.tile((1.0, 0.0, 0.0, 0.0), props)


class Sensors:
    """Fields of State that the sensors give; `arm_distance` is NaN unless `measure_arm`."""

    def __init__(self, scene: Scene, separation: Separation, measure_arm: bool) -> None:
        self._at, self._separation, self._measure_arm = scene.sensors, separation, measure_arm

    def read_first(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields (r, ...) of the first instants of episodes; see `_read`."""
        fields = self._read(sensed, planned)
        return fields | {"contact": fields["touching"], "unsafe_contact": torch.zeros(len(sensed), dtype=torch.bool)}

    def read_decision(
        self, readings: Array, planned: dict[str, NDArray[Any]], before: State, rows: NDArray[np.int64] | None
    ) -> dict[str, Tensor]:
        """Return the fields (N * K, ...) of the decision that began in the state `before` (N rows).

        `readings` (r * K, substeps, nsensor) are those of `rows` (r,), all by default; the other rows stay as they
        are. `planned` are the fields known beforehand, and `limbs`.
        """
        if rows is None:
            return self._read_all(readings, planned, before)
        n, count = len(before.steps), len(readings) // len(rows)
        at = (rows[:, None] * count + np.arange(count)).reshape(-1)
        part = {name: value[at] for name, value in planned.items()}
        fields = self._read_all(readings, part, before.rows(torch.from_numpy(rows)))
        if len(rows) < n:
            for name, value in fields.items():
                still = getattr(before, name).repeat_interleave(count, dim=0)
                fields[name] = still.index_copy(0, torch.from_numpy(at), value)
        return fields

    def _read_all(self, readings: Array, planned: dict[str, NDArray[Any]], before: State) -> dict[str, Tensor]:
        fields = self._read(readings[:, -1], planned)
        return fields | self._contacts(readings, planned["limbs"], before, fields["touching"])

    def _read(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields (n, ...) of readings (n, nsensor); `planned` are those known beforehand, and `limbs`."""
        fields = {name: value for name, value in planned.items() if name != "limbs"}
        fields |= {name: sensed[:, self._at[name]] for name in MEASURED}
        fields |= {name: np.asarray(sensed[:, self._at[key]].any(axis=1)) for name, key in COLLISIONS.items()}
        fields["arm_distance"] = np.full(len(sensed), np.nan)
        if self._measure_arm:
            fields["arm_distance"] = self._separation.gap(fields["joint_pos"], planned["limbs"])
        return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in fields.items()}

    def _contacts(self, readings: Array, limbs: Array, before: State, touching: Tensor) -> dict[str, Tensor]:
        """Return `contact` and `unsafe_contact` (n * K,) of a decision, `touching` (n * K,) in it.

        `readings` (n * K, substeps, nsensor), people at `limbs` (n * K, L, 7), the state `before` (n rows).
        """
        n = len(before.steps)
        found = {"contact": before.contact, "unsafe_contact": before.unsafe_contact}
        if not touching.any():
            return {name: torch.from_numpy(np.repeat(old.numpy(), len(touching) // n)) for name, old in found.items()}
        touching = touching.view(n, -1)
        began = touching & ~torch.cat([before.touching[:, None], touching[:, :-1]], dim=1)
        unsafe = torch.zeros_like(began)
        at = torch.nonzero(began.flatten())[:, 0].numpy()
        if len(at):
            # The first reading with the contact belongs to the instant before the physics resolves it.
            first = readings[at][..., self._at["human"]].any(axis=-1).argmax(axis=1)
            sensed = readings[at, first]
            moving = sensed[:, self._at["joint_pos"]], sensed[:, self._at["joint_vel"]]
            speed = self._separation.closing_speed(*moving, limbs[at])
            unsafe.view(-1)[at] = torch.from_numpy(speed > UNSAFE_SPEED_M_S)
        new = {"contact": touching, "unsafe_contact": unsafe}
        return {name: (old[:, None] | (new[name].cumsum(dim=1) > 0)).flatten() for name, old in found.items()}
