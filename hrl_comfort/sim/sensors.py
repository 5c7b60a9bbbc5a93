"""Sensor readings as fields of State."""

from functools import reduce

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.compiled import contiguous
from hrl_comfort.safety.separation import TOUCH_M, UNSAFE_SPEED_M_S, Separation
from hrl_comfort.scene import kernels
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.hand.sensors import Fields, HandSensors, still
from hrl_comfort.sim.plan import Planned
from hrl_comfort.sim.step_result import tensors
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
COLLISIONS = {"table_collision": "table", "self_collision": "self"}
"""Field of State -> sensors whose contact it reports."""
MEASURED = ("joint_pos", "joint_vel", "tcp_pos")


class Sensors:
    """Fields of State that the sensors give.

    `arm_distance` is NaN unless `measure_arm`, `home_distance` unless `measure_home`.

    People who are `pushing` do not stop at a touch: what the arm does afterwards is their doing, so that only the first
    pair of capsules that touches is judged.
    """

    def __init__(
        self,
        scene: Scene,
        separation: Separation,
        measure_arm: bool = False,
        measure_home: bool = False,
        pushing: bool = False,
    ) -> None:
        self._at, self._separation = scene.sensors, separation
        self._measure_arm, self._measure_home, self._pushing = measure_arm, measure_home, pushing
        self._hand = None if scene.gripper is None else HandSensors(scene)

    def read_first(self, sensed: Array, planned: Planned, known: dict[str, Tensor]) -> dict[str, Tensor]:
        """Return the fields (r, ...) of the first instants of episodes, from readings (r, nsensor).

        `known` are fields that are drawn, the joints at home (r, J) rad and the kinds of the objects (r, B) among them.
        """
        read = self._read(sensed[:, None], planned, known["joint_home"].numpy())
        read["touching"] = self._felt(sensed[:, None], "human")
        if self._hand is not None:
            read |= self._hand.first(sensed[:, None], known["kinds"].numpy())
        fields = tensors({name: np.ascontiguousarray(value[:, 0]) for name, value in read.items()})
        return fields | {"contact": fields["touching"], "unsafe_contact": torch.zeros(len(sensed), dtype=torch.bool)}

    def read_decision(
        self, readings: Array, planned: Planned, before: State, limbs: Array, rows: NDArray[np.int64] | None
    ) -> Fields:
        """Return the fields (N, K, ...) of the decision that began in the state `before` (N rows).

        `limbs` (N, L, 7) are those of people then. `readings` (r, K, substeps, nsensor) are those of `rows` (r,), all
        by default; the other rows stay as they are.
        """
        if rows is None:
            return self._read_all(readings, planned, before, limbs)
        part = Planned({name: value[rows] for name, value in planned.fields.items()}, planned.limbs[rows])
        fields = self._read_all(readings, part, before.rows(torch.from_numpy(rows)), limbs[rows])
        if len(rows) < len(before.steps):
            for name, value in fields.items():
                fields[name] = np.repeat(getattr(before, name).numpy()[:, None], value.shape[1], axis=1)
                fields[name][rows] = value
        return fields

    def _read_all(self, readings: Array, planned: Planned, before: State, limbs: Array) -> Fields:
        fields = self._read(np.ascontiguousarray(readings[:, :, -1]), planned, before.joint_home.numpy())
        fields |= self._contacts(readings, planned.limbs, before, limbs)
        if self._hand is None:
            return fields
        hand = self._hand.decision(readings[:, :, -1], before)
        arm = {name: value for name, value in fields.items() if name not in planned.fields}
        return fields | still(arm, hand["diverged"], before) | hand

    def _read(self, sensed: Array, planned: Planned, home: Array) -> Fields:
        """Return the fields (n, K, ...) of readings (n, K, nsensor), those that are planned among them.

        The arm's home is at joints (n, J) rad.
        """
        fields = dict(planned.fields)
        fields |= {name: sensed[..., self._at[name]] for name in MEASURED}
        fields |= {name: self._felt(sensed, key) for name, key in COLLISIONS.items()}
        fields["arm_distance"] = fields["home_distance"] = np.full(sensed.shape[:2], np.nan)
        if self._measure_arm:
            fields["arm_distance"] = self._gap(fields["joint_pos"], planned.limbs)
        if self._measure_home:
            resting = np.broadcast_to(home[:, None], fields["joint_pos"].shape)
            fields["home_distance"] = self._gap(resting, planned.limbs)
        return fields

    def _felt(self, readings: Array, key: str) -> NDArray[np.bool_]:
        """Return (...,) whether any of the sensors `key` reads something, of readings (..., nsensor)."""
        at, each = self._at[key], readings.reshape(-1, readings.shape[-1])
        return kernels.felt(*contiguous(each), at.start, at.stop).reshape(readings.shape[:-1])

    def _gap(self, angles: Array, limbs: Array) -> Array:
        """Return the distance (n, K) m of arms at `angles` (n, K, J) rad from people at `limbs` (n, K, L, 7)."""
        gap = self._separation.gap(angles.reshape(-1, angles.shape[-1]), limbs.reshape(-1, *limbs.shape[2:]))
        return gap.reshape(angles.shape[:2])

    def _contacts(self, readings: Array, limbs: Array, before: State, limbs_before: Array) -> Fields:
        """Return `touching`, `contact` and `unsafe_contact` (n, K) of a decision, from all its physics steps.

        `readings` (n, K, substeps, nsensor), people at `limbs` (n, K, L, 7), the state `before` (n rows) beside
        people at `limbs_before` (n, L, 7).
        """
        old = {"contact": before.contact.numpy(), "unsafe_contact": before.unsafe_contact.numpy()}
        felt = self._felt(readings, "human")
        # Over so few, reductions of numpy take long.
        touching = reduce(np.logical_or, [felt[:, :, substep] for substep in range(felt.shape[2])])
        if touching.any():
            speed = self.approach(felt, readings, limbs, before, limbs_before)
            new = {"contact": touching, "unsafe_contact": speed > UNSAFE_SPEED_M_S}
            found = {name: (new[name].cumsum(axis=1) > 0) | old[name][:, None] for name in old}
        else:
            found = {name: np.repeat(value[:, None], touching.shape[1], axis=1) for name, value in old.items()}
        return {"touching": touching, **found}

    def approach(
        self, felt: NDArray[np.bool_], readings: Array, limbs: Array, before: State, limbs_before: Array
    ) -> Array:
        """Return the largest speed (n, K) m/s at which an arm's capsule closed in on one of the person's at a touch.

        Of the pairs that began to touch in a control step, -inf if none did. A reading belongs to the instant before
        the physics resolves the contact; `felt` (n, K, substeps) says which of them have one. The other arguments are
        those of `_contacts`.
        """
        n, count, substeps = felt.shape
        readings = readings.reshape(n, count * substeps, -1)
        felt = felt.reshape(n, -1)
        preceding = np.concatenate([before.touching.numpy()[:, None], felt[:, :-1]], axis=1)
        row, time = felt.nonzero()
        sensed = readings[row, time]
        moving = sensed[:, self._at["joint_pos"]], sensed[:, self._at["joint_vel"]]
        apart, speed = self._separation.pairs(*moving, limbs[row, time // substeps])
        touched = np.zeros((len(row), *apart.shape[:2]), dtype=bool)
        again = np.flatnonzero(preceding[row, time])
        row_before, time_before = row[again], time[again] - 1
        earlier = readings[row_before, time_before][:, self._at["joint_pos"]]
        beside = limbs[row_before, time_before // substeps]
        first = time_before < 0
        earlier[first], beside[first] = before.joint_pos.numpy()[row_before[first]], limbs_before[row_before[first]]
        if len(again):
            touched[again] = self._separation.touch(earlier, beside)
        begins = (apart.transpose(2, 0, 1) <= TOUCH_M) & ~touched
        if self._pushing:
            begins[again] = False
        fastest = np.full(felt.shape, -np.inf)
        fastest[row, time] = np.where(begins, speed.transpose(2, 0, 1), -np.inf).max(axis=(1, 2))
        return reduce(np.maximum, np.moveaxis(fastest.reshape(n, count, substeps), 2, 0))
