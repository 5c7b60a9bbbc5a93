"""The look of all figures, and the parts of axes that several of them draw.

Colours are Okabe and Ito's, which colour-blind readers tell apart.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from pandas import Series

from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.output import SIGNATURE
from hrl_comfort.files.tables import Floats

BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PURPLE, BLACK, GREY = "#E69F00", "#56B4E9", "#CC79A7", "#222222", "#777777"
CYCLE = (BLUE, VERMILLION, GREEN, SKY, PURPLE, ORANGE)
TRUNK_RADIUS_M = 0.13
OUTLINE = withStroke(linewidth=2, foreground="white")
"""Keeps text readable on lines."""
DPI = 200
SMOOTHED_FROM = 30
"""Rows of a log from which on its curves are smoothed."""
STYLE: dict[str, Any] = {
    "font.size": 9,
    "font.family": "sans-serif",
    "text.parse_math": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#e8e8e8",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "hrl-comfort",
}


def styled() -> Any:
    """Return the context in which figures are drawn and saved."""
    return matplotlib.rc_context(STYLE)


def save_png(figure: Figure, file: Path) -> None:
    """Write a figure as PNG in one step."""
    with styled():
        look: dict[str, Any] = {"dpi": DPI, "bbox_inches": "tight", "metadata": {"Software": SIGNATURE.decode()}}
        write_atomically(file, lambda out: figure.savefig(out, format="png", **look))


def data_uri(figure: Figure) -> str:
    """Return the figure as an SVG data URI: an image of its own, so its ids cannot meet another's."""
    out = io.BytesIO()
    with styled():
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def note(figure: Figure, text: str) -> None:
    """Write a small grey line under a figure."""
    figure.supxlabel(text, fontsize=7.5, color="#666666")


def smoothed(y: Floats) -> Floats:
    """Return the trailing mean (n,) of a logged quantity that is long enough to be noisy, or else it."""
    if len(y) <= SMOOTHED_FROM:
        return y
    return np.asarray(Series(y).rolling(max(3, len(y) // 25), min_periods=1).mean())


def curve(axis: Axes, x: Floats, y: Floats, colour: str, label: str | None = None) -> None:
    """Draw a logged quantity smoothed, over itself where that is something else."""
    if len(y) > SMOOTHED_FROM:
        axis.plot(x, y, color=colour, alpha=0.22, linewidth=0.7)
    axis.plot(x, smoothed(y), color=colour, label=label)


def band(axis: Axes, x: Floats, mean: Floats, low: Floats, high: Floats, colour: str, **line: Any) -> None:
    """Draw a mean and its interval, each (n,); a bound that is NaN is the mean."""
    if np.isfinite(low).any():
        bounds = (np.where(np.isnan(bound), mean, bound) for bound in (low, high))
        axis.fill_between(x, *bounds, color=colour, alpha=0.17, linewidth=0)
    axis.plot(x, mean, color=colour, **line)


def around(mean: Floats, low: Floats, high: Floats) -> Floats:
    """Return how far intervals reach below and above their means (2, n); 0 where a bound is NaN."""
    return np.nan_to_num(np.maximum(np.stack([mean - low, high - mean]), 0.0))


def points(axis: Axes, x: Any, mean: Floats, low: Floats, high: Floats, **look: Any) -> None:
    """Draw means (n,) joined by a line, with their intervals; a bound that is NaN is the mean."""
    style = {"marker": "o", "markersize": 4, "capsize": 2.5, **look}
    axis.errorbar(x, mean, around(mean, low, high), **style)


def of_estimates(estimates: Sequence[Mapping[str, Any]], scale: float = 1.0) -> Floats:
    """Return mean, low and high (3, n) of estimates, NaN where one has no interval."""
    rows = [(each["mean"], *(each["ci95"] or (np.nan, np.nan))) for each in estimates]
    return scale * np.array(rows, dtype=np.float64).reshape(-1, 3).T


def panels(columns: int, heights: Sequence[float], height: float) -> tuple[Figure, Any]:
    """Return a figure and its axes (rows, columns), which share x by column and y by row."""
    figure = Figure(figsize=(max(4.2, min(3.4 * columns, 10.2)), height))
    axes = figure.subplots(
        len(heights), columns, sharex="col", sharey="row", squeeze=False, height_ratios=list(heights)
    )
    return figure, axes
