"""Sensor readings of hand and objects as fields of State."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.config import CONTROL_STEP_S, CellConfig
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.variation.grasps import ABOVE_M, TILTS_RAD
from hrl_comfort.tasks import State
from hrl_comfort.tasks.hand import CARRIED_M, FREE_STEPS, LIFT_M
from hrl_comfort.tasks.hand.observation import turned

Array = NDArray[np.float64]
Fields = dict[str, NDArray[Any]]
"""Fields of State by their names."""
FLOOR_M, LOW_M = 0.15, 0.02
"""Height above the floor below which an object's centre means that it fell off its place, at most half way down from
there; of places lower than LOW_M over the floor nothing falls."""
FARTHEST_M = 3.0
"""Distance from the robot's base beyond which an object is lost."""
POSTURES, BEYOND_M = 40_000, 0.03
"""Random postures of which the farthest says how far the hand reaches, and how much farther it may in truth: of eight
draws the largest was 15 mm beyond the first."""
FASTEST_M_S = 50.0
"""Speed above which an object moves because the physics diverged."""
COUNTED = ("ground", "aloft_steps", "free_steps", "carried", "held_at", "slip", "drops", "object_lost", "diverged")
"""Fields that depend on the instant before."""


class HandSensors:
    """Fields of State that the sensors of a cell with a gripper give."""

    def __init__(self, scene: Scene) -> None:
        self._at, self._kinds, self._losses = scene.sensors, len(scene.cell.objects), Losses(scene)
        self._open, self._closed = scene.model.actuator_ctrlrange[len(scene.joints)]

    def first(self, sensed: Array, kinds: NDArray[np.int64]) -> Fields:
        """Return the fields (n, 1, ...) of the first instants of episodes, from readings (n, 1, nsensor).

        Objects are of `kinds` (n, B).
        """
        fields = self._read(sensed, kinds)
        return fields | self._begun(fields, self._in_hand(sensed, fields))

    def decision(self, sensed: Array, before: State) -> Fields:
        """Return the fields (n, K, ...) of a decision that began in the state `before` (n rows).

        From readings (n, K, nsensor). From where the physics diverged on, they are those before it.
        """
        steps = before.steps.numpy()[:, None] + np.arange(1, sensed.shape[1] + 1)
        fields = self._read(sensed, before.kinds.numpy())
        # MuJoCo begins again at time 0 and its model's positions where numbers are no longer finite, or too large.
        late = sensed[..., self._at["time"]][..., 0] < (steps - 1.5) * CONTROL_STEP_S
        way = np.diff(fields["objects"], axis=1, prepend=before.objects.numpy()[:, None])
        flung = ~(np.linalg.norm(way, axis=-1) < FASTEST_M_S * CONTROL_STEP_S).all(axis=-1)
        diverged = np.logical_or.accumulate(late | flung | ~np.isfinite(sensed).all(axis=-1), axis=1)
        kept = still(fields, diverged, before)
        return kept | self._counted(kept, self._in_hand(sensed, kept), diverged, before)

    def _in_hand(self, sensed: Array, fields: Fields) -> Array:
        """Return the centres of the objects (n, K, B, 3) m in the frame of the tool."""
        away = torch.from_numpy(fields["objects"] - sensed[..., None, self._at["tcp_pos"]])
        back = torch.from_numpy(fields["tcp_quat"][..., None, :] * [1.0, -1.0, -1.0, -1.0])
        return turned(back.expand(*away.shape[:-1], 4), away).numpy()

    def _read(self, sensed: Array, kinds: NDArray[np.int64]) -> Fields:
        """Return the fields (n, K, ...) of readings (n, K, nsensor) that need no memory; `kinds` (n, B) of objects."""
        n, count = sensed.shape[:2]
        way = self._closed - self._open
        body = np.arange(kinds.shape[1]) * self._kinds + kinds

        def of_objects(name: str, width: int) -> Array:
            each = sensed[..., self._at[name]].reshape(n, count, -1, width)
            return np.take_along_axis(each, body[:, None, :, None], axis=2)

        return {
            "grip": (sensed[..., self._at["hand_pos"]][..., 0] - self._open) / way,
            "grip_vel": sensed[..., self._at["hand_vel"]][..., 0] / way,
            "tcp_quat": sensed[..., self._at["tcp_quat"]],
            "objects": of_objects("object_pos", 3),
            "objects_quat": of_objects("object_quat", 4),
            "objects_vel": of_objects("object_vel", 3),
            "pads": of_objects("pads", 2) > 0,
        }

    def _begun(self, fields: Fields, in_hand: Array) -> Fields:
        """Return COUNTED (n, 1, ...) of the first instants of episodes; `in_hand` as of `_in_hand`."""
        height, held = fields["objects"][..., 2], np.asarray(fields["pads"].all(axis=-1))
        none, n = np.zeros(height.shape, dtype=np.int64), len(height)
        ground = np.where(held, height - ABOVE_M, height)
        return {
            "ground": ground, "aloft_steps": none, "free_steps": none.copy(), "carried": held,
            "held_at": in_hand, "slip": np.zeros((n, 1)),
            "drops": np.zeros((n, 1), dtype=np.int64), "object_lost": np.zeros((n, 1), dtype=bool),
            "diverged": np.zeros((n, 1), dtype=bool),
        }  # fmt: skip

    def _counted(self, fields: Fields, in_hand: Array, diverged: NDArray[np.bool_], before: State) -> Fields:
        """Return COUNTED (n, K, ...) of a decision that began in the state `before` (n rows)."""
        now = {name: getattr(before, name).numpy() for name in COUNTED}
        places, near = before.object_places.numpy(), before.place_tolerance.numpy()[:, None]
        found = []
        for k in range(diverged.shape[1]):
            at, pads = fields["objects"][:, k], fields["pads"][:, k]
            touched, held = pads.any(axis=-1), pads.all(axis=-1)
            ground = np.where(touched, now["ground"], at[..., 2])
            lifted = at[..., 2] - ground
            free = np.where(touched, 0, now["free_steps"] + 1)
            let_go = now["carried"] & (free >= FREE_STEPS)
            away = np.linalg.norm(at - places, axis=-1) > near
            carried = np.asarray((now["carried"] & ~let_go) | (held & (lifted > CARRIED_M)))
            kept = now["carried"] | diverged[:, k, None]
            held_at = np.where(kept[..., None], now["held_at"], in_hand[:, k])
            firm = carried & held & ~diverged[:, k, None]
            shifted = np.where(firm, np.linalg.norm(in_hand[:, k] - held_at, axis=-1), 0.0)
            now = {
                "ground": ground,
                "aloft_steps": np.where(held & (lifted >= LIFT_M), now["aloft_steps"] + 1, 0),
                "free_steps": free,
                "carried": carried,
                "held_at": held_at,
                "slip": np.maximum(now["slip"], shifted.max(axis=-1)),
                "drops": now["drops"] + (let_go & away).any(axis=-1),
                "object_lost": self._losses(at, before.kinds.numpy(), carried).any(axis=-1) | diverged[:, k],
                "diverged": now["diverged"] | diverged[:, k],
            }
            found.append(now)
        return {name: np.stack([each[name] for each in found], axis=1) for name in COUNTED}


class Losses:
    """Objects of the cells of `scene` that are lost: on the floor, or out of the cell.

    Where there are several, one that the hand cannot reach is lost, too: the others can still be served.
    """

    def __init__(self, scene: Scene) -> None:
        self._floor_z, self._fallen = scene.floor_z, fallen_m(scene.cell)
        several = len(scene.loose) > len(scene.cell.objects)
        self._farthest = _downward_reach_m(scene) if several else FARTHEST_M

    def __call__(self, at: Array, kinds: NDArray[np.int64], carried: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return (n, B) whether objects of `kinds` (n, B) at (n, B, 3) m are lost; `carried` (n, B) are in reach."""
        away = np.linalg.norm(at[..., :2], axis=-1)
        low = at[..., 2] - self._floor_z < self._fallen[kinds]
        return np.asarray(low | ((away > self._farthest) & ~carried))


_REACHES_M: dict[str, float] = {}
"""`_downward_reach_m` by the XML of the scene: it takes a second."""


def _downward_reach_m(scene: Scene) -> float:
    """Return the largest horizontal distance, m, from the base of a tool that points down as for a grasp.

    It is FARTHEST_M for an arm of which no posture that was drawn points down.
    """
    if scene.xml in _REACHES_M:
        return _REACHES_M[scene.xml]
    low, high = np.clip(scene.joint_range, -np.pi, np.pi).T
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))
    places, turns = ArmGeometry(scene).tool_pose(postures)
    down = turns[:, 2, 2] < -np.cos(TILTS_RAD[-1])
    farthest = float(np.linalg.norm(places[down, :2], axis=1).max()) + BEYOND_M if down.any() else FARTHEST_M
    return _REACHES_M.setdefault(scene.xml, farthest)


def fallen_m(cell: CellConfig) -> Array:
    """Return the heights (kinds,) m above the floor below which the centre of an object of each kind lies there."""
    lowest = min(place.top_m[2] for place in cell.places.values()) + cell.base_height_m
    if lowest < LOW_M:
        return np.full(len(cell.objects), -np.inf)
    half = np.array([each.half_height_m for each in cell.objects.values()])
    return np.minimum(FLOOR_M, half + lowest / 2)


def still(fields: Fields, diverged: NDArray[np.bool_], before: State) -> Fields:
    """Return `fields` (n, K, ...) of a decision, which stay as they were when the physics has `diverged` (n, K).

    They stay as in the last instant before, in the decision or in the state `before` it (n rows).
    """
    if not diverged.any():
        return fields
    last = np.maximum.accumulate(np.where(diverged, 0, np.arange(1, diverged.shape[1] + 1)), axis=1)
    rows = np.arange(len(last))[:, None]
    begun = {name: getattr(before, name).numpy()[:, None] for name in fields}
    return {name: np.concatenate([begun[name], value], axis=1)[rows, last] for name, value in fields.items()}
