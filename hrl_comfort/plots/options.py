"""Figures of options: their timeline, and how far chains of them get."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from pandas import DataFrame

from hrl_comfort.analysis.episodes import PICK, kind_of
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.files.tables import column
from hrl_comfort.plots.style import BLACK, CYCLE, around, styled

SHOWN_TIMELINES = 12
"""Episodes of an option timeline, where none are named."""
KINDS = ("pick", "place", "return", "retreat", "wait")
"""Kinds of options, in the order of their colours; the same in every timeline."""
MARKS = {"failure": "X", "preempted": "D"}
"""Marks of options that did not succeed."""


def timeline(options: DataFrame, episodes: Sequence[int]) -> Figure:
    """Draw which option ran when, and how it ended; a bar an episode. A pick of one of several balls says which.

    Args:
      options: rows of options.csv.
      episodes: which episodes to draw, top to bottom.
    """
    options = options[options["episode"].isin(episodes)]
    kinds = options["option"].map(kind_of)
    names = list(dict.fromkeys([*KINDS, *kinds]))
    colours = dict(zip(names, CYCLE * (1 + len(names) // len(CYCLE)), strict=False))
    with styled():
        figure = Figure(figsize=(10.2, 1.3 + 0.24 * len(episodes)))
        axis = figure.subplots()
        for row, kind in zip(options.itertuples(), kinds, strict=True):
            y = episodes.index(row.episode)
            start, end = row.start_step * CONTROL_STEP_S, row.end_step * CONTROL_STEP_S
            axis.barh(y, end - start, left=start, height=0.68, color=colours[kind], edgecolor="white", linewidth=1)
            if picked := PICK.fullmatch(row.option):
                axis.text((start + end) / 2, y, picked[1], ha="center", va="center", color="white", size=7)
            if row.termination in MARKS:
                look = {"color": BLACK, "markeredgecolor": "white", "markersize": 9, "clip_on": False}
                axis.plot(end, y, MARKS[row.termination], **look)
        axis.set_yticks(range(len(episodes)), labels=[str(episode) for episode in episodes])
        axis.set_ylim(len(episodes) - 0.4, -0.6)
        axis.set(title="Option timeline", xlabel="time (s)", ylabel="episode")
        axis.grid(visible=False, axis="y")
        drawn = set(kinds)
        handles: list[Any] = [Patch(color=colours[name], label=name) for name in names if name in drawn]
        handles += [
            Line2D([], [], color=BLACK, marker=mark, linestyle="", label=label) for label, mark in MARKS.items()
        ]
        figure.legend(handles=handles, loc="outside right upper")
        return figure


def chain(groups: Mapping[str, list[dict[str, Any]]]) -> Figure:
    """Draw how many episodes get through so many options in a row, with 95 % intervals."""
    with styled():
        figure = Figure(figsize=(4.8, 3.0))
        axis = figure.subplots()
        for (label, found), colour in zip(groups.items(), (*CYCLE, BLACK) * len(groups), strict=False):
            if not found:
                raise ConfigError(f"{label}: no option succeeded in any episode, so there is nothing to draw")
            at = DataFrame(found)
            low, high = 100 * np.array([each or (np.nan, np.nan) for each in at["ci95"]]).T
            share = 100 * column(at, "success")
            reach = around(share, low, high)
            axis.errorbar(at["options"], share, reach, label=label, color=colour, marker="o", markersize=3.5, capsize=2)
        axis.set(xlabel="options in a row", ylabel="episodes that got so far (%)")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        if len(groups) > 1:
            axis.legend()
        return figure
