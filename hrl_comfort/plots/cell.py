"""A cell from above and from the side: the robot's base, its places, and where objects arrive and belong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

from hrl_comfort.plots.style import BLACK, GREY, OUTLINE

LABEL_M = 0.03
"""Between a place's edge and the middle of its name."""
BASE_M = 0.15
"""Side of the square that stands for the robot's base, about as wide as a UR3e's."""
Point = tuple[float, float]


@dataclass(frozen=True)
class Spot:
    """A place as it is drawn."""

    name: str
    top: tuple[float, float, float]
    """Middle of the surface, m."""
    corners: list[Point]
    """Of the surface from above, m."""
    colour: Any
    """Of its mark: of the kind of object that belongs there, or of the one that arrives if that is known."""
    arrival: bool
    """Whether objects arrive there."""
    tolerance_m: float | None
    """Distance from the goal at which the tool has arrived; None where it is not known or nothing goes there."""


def spots(cell: Mapping[str, Any], precision: Mapping[str, float], kind: str | None = None) -> Iterator[Spot]:
    """Yield the places of a run's `cell`, with an object of a `kind` of its own.

    Args:
      cell: `cell` of the run's configuration; empty when it is not known.
      precision: `task.precision` of the run's configuration; empty when it is not known.
      kind: that an episode was about.
    """
    objects = cell.get("objects", {})
    for name, place in cell.get("places", {}).items():
        arriving = [key for key, each in objects.items() if each["arrives_at"] == name]
        belonging = [key for key, each in objects.items() if each["belongs_at"] == name]
        shown = [kind] if kind in arriving else belonging
        colour = objects[shown[0]].get("rgb", BLACK) if shown else BLACK if arriving else GREY
        key = "grasp_tolerance_m" if arriving else "place_tolerance_m" if belonging else ""
        (x, y, z), (wide, deep) = place["top_m"], place["size_m"]
        turn = np.radians(place.get("yaw_deg", 0.0))
        corners = [
            (x + u * np.cos(turn) - v * np.sin(turn), y + u * np.sin(turn) + v * np.cos(turn))
            for u, v in ((-wide / 2, -deep / 2), (wide / 2, -deep / 2), (wide / 2, deep / 2), (-wide / 2, deep / 2))
        ]
        yield Spot(name.replace("_", " "), (x, y, z), corners, colour, bool(arriving), precision.get(key))


def draw_from_above(axis: Axes, found: Iterator[Spot]) -> None:
    """Draw the base, and the places with their names, marks and tolerances."""
    corner = (-BASE_M / 2, -BASE_M / 2)
    axis.add_patch(Rectangle(corner, BASE_M, BASE_M, facecolor="#d9d9d9", **_EDGE))
    _label(axis, "base", (0.0, 0.0))
    for spot in found:
        x, y, _ = spot.top
        axis.add_patch(Polygon(spot.corners, facecolor="#f0f0f0", **_EDGE))
        # Paths to and from a place run on the robot's side of it.
        half = max(abs(v - y) for _, v in spot.corners)
        away = max(half, spot.tolerance_m or 0.0) + LABEL_M
        _label(axis, spot.name, (x, y + away * (1 if y > 0 else -1)))
        mark = "o" if spot.arrival else "D"
        axis.plot(x, y, mark, color=spot.colour, markersize=7, markeredgecolor="white", zorder=5)
        _tolerance(axis, (x, y), spot)


def draw_from_side(axis: Axes, found: Iterator[Spot]) -> None:
    """Draw the base, and the marks and tolerances of the places, over x and z."""
    for spot in found:
        x, _, z = spot.top
        axis.plot(x, z, "D", color=spot.colour, markersize=6, markeredgecolor="white")
        _tolerance(axis, (x, z), spot)
    axis.plot(0, 0, "s", color=GREY, markersize=9)


_EDGE: dict[str, Any] = {"edgecolor": "#cccccc", "linewidth": 0.6, "zorder": 1}


def _tolerance(axis: Axes, at: Point, spot: Spot) -> None:
    """Draw the distance from a goal at which the tool has arrived."""
    if spot.tolerance_m is not None:
        look: dict[str, Any] = {"edgecolor": spot.colour, "linestyle": ":", "linewidth": 0.9, "zorder": 2}
        axis.add_patch(Circle(at, spot.tolerance_m, fill=False, **look))


def _label(axis: Axes, text: str, at: Point) -> None:
    look: dict[str, Any] = {"fontsize": 7, "ha": "center", "va": "center", "color": "#555555", "zorder": 2}
    axis.text(*at, text, path_effects=[OUTLINE], **look)
