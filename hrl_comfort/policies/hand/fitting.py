"""Turns that make an object fit a place hardly larger than itself: upright, and its sides along those of the place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import CellConfig
from hrl_comfort.scene.layout import is_slot
from hrl_comfort.sim.variation.grasps import turn_of

Array = NDArray[np.float64]
HOVER_M = 0.03
"""Height over its place at which an object waits until it fits; no slot is deeper."""
FIT_M, FIT_RAD = 0.0015, 0.03
"""Distance from the middle of a slot, and angle from its sides, at which an object fits."""
SQUARE_M = 0.002
"""Difference of half its sides up to which an object is taken by any."""


@dataclass(frozen=True)
class Slot:
    """Place of the objects of a kind that has to fit into it."""

    index: int
    """Of the place in the layout."""
    between: float | None
    """Angle, rad, from one turn of the object that fits to the next; None if it is round."""

    def yaw(self, layout: Array) -> float:
        """Return its bearing, rad, in a layout (F, 7)."""
        w, _, _, z = layout[self.index, 3:]
        return 2 * float(np.arctan2(z, w))

    def fit(self, axes: Array, yaw: float) -> Array:
        """Return the least turn (3, 3) after which an object with `axes` (3, 3) fits into a slot at bearing `yaw`."""
        index = int(np.abs(axes[2]).argmax())
        turn = to_vertical(axes[:, index] * np.sign(axes[2, index]))
        if self.between is None:
            return turn
        side = turn @ axes[:, 0 if index != 0 else 1]
        return about_vertical(-self.off(side, yaw)) @ turn

    def off(self, side: Array, yaw: float) -> float:
        """Return the angle, rad, by which a `side` (3,) of the object is off that of a slot at bearing `yaw`."""
        assert self.between is not None
        bearing = float(np.arctan2(side[1], side[0])) - yaw
        return bearing - self.between * round(bearing / self.between)


def slots(cell: CellConfig) -> list[Slot | None]:
    """Return the slot of each kind of object, None where it belongs to a place with more room."""
    found: list[Slot | None] = []
    for each in cell.objects.values():
        x, y, _ = each.half_m
        between = (np.pi / 2 if abs(x - y) < SQUARE_M else np.pi) if each.shape == "box" else None
        found.append(Slot(list(cell.places).index(each.belongs_at), between) if is_slot(cell, each) else None)
    return found


def level_turns(place: Array, held: Array, slot: Slot | None, yaw: float) -> list[Array]:
    """Return axes (3, 3) of tools at (3,) m that hold an object upright; outwards first.

    `held` (3,) is its vertical axis in the tool's frame. If it has to be turned to fit into a `slot` at bearing `yaw`,
    rad, `held` (6,) has a level side too.
    """
    outwards = turn_of(0.0, float(np.arctan2(place[1], place[0])), 1.0)
    level = to_vertical(outwards @ held[:3] / np.linalg.norm(held[:3])) @ outwards
    if slot is None or slot.between is None:
        return [about_vertical(step * np.pi / 6) @ level for step in (0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6)]
    first = -slot.off(level @ held[3:], yaw)
    return [about_vertical(first + step * slot.between) @ level for step in (0, 1, -1, 2)]


def to_vertical(axis: Array) -> Array:
    """Return the least turn (3, 3) that makes a unit vector (3,), not one that points down, vertical."""
    about, cos = np.cross(axis, [0.0, 0.0, 1.0]), float(axis[2])
    cross = np.cross(np.eye(3), about)
    return np.asarray(np.eye(3) + cross + cross @ cross / max(1 + cos, 1e-6))


def about_vertical(angle: float) -> Array:
    """Return the turn (3, 3) about the vertical by `angle` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def angle_of(turn: Array) -> float:
    """Return the angle of a turn (3, 3), rad."""
    return float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))


def axes_of(quaternion: Array) -> Array:
    """Return the axes (3, 3) of a unit quaternion (4,), w first."""
    w, x, y, z = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
