"""The learning curves of a sweep: a line a combination, a band over its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.learning_curve import LearningCurve
from hrl_comfort.analysis.sweeps import Row, Sweep
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import Floats, column
from hrl_comfort.plots.style import BLACK, CYCLE, band, smoothed, styled

LOOKS = [(colour, dashes) for dashes, colour in product(("-", "--", ":", "-."), CYCLE)]
"""Line styles; as many combinations are drawn."""
LONGEST = 80
"""Characters of a name that the legend has room for."""
Points = tuple[Floats, Floats]
"""Progress in thousands and the score, as it is drawn; both (n,)."""


def learning(sweep: Sweep) -> Figure | None:
    """Draw the curves of the first combinations, as many as can be told apart; None without any.

    A thick line is the mean of the finished runs, its band Student's 95 % interval over them, cut where
    the score cannot be. Thin lines are the single runs that are not finished, with a cross where each stands.
    """
    curve = sweep.curve
    if curve is None:
        return None
    drawn = [row for row in sweep.rows if any(_points(entry.run, curve) for entry in row.entries)]
    rows = drawn[: len(LOOKS)]
    if not rows:
        return None
    with styled():
        figure = Figure(figsize=(7.2, 4.0), layout="constrained")
        axis = figure.subplots()
        handles = []
        for row, (colour, dashes) in zip(rows, LOOKS, strict=False):
            finished = _draw_row(axis, row, curve, colour, dashes)
            name = row.name if len(row.name) <= LONGEST else row.name[:LONGEST] + "…"
            label = f"{name} (n = {finished})" if finished else f"{name} (none finished)"
            handles.append(Line2D([], [], color=colour, linestyle=dashes, label=label))
        entries = [entry for row in rows for entry in row.entries]
        if any(entry.state != "finished" and _points(entry.run, curve) for entry in entries):
            look = {"color": BLACK, "linewidth": 0.7, "marker": "x", "markersize": 5}
            handles.append(Line2D([], [], label="not finished", **look))
        axis.set(xlabel=f"{curve.progress.replace('_', ' ')} (thousands)", ylabel=curve.label)
        axis.set_xlim(left=0)
        if np.isfinite(curve.most):
            axis.set_ylim(curve.least - 2, curve.most + 2)
        figure.legend(handles=handles, loc="outside lower center", ncols=2 if len(handles) > 3 else 1)
        return figure


def _draw_row(axis: Axes, row: Row, curve: LearningCurve, colour: str, dashes: str) -> int:
    """Draw one combination; return how many finished runs its line is the mean of."""
    there = [(entry.state, points) for entry in row.entries if (points := _points(entry.run, curve))]
    finished = [points for state, points in there if state == "finished"]
    if finished:
        x, low, mean, high = mean_curve(finished, curve.least, curve.most)
        band(axis, x, mean, low, high, colour, linestyle=dashes)
    for state, (x, y) in there:
        if state != "finished":
            axis.plot(x, y, color=colour, linestyle=dashes, linewidth=0.7)
            axis.plot(x[-1], y[-1], color=colour, marker="x", markersize=5)
    return len(finished)


def _points(run: Run | None, curve: LearningCurve) -> Points | None:
    """Return the points of a run's curve; None where no episode tells anything."""
    if run is None or run.metrics is None:
        return None
    x = column(run.metrics, curve.progress) / 1000
    y = smoothed(curve.scale * column(run.metrics, curve.score))
    there = np.isfinite(y)
    return (x[there], y[there]) if there.any() else None


def mean_curve(curves: Sequence[Points], least: float, most: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x (m,), and low, mean and high (m,) of curves where all of them are, within [least, most].

    Between its points a curve is taken for straight; x are the points of the one with the fewest.
    """
    begin, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    fewest = min((x for x, _ in curves), key=len)
    x = np.unique([begin, *fewest[(fewest >= begin) & (fewest <= end)], max(begin, end)])
    values = np.array([np.interp(x, *curve) for curve in curves])
    mean, low, high = Clusters.of_runs(len(curves)).bands(values)
    return x, np.clip(low, least, most), mean, np.clip(high, least, most)
