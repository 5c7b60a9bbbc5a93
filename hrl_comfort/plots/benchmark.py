"""Figure of the benchmark: throughput against avoidable discomfort, a panel a level."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_comfort.plots.style import BLACK, CYCLE, around, of_estimates, styled

MARKERS = "osD^v"
"""One for each round of colours."""
X, Y = "avoidable_discomfort_per_min", "objects_per_min"
COLUMNS = 2


def front(entries: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw objects a minute over avoidable discomfort, a panel a level and a point a policy, with 95 % intervals.

    The origin is an arm that rests at home. The dashed line is *time-sharing*: to work a part of the time as the most
    productive policy, and to rest. A cross marks unsafe contacts, a hollow point and a star an entry of another suite.
    Entries without a fixed level, or in which X was not measured, are left out.
    """
    found = {level: at_level(entries, level) for level in levels_of(entries)}
    with styled():
        rows = max(1, math.ceil(len(found) / COLUMNS))
        figure = Figure(figsize=(6.4, 1.0 + 2.4 * rows))
        axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
        looks = {number: look(number, entry) for number, entry in enumerate(entries)}
        for axis, (level, points) in zip(axes, found.items(), strict=False):
            draw(axis, points, looks)
            axis.set(title=f"level {level}", xlabel="avoidable discomfort (s a minute)", ylabel="objects a minute")
        for axis in axes[len(found) :]:
            axis.remove()
        handles = {
            label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
        }
        if handles:
            figure.legend(handles.values(), handles, loc="outside lower center", ncols=3)
        return figure


def levels_of(entries: Sequence[Mapping[str, Any]]) -> list[int]:
    """Return the fixed levels at which an entry has X."""
    return sorted({at["level"] for entry in entries for at in entry["levels"] if at["level"] and at.get(X)})


def at_level(entries: Sequence[Mapping[str, Any]], level: int) -> dict[int, Mapping[str, Any]]:
    """Return the results at a level by the number of their entry."""
    rows = [(number, at) for number, entry in enumerate(entries) for at in entry["levels"]]
    return {number: at for number, at in rows if at["level"] == level and at.get(X)}


def look(number: int, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return how the points of an entry look."""
    colours = (*CYCLE, BLACK)
    colour = colours[number % len(colours)]
    filled = "white" if entry["changed"] else colour
    return {
        "label": entry["policy"] + "*" * bool(entry["changed"]),
        "marker": MARKERS[number // len(colours) % len(MARKERS)],
        "markersize": 5, "capsize": 2, "elinewidth": 0.8, "linestyle": "none",
        "color": colour, "markerfacecolor": filled,
    }  # fmt: skip


def draw(axis: Axes, points: Mapping[int, Mapping[str, Any]], looks: Mapping[int, Mapping[str, Any]]) -> None:
    """Draw the points of a level, and what resting and time-sharing come to."""
    x, y = (of_estimates([at[name] for at in points.values()]) for name in (X, Y))
    most = int(np.argmax(y[0]))
    axis.plot([0, x[0][most]], [0, y[0][most]], color="0.5", lw=1.0, ls="--", label="time-sharing", zorder=1)
    axis.plot(0, 0, "P", color="0.4", markersize=7, label="idle", zorder=2)
    for column, (number, at) in enumerate(points.items()):
        here, there = x[:, column : column + 1], y[:, column : column + 1]
        axis.errorbar(here[0], there[0], around(*there), around(*here), **looks[number])
        if at["unsafe_contacts_per_h"]["mean"] > 0:
            axis.plot(here[0], there[0], "x", color=BLACK, markersize=9, zorder=3)
