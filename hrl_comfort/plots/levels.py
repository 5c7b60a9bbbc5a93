"""Figures of the effect of the comfort level, level by level.

Points are means, thin bars their 95 % intervals; a light line is one
training seed. Much of a mean's interval is where the person stands, which is the same at every level: thick
bars are intervals of the change from the first level alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hrl_comfort.analysis.comfort import (
    DISTANCE,
    SPEED,
    STEPS,
    Paired,
    change,
    mean_by_seed,
)
from hrl_comfort.files.tables import Floats
from hrl_comfort.plots.style import BLUE, CYCLE, GREEN, OUTLINE, VERMILLION, around, note, styled

WORDS = {
    DISTANCE: "mean distance to person (m)",
    STEPS: "control steps",
    SPEED: "mean joint increment (°/step)",
}
MARKERS = ("o", "s", "^", "D", "v", "P")
OVER_WORDS = {
    "pairs": "episodes that succeed at every level of the series",
    "all": "episodes, failures at the time limit",
}


def _means(data: Paired, name: str, over: str) -> tuple[Floats, Floats]:
    """Return means (L,) and how far their intervals reach below and above (2, L)."""
    mean, low, high = data.clusters.bands(data.over(name, over))
    return mean, around(mean, low, high)


def _changes(data: Paired, name: str, over: str) -> tuple[Floats, Floats]:
    """Return low and high (L,) of the change from the first level, laid on the first level's mean."""
    values = data.over(name, over)
    first = np.broadcast_to(values[:, :1], values.shape)
    _, low, high = data.clusters.bands(values, first, statistic=lambda at, before: at - before)
    mean = data.clusters.bands(values[:, :1])[0]
    return mean + low, mean + high


def _by_level(axis: Axes, data: Paired, name: str, over: str, colour: str) -> None:
    """Draw one measure by level, and say how it changes from the first level to the last."""
    by_seed = mean_by_seed(data, name, over)
    if len(by_seed) > 1:
        for values in by_seed.values():
            axis.plot(data.levels, values, color=colour, alpha=0.3, linewidth=0.8)
    mean, reach = _means(data, name, over)
    axis.errorbar(data.levels, mean, reach, color=colour, marker="o", markersize=4, capsize=2.5, elinewidth=1.0)
    axis.vlines(data.levels[1:], *(b[1:] for b in _changes(data, name, over)), color=colour, alpha=0.3, lw=6)
    axis.set(xlabel="comfort level (1: most cautious)", ylabel=WORDS[name])
    axis.set_xticks(data.levels)
    first, last = data.levels[0], data.levels[-1]
    found = change(data, name, over, first, last) if first != last else None
    if found is not None:
        interval = "" if found["ci95"] is None else " [{:+.1f}, {:+.1f}]".format(*found["ci95"])
        title = f"level {first} to {last}: {found['percent']:+.1f} %{interval}"
        axis.set_title(title.replace("-", "−"), fontweight="normal")


def levels(data: Paired, over: str) -> Figure:
    """Draw distance to the person and steps by level (the paper's Figs. 5 and 6)."""
    return _panels(data, over, {DISTANCE: BLUE, STEPS: VERMILLION})


def speed(data: Paired, over: str) -> Figure:
    """Draw how much the fastest joint turns a control step, by level."""
    return _panels(data, over, {SPEED: GREEN})


def _panels(data: Paired, over: str, measures: Mapping[str, str]) -> Figure:
    """Draw measures, each in its colour, side by side."""
    with styled():
        figure = Figure(figsize=(max(4.8, 0.4 + 3.6 * len(measures)), 3.0))
        for axis, (name, colour) in zip(
            figure.subplots(1, len(measures), squeeze=False)[0], measures.items(), strict=True
        ):
            _by_level(axis, data, name, over, colour)
        bars = f"bars: 95 % of the mean (thin), of its change from level {data.levels[0]} (thick)"
        note(figure, f"{_who(data, over)}\n{bars}")
        return figure


def _who(data: Paired, over: str) -> str:
    """Say which episodes the means are over, in words."""
    count = int(np.isfinite(data.over(STEPS, over)).all(axis=1).sum())
    seeds = len(data.seeds)
    trained = f"; {seeds} training seed{'s' * (seeds > 1)}" if seeds else ""
    return f"{count} of {len(data.entries)} {OVER_WORDS[over]}{trained}"


def plane(groups: Mapping[str, Paired], over: str) -> Figure:
    """Draw the comfort-time plane: mean distance over mean steps, a point a level, a series a group."""
    with styled():
        figure = Figure(figsize=(5.2, 3.8))
        axis = figure.subplots()
        for i, (label, data) in enumerate(groups.items()):
            look: dict[str, Any] = {"color": CYCLE[i % len(CYCLE)], "marker": MARKERS[i % len(MARKERS)]}
            x, across = _means(data, STEPS, over)
            y, up = _means(data, DISTANCE, over)
            axis.plot(x, y, label=label, markersize=5, linewidth=0.8, **look, zorder=4)
            axis.errorbar(x, y, up, across, fmt="none", ecolor=look["color"], elinewidth=0.9, alpha=0.4)
            for level, at in zip(data.levels, zip(x, y, strict=True), strict=True):
                text = axis.annotate(str(level), at, (4, 4), textcoords="offset points", zorder=5)
                text.set(fontsize=7, color=look["color"], path_effects=[OUTLINE])
        axis.set(xlabel=f"mean {WORDS[STEPS]}", ylabel=WORDS[DISTANCE])
        axis.xaxis.set_major_locator(MaxNLocator(6))
        figure.legend(loc="outside upper left", ncols=3)
        entries = len(set.union(*(set(data.entry) for data in groups.values())))
        which = f"{entries} episodes that succeed in all of them" if over == "pairs" else OVER_WORDS[over]
        note(figure, f"crosses: 95 % intervals; {which}")
        return figure
