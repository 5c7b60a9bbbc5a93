"""Figure of the benchmark: throughput against avoidable discomfort, a row a task and a column a level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hrl_comfort.analysis.mixes import IDLE, WORK, best_mix
from hrl_comfort.plots.style import BLACK, CYCLE, around, of_estimates, styled

MARKERS = "osD^v"
"""Beside the colours, which are two more, so that few policies share both."""
RING = {"markersize": 11, "markerfacecolor": "none", "markeredgewidth": 1.5}
"""Look of a point of which only the rim is to be seen round another."""
X, Y = "avoidable_discomfort_per_min", "objects_per_min"
TOP = "meta_controller.name"
Results = Mapping[int, Mapping[str, Any]]
"""Results of a part at a level by the number of their entry."""


def front(entries: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw throughput over avoidable discomfort, a panel a task and level and a point a policy, with 95 % intervals.

    The origin is an arm that rests at home. The dashed line is the least discomfort of a mix of policies, and of rest,
    that is as productive. A cross marks unsafe contacts, a hollow point and a star an entry of another suite, a ring an
    entry that another one is equal to. Entries without a fixed level or of the top `idle`, or in which X was not
    measured, are left out.
    """
    entries = [entry for entry in entries if entry.get("top", {}).get(TOP) != "idle"]
    parts = {part: levels for part in WORK if (levels := levels_of(entries, part))}
    columns = max((len(levels) for levels in parts.values()), default=1)
    with styled():
        figure = Figure(figsize=(max(4.4, 1.0 + 2.3 * columns), 1.0 + 2.4 * max(1, len(parts))))
        axes = figure.subplots(max(1, len(parts)), columns, squeeze=False)
        looks = {number: look(number, entry) for number, entry in enumerate(entries)}
        for row, (part, levels) in zip(axes, parts.items(), strict=False):
            for axis, level in zip(row, levels, strict=False):
                draw(axis, at_level(entries, part, level), looks)
                axis.set(title=f"{part}, level {level}", xlabel="avoidable discomfort (s a minute)")
                axis.margins(0.08)
                axis.set(xlim=(0, None), ylim=(0, None))
            row[0].set(ylabel=WORK[part])
            for axis in row[len(levels) :]:
                axis.remove()
        handles = {
            label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
        }
        if handles:
            figure.legend(handles.values(), handles, loc="outside lower center", ncols=columns)
        return figure


def levels_of(entries: Sequence[Mapping[str, Any]], part: str) -> list[int]:
    """Return the fixed levels at which an entry has X in a part."""
    return sorted({at["level"] for entry in entries for at in shown(entry, part)})


def shown(entry: Mapping[str, Any], part: str) -> list[Mapping[str, Any]]:
    """Return the results of an entry in a part that have a fixed level and X."""
    return [at for at in entry["parts"].get(part, ()) if at["level"] and at.get(X)]


def at_level(entries: Sequence[Mapping[str, Any]], part: str, level: int) -> Results:
    """Return the results of a part at a level."""
    rows = [(number, at) for number, entry in enumerate(entries) for at in shown(entry, part)]
    return {number: at for number, at in rows if at["level"] == level}


def look(number: int, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return how the points of an entry look."""
    colours = (*CYCLE, BLACK)
    colour = colours[number % len(colours)]
    filled = "white" if entry["changed"] else colour
    return {
        "label": entry["policy"] + "*" * bool(entry["changed"]),
        "marker": MARKERS[number % len(MARKERS)],
        "markersize": 5, "capsize": 2, "elinewidth": 0.8, "linestyle": "none",
        "color": colour, "markerfacecolor": filled,
    }  # fmt: skip


def draw(axis: Axes, results: Results, looks: Mapping[int, Mapping[str, Any]]) -> None:
    """Draw the points of a level, and what resting and mixes come to."""
    x, y = (of_estimates([at[name] for at in results.values()]) for name in (X, Y))
    points = [IDLE, *zip(y[0].tolist(), x[0].tolist(), strict=True)]
    work = sorted({each for each, _ in points})
    axis.plot(
        [best_mix(points, each, min) for each in work],
        work,
        color="0.5",
        lw=1.0,
        ls="--",
        label="best mix of policies and rest",
    )
    axis.plot(0, 0, "P", color="0.4", markersize=7, label="idle", zorder=2, clip_on=False)
    for column, (number, at) in enumerate(results.items()):
        here, there = x[:, column : column + 1], y[:, column : column + 1]
        equal = (x[0, column + 1 :] == x[0, column]) & (y[0, column + 1 :] == y[0, column])
        own = {**looks[number], **(RING if bool(equal.any()) else {})}
        axis.errorbar(here[0], there[0], around(*there), around(*here), **own)
        if at["unsafe_contacts_per_h"]["mean"] > 0:
            axis.plot(here[0], there[0], "x", color=BLACK, markersize=9, zorder=3)
