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
from pandas import DataFrame

from hrl_comfort.analysis.comfort import DISTANCE, SPEED, STEPS, Paired, change
from hrl_comfort.analysis.level_change import Jump
from hrl_comfort.plots.style import BLUE, CYCLE, GREEN, OUTLINE, VERMILLION, around, band, note, points, styled

WORDS = {DISTANCE: "mean distance to person (m)", STEPS: "control steps", SPEED: "mean joint increment (°/step)"}
COLOURS = {DISTANCE: BLUE, STEPS: VERMILLION, SPEED: GREEN}
MARKERS = ("o", "s", "^", "D", "v", "P")
OVER_WORDS = {
    "pairs": "episodes that succeed at every level of the series",
    "all": "episodes, failures at the time limit",
}
LEAST_SHARE = 0.25
"""Of the episodes that run at the jump; its figure ends where fewer still run."""


def levels(data: Paired, over: str, *measures: str) -> Figure:
    """Draw measures by level side by side: distance and steps are the paper's Figs. 5 and 6."""
    with styled():
        figure = Figure(figsize=(max(4.8, 0.4 + 3.6 * len(measures)), 3.0))
        for axis, name in zip(figure.subplots(1, len(measures), squeeze=False)[0], measures, strict=True):
            _by_level(axis, data, name, over)
        count = int(np.isfinite(data.over(STEPS, over)).all(axis=1).sum())
        seeds = len(data.seeds)
        trained = f"; {seeds} training seed{'s' * (seeds > 1)}" if seeds else ""
        bars = f"bars: 95 % of the mean (thin), of its change from level {data.levels[0]} (thick)"
        note(figure, f"{count} of {len(data.entries)} {OVER_WORDS[over]}{trained}\n{bars}")
        return figure


def _by_level(axis: Axes, data: Paired, name: str, over: str) -> None:
    """Draw one measure by level, and say how it changes from the first level to the last."""
    values, colour = data.over(name, over), COLOURS[name]
    if len(data.seeds) > 1:
        for of_seed in DataFrame(values).groupby(data.entries["train_seed"]).mean().to_numpy():
            axis.plot(data.levels, of_seed, color=colour, alpha=0.3, linewidth=0.8)
    mean, low, high = data.clusters.bands(values)
    points(axis, data.levels, mean, low, high, color=colour, elinewidth=1.0)
    first = np.broadcast_to(values[:, :1], values.shape)
    _, fallen, risen = data.clusters.bands(values, first, statistic=lambda at, before: at - before)
    begin = data.clusters.bands(values[:, :1])[0]
    axis.vlines(data.levels[1:], begin + fallen[1:], begin + risen[1:], color=colour, alpha=0.3, linewidth=6)
    axis.set(xlabel="comfort level (1: most cautious)", ylabel=WORDS[name])
    axis.set_xticks(data.levels)
    start, end = data.levels[0], data.levels[-1]
    found = change(data, name, over, start, end) if start != end else None
    if found is not None:
        interval = "" if found["ci95"] is None else " [{:+.1f}, {:+.1f}]".format(*found["ci95"])
        title = f"level {start} to {end}: {found['percent']:+.1f} %{interval}"
        axis.set_title(title.replace("-", "−"), fontweight="normal")


def plane(groups: Mapping[str, Paired], over: str) -> Figure:
    """Draw the comfort-time plane: mean distance over mean steps, a point a level, a series a group."""
    with styled():
        figure = Figure(figsize=(5.2, 3.8))
        axis = figure.subplots()
        for i, (label, data) in enumerate(groups.items()):
            look: dict[str, Any] = {"color": CYCLE[i % len(CYCLE)], "marker": MARKERS[i % len(MARKERS)]}
            x, *across = data.clusters.bands(data.over(STEPS, over))
            y, *up = data.clusters.bands(data.over(DISTANCE, over))
            axis.plot(x, y, label=label, markersize=5, linewidth=0.8, **look, zorder=4)
            crosses: dict[str, Any] = {"fmt": "none", "ecolor": look["color"], "elinewidth": 0.9, "alpha": 0.4}
            axis.errorbar(x, y, around(y, *up), around(x, *across), **crosses)
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


def jump(data: Jump) -> Figure:
    """Draw distance and tool speed with a jump of the level and without (above), and their difference (below)."""
    running = np.isfinite(data.values["human_distance_m"]).all(axis=0).sum(axis=0)
    most = running[data.seconds >= 0].max()
    shown = running >= max(1.0, LEAST_SHARE * most)
    seconds = data.seconds[shown]
    words = {"human_distance_m": ("distance to person", "m"), "tool_speed_m_s": ("tool speed", "m/s")}
    with styled():
        figure = Figure(figsize=(7.6, 4.4))
        axes = figure.subplots(2, 2, sharex=True, height_ratios=(1.5, 1))
        for (above, below), (name, (label, unit)) in zip(axes.T, words.items(), strict=True):
            without, jumping = (values[:, shown] for values in data.values[name])
            band(above, seconds, *data.clusters.bands(without), BLUE, label="without the jump")
            band(above, seconds, *data.clusters.bands(jumping), VERMILLION, label="with the jump")
            band(below, seconds, *data.clusters.bands(jumping - without), "#444444")
            below.axhline(0, color="#999999", linewidth=0.7)
            for axis in (above, below):
                axis.axvline(0, color="#444444", linewidth=0.8, linestyle=":")
            above.set_ylabel(f"{label} ({unit})")
            below.set(xlabel="time from the jump (s)", ylabel=f"with − without ({unit})")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
        share = f"to where {100 * LEAST_SHARE:.0f} % still do; bands: 95 % intervals"
        note(figure, f"{most} episodes that run at the jump in both; {share}")
        return figure
