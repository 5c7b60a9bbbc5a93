"""Draws of the objects of an episode: their kinds, and the slots in which they arrive and belong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import RANDOM, ConfigError, EnvConfig
from hrl_comfort.config.task import slot_users
from hrl_comfort.scene.grippers.cell import floored, half_width_m
from hrl_comfort.scene.layout import is_slot
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.variation.layouts import Layout
from hrl_comfort.tasks import Subtask

Array = NDArray[np.float64]
ARRIVALS = 256
"""Number of objects that arrive later of which the kinds are drawn."""
MIDDLE_M = np.zeros((1, 2))
"""The slot of an object that lies alone."""
ROOM_M = 0.005
"""Smallest distance of an open hand at an object from the object in the next slot."""


class Slots:
    """Slots and kinds of the objects of episodes of `task`.

    Raises:
      ConfigError: objects could overlap, a hand has no room between them, or they could be too wide for their place.
    """

    def __init__(self, scene: Scene, config: EnvConfig, task: Subtask) -> None:
        self._config, self._task = config, task
        self.own = scene.gripper is not None and config.task.objects > 1
        """Whether each object has a slot of its own where it belongs, too."""
        self._slots_m = {name: np.array(place.slots_m) for name, place in config.cell.places.items()}
        self._arriving = tuple(dict.fromkeys(each.arrives_at for each in config.cell.objects.values()))
        _check_widths(config)
        if config.task.objects > 1:
            _check_slots(config, half_width_m(scene.planning) + ROOM_M if self.own else 0.0)

    def drawn(self, rng: np.random.Generator) -> dict[str, Array]:
        """Return the slots (B, 2) m of the objects at each place, in its frame, where they have their `own`.

        An object has one slot at each place, whether it arrives or belongs there; where there are orders, at the places
        of its kind.
        """
        cell, count, found = self._config.cell, self._config.task.objects, dict[str, Array]()
        for name in cell.places:
            own, found[name] = self._slots_m[name], np.zeros((count, 2))
            users = slot_users(self._config.task, cell, name)
            found[name][users] = own[rng.permutation(len(own))[: len(users)]]
        return found

    def objects(
        self, kind: int, slots: dict[str, Array], rng: np.random.Generator
    ) -> tuple[Array, NDArray[np.int64], NDArray[np.int64], Array]:
        """Return offsets (B, kinds, 2, 2) m of the objects in the frames of the places where kinds arrive, kinds (B,).

        Offsets are those of the slot and of the jitter. An object has one slot at each place where objects arrive, of
        `slots` where these are given. The kinds of later objects are the third, and when orders are due the fourth; the
        first kind is given.
        """
        task, cell = self._config.task, self._config.cell
        count, kinds, drawn = task.objects, list(cell.objects.values()), dict[str, Array]()
        for name in self._arriving:
            own = self._slots_m[name] if count > 1 else MIDDLE_M
            drawn[name] = own[rng.permutation(len(own))[:count]] if name not in slots else slots[name]
        jitter = task.object_jitter_m * rng.uniform(-1, 1, (count, 2))
        offsets = np.empty((count, len(kinds), 2, 2))
        offsets[:, :, 1] = jitter[:, None]
        for index, each in enumerate(kinds):
            offsets[:, index, 0] = drawn[each.arrives_at]
        random = task.object == RANDOM
        chosen = rng.integers(len(kinds), size=count) if random else np.full(count, kind)
        chosen[0] = kind
        later = rng.integers(len(kinds), size=ARRIVALS) if random else np.full(ARRIVALS, kind)
        low, high = task.due_s
        if not self._task.orders:
            return offsets, chosen, later, np.full((ARRIVALS, count), np.inf)
        return offsets, np.arange(count), later, low + (high - low) * rng.random((ARRIVALS, count))

    def arrivals(self, layout: Layout, offsets: Array) -> Array:
        """Return where objects arrive (B, kinds, 3) m, for `offsets` as of `objects`."""
        cell = self._config.cell
        arrivals = np.tile(layout.arrives, (len(offsets), 1, 1))
        for index, each in enumerate(cell.objects.values()):
            yaw = layout.yaw(list(cell.places).index(each.arrives_at))
            for offset in offsets[:, index].transpose(1, 0, 2):
                arrivals[:, index, :2] += turned(offset, yaw)
        return arrivals

    def belonging(self, layout: Layout, slots: dict[str, Array]) -> Array:
        """Return where objects belong (B, kinds, 3) m that have `slots` as of `drawn`."""
        cell = self._config.cell
        belongs = np.tile(layout.belongs, (self._config.task.objects, 1, 1))
        for index, each in enumerate(cell.objects.values() if slots else ()):
            yaw = layout.yaw(list(cell.places).index(each.belongs_at))
            belongs[:, index, :2] += turned(slots[each.belongs_at], yaw)
        return belongs


def _check_widths(config: EnvConfig) -> None:
    """Raise ConfigError where `randomise.object_size` makes an object wider than the slot that it has to fit into."""
    largest, cell = config.randomise.object_size[1], config.cell
    for name, each in cell.objects.items():
        room, width = min(cell.places[each.belongs_at].size_m), 2 * each.half_width_m
        if is_slot(cell, each) and largest > 1 and largest * width > room:
            raise ConfigError(
                f"randomise.object_size up to {largest:g} makes cell.objects.{name} {largest * width:.3g} m wide, and "
                f"cell.places.{each.belongs_at} is {room:.3g} m wide; give at most {floored(room / width):g}"
            )


def _check_slots(config: EnvConfig, beside: float) -> None:
    """Raise ConfigError where objects could overlap; with a hand, where it is not `beside` m off its neighbours."""
    cell, jitter = config.cell, config.task.object_jitter_m
    ends = ("arrives_at", "belongs_at") if beside else ("arrives_at",)
    largest = max(1.0, config.randomise.object_size[1])
    there = [(getattr(each, end), largest * each.half_width_m) for end in ends for each in cell.objects.values()]
    for name in dict.fromkeys(place for place, _ in there):
        widest = max(half for place, half in there if place == name)
        slots = np.array(cell.places[name].slots_m)
        gaps = np.maximum(np.abs(slots[:, None] - slots[None]) - 2 * jitter, 0.0)
        apart = np.linalg.norm(gaps, axis=-1)[np.triu_indices(len(slots), 1)].min(initial=np.inf)
        if apart < 2 * widest - 1e-9:
            raise ConfigError(
                f"task.object_jitter_m={jitter} lets objects come within {apart:.3f} m of each other; "
                f"cell.places.{name}.slots_m must leave their width, {2 * widest:.3f} m"
            )
        if apart < widest + beside - 1e-9:
            raise ConfigError(
                f"cell.places.{name}.slots_m and task.object_jitter_m={jitter} leave {apart:.3f} m from an object to "
                f"the next; robot.gripper.name={config.robot.gripper.name} needs {widest + beside:.3f} m: move the "
                "slots apart"
            )


def turned(points: Array, yaw: float) -> Array:
    """Return `points` (n, 2) turned about the origin by `yaw` rad."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[cos, sin], [-sin, cos]])
