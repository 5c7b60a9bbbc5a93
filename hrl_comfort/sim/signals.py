"""Signals of the compiled model: control vectors, and sensor readings as fields of State."""

from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.safety.separation import TOUCH_M, UNSAFE_SPEED_M_S, Separation
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.workcell import Scene
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
    scene: Scene, targets: Array, limbs: Array, layout: Array, objects: Array, kinds: NDArray[np.int64], points: Array
) -> Array:
    """Return control vectors (n, K * s, ncontrol): servo targets, mocap positions, mocap quaternions.

    targets (n, K * s, J) rad, s to a control step; limbs (n * K, 7, 7) stay put over a control step; the layout
    (n, F, 7) of places and obstacles, objects (n, B, 3) m, of kinds (n, B), and points (n, P, 3) m over all of them.
    Objects are absent if there are points.
    """
    n, steps, joints = len(targets), len(limbs) // len(targets), targets.shape[-1]
    places = joints + 3 * len(scene.mocap)
    control = np.empty((n, steps, targets.shape[1] // steps, scene.ncontrol))
    control[..., :joints] = targets.reshape(*control.shape[:3], joints)
    # Whole runs of numbers at once: numpy is slow on many short ones.
    position, quaternion = control[..., joints:places], control[..., places:]
    first, limbs = scene.first_prop, limbs.reshape(n, steps, 1, len(LIMBS), 7)
    props = len(scene.mocap) - first
    position[..., : 3 * len(LIMBS)] = limbs[..., :3].reshape(n, steps, 1, -1)
    position[..., 3 * len(LIMBS) : 3 * first] = layout[..., :3].reshape(n, 1, 1, -1)
    position[..., 3 * first :] = _absent(props)[0]
    quaternion[..., : 4 * len(LIMBS)] = limbs[..., 3:].reshape(n, steps, 1, -1)
    quaternion[..., 4 * len(LIMBS) : 4 * first] = layout[..., 3:].reshape(n, 1, 1, -1)
    quaternion[..., 4 * first :] = _absent(props)[1]
    props_at = position[..., 3 * first :].reshape(*control.shape[:3], props, 3)
    if count := points.shape[1]:
        props_at[..., :count, :] = points[:, None, None]
    else:
        for index in range(objects.shape[1]):
            props_at[np.arange(n), :, :, scene.object_prop(index, kinds[:, index])] = objects[:, index, None, None]
    return control.reshape(n, -1, scene.ncontrol)


@cache
def _absent(props: int) -> tuple[Array, Array]:
    """Return position (3 * props,) m and quaternion (4 * props,) of props that are not there."""
    return np.tile((FAR_AWAY_M, 0.0, 0.0), props), np.tile((1.0, 0.0, 0.0, 0.0), props)


class Sensors:
    """Fields of State that the sensors give; `arm_distance` is NaN unless `measure_arm`.

    People who are `pushing` do not stop at a touch: what the arm does afterwards is their doing, so that only the first
    pair of capsules that touches is judged.
    """

    def __init__(self, scene: Scene, separation: Separation, measure_arm: bool, pushing: bool = False) -> None:
        self._at, self._separation = scene.sensors, separation
        self._measure_arm, self._pushing = measure_arm, pushing

    def read_first(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields (r, ...) of the first instants of episodes; see `_read`."""
        fields = self._read(sensed, planned)
        return fields | {"contact": fields["touching"], "unsafe_contact": torch.zeros(len(sensed), dtype=torch.bool)}

    def read_decision(
        self,
        readings: Array,
        planned: dict[str, NDArray[Any]],
        before: State,
        limbs: Array,
        rows: NDArray[np.int64] | None,
    ) -> dict[str, Tensor]:
        """Return the fields (N * K, ...) of the decision that began in the state `before` (N rows).

        `limbs` (N, L, 7) are those of people then. `readings` (r * K, substeps, nsensor) are those of `rows` (r,), all
        by default; the other rows stay as they are. `planned` are the fields known beforehand, and `limbs`.
        """
        if rows is None:
            return self._read_all(readings, planned, before, limbs)
        n, count = len(before.steps), len(readings) // len(rows)
        at = (rows[:, None] * count + np.arange(count)).reshape(-1)
        part = {name: value[at] for name, value in planned.items()}
        fields = self._read_all(readings, part, before.rows(torch.from_numpy(rows)), limbs[rows])
        if len(rows) < n:
            for name, value in fields.items():
                still = getattr(before, name).repeat_interleave(count, dim=0)
                fields[name] = still.index_copy(0, torch.from_numpy(at), value)
        return fields

    def _read_all(
        self, readings: Array, planned: dict[str, NDArray[Any]], before: State, limbs: Array
    ) -> dict[str, Tensor]:
        return self._read(readings[:, -1], planned) | self._contacts(readings, planned["limbs"], before, limbs)

    def _read(self, sensed: Array, planned: dict[str, NDArray[Any]]) -> dict[str, Tensor]:
        """Return the fields (n, ...) of readings (n, nsensor); `planned` are those known beforehand, and `limbs`."""
        fields = {name: value for name, value in planned.items() if name != "limbs"}
        fields |= {name: sensed[:, self._at[name]] for name in MEASURED}
        fields |= {name: np.asarray(sensed[:, self._at[key]].any(axis=1)) for name, key in COLLISIONS.items()}
        fields["arm_distance"] = np.full(len(sensed), np.nan)
        if self._measure_arm:
            fields["arm_distance"] = self._separation.gap(fields["joint_pos"], planned["limbs"])
        return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in fields.items()}

    def _contacts(self, readings: Array, limbs: Array, before: State, limbs_before: Array) -> dict[str, Tensor]:
        """Return `touching`, `contact` and `unsafe_contact` (n * K,) of a decision, from all its physics steps.

        `readings` (n * K, substeps, nsensor), people at `limbs` (n * K, L, 7), the state `before` (n rows) beside
        people at `limbs_before` (n, L, 7).
        """
        n, old = len(before.steps), {"contact": before.contact, "unsafe_contact": before.unsafe_contact}
        felt: NDArray[np.bool_] = np.asarray(readings[..., self._at["human"]].any(axis=-1))
        touching: NDArray[np.bool_] = np.asarray(felt.any(axis=1))
        if touching.any():
            speed = self.approach(felt, readings, limbs, before, limbs_before)
            new = {"contact": touching, "unsafe_contact": speed > UNSAFE_SPEED_M_S}
            found = {name: (new[name].reshape(n, -1).cumsum(axis=1) > 0) | old[name].numpy()[:, None] for name in old}
        else:
            found = {name: np.repeat(value.numpy(), len(touching) // n) for name, value in old.items()}
        return {name: torch.from_numpy(value.reshape(-1)) for name, value in {"touching": touching, **found}.items()}

    def approach(
        self, felt: NDArray[np.bool_], readings: Array, limbs: Array, before: State, limbs_before: Array
    ) -> Array:
        """Return the largest speed (n * K,) m/s at which an arm's capsule closed in on one of the person's at a touch.

        Of the pairs that began to touch in a control step, -inf if none did. A reading belongs to the instant before
        the physics resolves the contact; `felt` (n * K, substeps) says which of them have one. The other arguments are
        those of `_contacts`.
        """
        n, substeps = len(before.steps), felt.shape[1]
        felt = felt.reshape(n, -1)
        preceding = np.concatenate([before.touching.numpy()[:, None], felt[:, :-1]], axis=1)
        row, time = felt.nonzero()
        sensed = readings.reshape(*felt.shape, -1)[row, time]
        moving = sensed[:, self._at["joint_pos"]], sensed[:, self._at["joint_vel"]]
        apart, speed = self._separation.pairs(*moving, limbs[(row * felt.shape[1] + time) // substeps])
        touched = np.zeros((len(row), *apart.shape[:2]), dtype=bool)
        again = np.flatnonzero(preceding[row, time])
        row_before, time_before = row[again], time[again] - 1
        earlier = readings.reshape(*felt.shape, -1)[row_before, time_before][:, self._at["joint_pos"]]
        beside = limbs[(row_before * felt.shape[1] + time_before) // substeps]
        first = time_before < 0
        earlier[first], beside[first] = before.joint_pos.numpy()[row_before[first]], limbs_before[row_before[first]]
        if len(again):
            touched[again] = self._separation.touch(earlier, beside)
        begins = (apart.transpose(2, 0, 1) <= TOUCH_M) & ~touched
        if self._pushing:
            begins[again] = False
        fastest = np.full(felt.shape, -np.inf)
        fastest[row, time] = np.where(begins, speed.transpose(2, 0, 1), -np.inf).max(axis=(1, 2))
        largest: Array = fastest.reshape(-1, substeps).max(axis=1)
        return largest
