"""Figure of the use of options: when each of them runs, how long, and why it ends; a row an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from pandas import DataFrame

from hrl_comfort.analysis.option_use import kinds_of, over_time
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.plots.hierarchy import colours_of
from hrl_comfort.plots.style import BLACK, ORANGE, VERMILLION, styled

CAUSES: dict[str, dict[str, str]] = {
    "done": {"facecolor": "#dddddd"},
    "time limit": {"facecolor": "#888888"},
    "episode over": {"facecolor": "white", "hatch": "...."},
    "object lost": {"facecolor": "white", "hatch": "/////"},
    "interrupted": {"facecolor": "white", "hatch": "-----"},
    "contact": {"facecolor": ORANGE},
    "unsafe contact": {"facecolor": VERMILLION, "hatch": "xxxx"},
    "hit table": {"facecolor": BLACK},
    "self-collision": {"facecolor": "#888888", "hatch": r"\\\\\\"},
    "other failure": {"facecolor": "white", "hatch": "||||"},
}
"""Looks of the causes, from the left of a bar to its right; all differ without colour."""
WHISKERS = (5, 95)
"""Percentiles of the durations."""
EDGE: dict[str, Any] = {"edgecolor": "#444444", "linewidth": 0.6}


def option_use(evaluations: Mapping[str, DataFrame]) -> Figure:
    """Draw the options of evaluations by label, rows of `with_kinds`."""
    every = pd.concat(evaluations.values())
    kinds = kinds_of(every)
    colours = colours_of(kinds)
    with styled():
        height = max(1.5, 0.62 + 0.24 * len(kinds))
        figure = Figure(figsize=(10.2, 0.8 + (height + 0.5) * len(evaluations)))
        axes = figure.subplots(len(evaluations), 3, squeeze=False, sharex="col", width_ratios=(1.25, 1, 1))
        most = 0.0
        for (label, options), (when, lasts, ends) in zip(evaluations.items(), axes, strict=True):
            _draw_time(when, options, colours)
            most = max(most, _draw_durations(lasts, options, kinds, colours))
            _draw_causes(ends, options, kinds)
            when.set(title=label, ylabel="episodes (%)")
        for axis, text in zip(axes[-1], ("time (s)", "duration of a run (s)", "runs that end so (%)"), strict=True):
            axis.set_xlabel(text)
        axes[-1, 0].set_xlim(0, CONTROL_STEP_S * every["end_step"].max())
        axes[-1, 1].set_xlim(0, 1.02 * most)
        for axis, text in zip(axes[0, 1:], ("durations", "causes of their ends"), strict=True):
            axis.set_title(text)
        there = {cause for options in evaluations.values() for cause in options["cause"]}
        patches = [Patch(**look, **EDGE, label=cause) for cause, look in CAUSES.items() if cause in there]
        options_key = [Patch(color=colours[kind], label=kind) for kind in kinds]
        figure.legend(handles=options_key, loc="outside upper left", ncols=6, title="option")
        figure.legend(handles=patches, loc="outside upper right", ncols=5, title="cause")
        return figure


def _draw_time(axis: Axes, options: DataFrame, colours: Mapping[str, str]) -> None:
    """Draw by time in how many episodes each kind of option runs; what is left white is over."""
    bounds, shares = over_time(options)
    below = 0.0 * bounds[1:]
    for kind, share in shares.items():
        axis.stairs(below + 100 * share, bounds, baseline=below, fill=True, color=colours[kind])
        below = below + 100 * share
    axis.set_ylim(0, 100)


def _draw_durations(axis: Axes, options: DataFrame, kinds: list[str], colours: Mapping[str, str]) -> float:
    """Draw the quartiles of the durations of each kind, whiskers between percentiles; return how far they reach, s."""
    most = 0.0
    for y, kind in enumerate(kinds):
        lasted = options.loc[options["kind"] == kind, "duration_s"].to_numpy()
        if len(lasted):
            axis.boxplot(
                lasted, positions=[y], orientation="horizontal", widths=0.62, whis=WHISKERS, patch_artist=True,
                showfliers=False, boxprops={"facecolor": colours[kind], "linewidth": 0.8},
                medianprops={"color": BLACK, "linewidth": 1.6},
            )  # fmt: skip
            most = max(most, float(np.percentile(lasted, WHISKERS[1])))
    _name(axis, kinds)
    return most


def _draw_causes(axis: Axes, options: DataFrame, kinds: list[str]) -> None:
    """Draw the share of the runs of each kind that ended by each cause, and their number."""
    for y, kind in enumerate(kinds):
        causes = options.loc[options["kind"] == kind, "cause"]
        left = 0.0
        for cause, look in CAUSES.items():
            share = 100 * float((causes == cause).mean()) if len(causes) else 0.0
            axis.barh(y, share, left=left, height=0.68, **look, **EDGE)
            left += share
        axis.text(102, y, f"n = {len(causes)}", va="center", size=7.5)
    axis.set_xlim(0, 100)
    _name(axis, kinds)


def _name(axis: Axes, kinds: list[str]) -> None:
    axis.set_yticks(range(len(kinds)), labels=kinds)
    axis.set_ylim(len(kinds) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
