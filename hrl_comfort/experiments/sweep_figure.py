"""The learning curves of a sweep: success against decisions, a line a combination, a band over its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hrl_comfort.experiments.figures import BLACK, CYCLE, STYLE, smoothed
from hrl_comfort.experiments.run_folder import Run
from hrl_comfort.experiments.statistics import Floats, seed_interval
from hrl_comfort.experiments.sweep_table import Row

LOOKS = [(colour, dashes) for dashes, colour in product(("-", "--", ":", "-."), CYCLE)]
"""How lines are told apart; so many can be drawn."""
Curve = tuple[Floats, Floats]
"""Decisions in thousands, and success in %, both (n,)."""


def learning(rows: Sequence[Row]) -> Figure | None:
    """Draw the curves of the first combinations, as many as can be told apart; None without any.

    A thick line is the mean of the finished runs, its band Student's 95 % interval over them, cut at 0 and
    100 %. Thin lines are the single runs that are not finished, with a cross where each one stands.
    """
    rows = [row for row in rows if any(_curve(entry.run) for entry in row.entries)][: len(LOOKS)]
    if not rows:
        return None
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.0), layout="constrained")
        axis = figure.subplots()
        handles = []
        for row, (colour, dashes) in zip(rows, LOOKS, strict=False):
            finished = _draw_row(axis, row, colour, dashes)
            label = f"{row.name} (n = {finished})" if finished else f"{row.name} (none finished)"
            handles.append(Line2D([], [], color=colour, linestyle=dashes, label=label))
        if any(entry.state != "finished" and _curve(entry.run) for row in rows for entry in row.entries):
            look = {"color": BLACK, "linewidth": 0.7, "marker": "x", "markersize": 5}
            handles.append(Line2D([], [], label="not finished", **look))
        axis.set(xlabel="decisions (thousands)", ylabel="training episodes that succeed (%)", ylim=(-2, 102))
        axis.set_xlim(left=0)
        figure.legend(handles=handles, loc="outside lower center", ncols=2 if len(handles) > 3 else 1)
        return figure


def _draw_row(axis: Axes, row: Row, colour: str, dashes: str) -> int:
    """Draw one combination; return how many finished runs its line is the mean of."""
    there = [(entry.state, curve) for entry in row.entries if (curve := _curve(entry.run))]
    finished = [curve for state, curve in there if state == "finished"]
    if finished:
        x, low, mean, high = mean_curve(finished)
        if len(finished) > 1:
            axis.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
        axis.plot(x, mean, color=colour, linestyle=dashes)
    for state, (x, y) in there:
        if state != "finished":
            axis.plot(x, y, color=colour, linestyle=dashes, linewidth=0.7)
            axis.plot(x[-1], y[-1], color=colour, marker="x", markersize=5)
    return len(finished)


def _curve(run: Run | None) -> Curve | None:
    """Return the curve of a run; None where no episode tells of success."""
    if run is None or run.metrics is None:
        return None
    x, y = run.metrics["decisions"] / 1000, smoothed(100 * run.metrics["success"])
    there = np.isfinite(y)
    return (x[there], y[there]) if there.any() else None


def mean_curve(curves: Sequence[Curve]) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x (m,), and low, mean and high (m,) of curves where all of them are.

    Between its points a curve is taken for straight; x are the points of the one with the fewest.
    """
    begin, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    fewest = min((x for x, _ in curves), key=len)
    x = np.unique([begin, *fewest[(fewest >= begin) & (fewest <= end)], max(begin, end)])
    values = np.array([np.interp(x, *curve) for curve in curves])
    mean = values.mean(axis=0)
    bounds = [seed_interval(each) or (each[0], each[0]) for each in values.T]
    low, high = np.clip(np.array(bounds).T, 0.0, 100.0)
    return x, low, mean, high
