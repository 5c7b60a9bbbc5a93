"""The learning curves of a sweep: success against decisions, a line a combination, a band over its seeds.

Of controllers it is return against options: their skills succeed from the beginning, and what is learnt is
when to run which.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hrl_comfort.experiments.figures import BLACK, CYCLE, STYLE, smoothed
from hrl_comfort.experiments.run_folder import Run, counted
from hrl_comfort.experiments.statistics import Floats, seed_interval
from hrl_comfort.experiments.sweep_table import Row

LOOKS = [(colour, dashes) for dashes, colour in product(("-", "--", ":", "-."), CYCLE)]
"""How lines are told apart; so many can be drawn."""
Curve = tuple[Floats, Floats]
"""Decisions in thousands and success in %, or options in thousands and return; both (n,)."""
SHARE = (0.0, 100.0)


def learning(rows: Sequence[Row]) -> Figure | None:
    """Draw the curves of the first combinations, as many as can be told apart; None without any.

    A thick line is the mean of the finished runs, its band Student's 95 % interval over them, cut where
    success cannot be. Thin lines are the single runs that are not finished, with a cross where each stands.
    """
    rows = [row for row in rows if any(_curve(entry.run) for entry in row.entries)][: len(LOOKS)]
    if not rows:
        return None
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.0), layout="constrained")
        axis = figure.subplots()
        handles = []
        runs = (entry.run for row in rows for entry in row.entries)
        made = next(counted(run.metrics) for run in runs if run is not None and run.metrics is not None)
        bounds = SHARE if made == "decisions" else (-np.inf, np.inf)
        for row, (colour, dashes) in zip(rows, LOOKS, strict=False):
            finished = _draw_row(axis, row, colour, dashes, bounds)
            label = f"{row.name} (n = {finished})" if finished else f"{row.name} (none finished)"
            handles.append(Line2D([], [], color=colour, linestyle=dashes, label=label))
        if any(entry.state != "finished" and _curve(entry.run) for row in rows for entry in row.entries):
            look = {"color": BLACK, "linewidth": 0.7, "marker": "x", "markersize": 5}
            handles.append(Line2D([], [], label="not finished", **look))
        axis.set_xlabel(f"{made} (thousands)")
        axis.set_xlim(left=0)
        if made == "decisions":
            axis.set(ylabel="training episodes that succeed (%)", ylim=(-2, 102))
        else:
            axis.set_ylabel("mean return of training episodes")
        figure.legend(handles=handles, loc="outside lower center", ncols=2 if len(handles) > 3 else 1)
        return figure


def _draw_row(axis: Axes, row: Row, colour: str, dashes: str, bounds: tuple[float, float]) -> int:
    """Draw one combination; return how many finished runs its line is the mean of."""
    there = [(entry.state, curve) for entry in row.entries if (curve := _curve(entry.run))]
    finished = [curve for state, curve in there if state == "finished"]
    if finished:
        x, low, mean, high = mean_curve(finished, bounds)
        if len(finished) > 1:
            axis.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
        axis.plot(x, mean, color=colour, linestyle=dashes)
    for state, (x, y) in there:
        if state != "finished":
            axis.plot(x, y, color=colour, linestyle=dashes, linewidth=0.7)
            axis.plot(x[-1], y[-1], color=colour, marker="x", markersize=5)
    return len(finished)


def _curve(run: Run | None) -> Curve | None:
    """Return the curve of a run; None where no episode tells anything."""
    if run is None or run.metrics is None:
        return None
    made = counted(run.metrics)
    y = smoothed(100 * run.metrics["success"] if made == "decisions" else run.metrics["return"])
    x = run.metrics[made] / 1000
    there = np.isfinite(y)
    return (x[there], y[there]) if there.any() else None


def mean_curve(curves: Sequence[Curve], bounds: tuple[float, float]) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x (m,), and low, mean and high (m,) of curves where all of them are; low and high in `bounds`.

    Between its points a curve is taken for straight; x are the points of the one with the fewest.
    """
    begin, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    fewest = min((x for x, _ in curves), key=len)
    x = np.unique([begin, *fewest[(fewest >= begin) & (fewest <= end)], max(begin, end)])
    values = np.array([np.interp(x, *curve) for curve in curves])
    mean = values.mean(axis=0)
    intervals = [seed_interval(each) or (each[0], each[0]) for each in values.T]
    low, high = np.clip(np.array(intervals).T, *bounds)
    return x, low, mean, high
