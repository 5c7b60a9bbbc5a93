"""Figures of the hierarchy: timelines of options, lengths of chains, handovers, groups of evaluations side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from pandas import DataFrame

from hrl_comfort.analysis.comparison import QUANTITIES
from hrl_comfort.analysis.episodes import PICK, kind_of
from hrl_comfort.analysis.handover import STARTS
from hrl_comfort.analysis.option_use import KINDS
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.plots.style import BLACK, BLUE, CYCLE, around, of_estimates, points, styled

SHOWN_TIMELINES = 12
"""Episodes of an option timeline, where none are named."""
MARKS = {"failure": "X", "preempted": "D", "interrupted": "s"}
"""Marks of options that did not succeed."""


def timeline(options: DataFrame, episodes: Sequence[int] = ()) -> Figure:
    """Draw which option ran when, and how it ended; a bar an episode. A pick of one of several objects says which.

    Args:
      options: rows of options.csv.
      episodes: which episodes to draw, top to bottom; none are the first SHOWN_TIMELINES.

    Raises:
      ConfigError: an episode is not among the rows.
    """
    there = options["episode"].unique().tolist()
    episodes = list(episodes) or there[:SHOWN_TIMELINES]
    if missing := set(episodes) - set(there):
        raise ConfigError(f"episodes={episodes}: options.csv has no episode {min(missing)}")
    options = options[options["episode"].isin(episodes)]
    kinds = options["option"].map(kind_of)
    colours = colours_of(kinds)
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
        handles: list[Any] = [Patch(color=colour, label=name) for name, colour in colours.items() if name in drawn]
        mark: dict[str, Any] = {"color": BLACK, "linestyle": ""}
        ends = set(options["termination"])
        handles += [Line2D([], [], marker=marker, label=end, **mark) for end, marker in MARKS.items() if end in ends]
        figure.legend(handles=handles, loc="outside right upper")
        return figure


def colours_of(kinds: Iterable[str]) -> dict[str, str]:
    """Return the colour of each kind of option; those of KINDS have the same in every figure."""
    return dict(zip(dict.fromkeys([*KINDS, *kinds]), cycle(CYCLE), strict=False))


def chain(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Draw how many episodes get through so many options in a row, with 95 % intervals."""
    for label, found in groups.items():
        if not found:
            raise ConfigError(f"{label}: no option succeeded in any episode, so there is nothing to draw")
    with styled():
        figure = Figure(figsize=(4.8, 3.0))
        _chains(figure.subplots(), groups)
        return figure


def _chains(axis: Axes, groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Draw `success` over `options` by label, with the interval `ci95` and a thin line for each of `seeds`, if any."""
    for (label, found), colour in zip(groups.items(), cycle((*CYCLE, BLACK)), strict=False):
        lengths = [at["options"] for at in found]
        for of_seed in zip(*(at.get("seeds", ()) for at in found), strict=True):
            axis.plot(lengths, [100 * share for share in of_seed], color=colour, linewidth=0.6, alpha=0.6)
        estimates = [{"mean": at["success"], "ci95": at.get("ci95")} for at in found]
        points(axis, lengths, *of_estimates(estimates, 100), label=label, color=colour)
    axis.set(xlabel="options in a row", ylabel="episodes that got so far (%)")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(groups) > 1:
        axis.legend()


def handover(numbers: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw success by start, a panel a subtask, with 95 % intervals, and how far the chains get.

    Args:
      numbers: results of `analysis.handover.summarise` by label.
    """
    subtasks = list(dict.fromkeys(name for each in numbers.values() for name in each["seams"]))
    with styled():
        figure = Figure(figsize=(3.1 * (len(subtasks) + 1), 2.8))
        *seams, last = figure.subplots(1, len(subtasks) + 1)
        for axis, name in zip(seams, subtasks, strict=True):
            for i, ((_, each), colour) in enumerate(zip(numbers.items(), cycle((*CYCLE, BLACK)), strict=False)):
                if name in each["seams"]:
                    at = of_estimates([each["seams"][name][start] for start in STARTS], 100)
                    x = [k + 0.16 * (i - (len(numbers) - 1) / 2) for k in range(len(STARTS))]
                    points(axis, x, *at, color=colour, linestyle="")
            axis.set(title=name, xlabel="starts", ylabel="success (%)")
            axis.set_xticks(range(len(STARTS)), labels=STARTS)
            axis.grid(visible=False, axis="x")
        _chains(last, {label: each["chain"] for label, each in numbers.items()})
        last.set_title("chain")
        return figure


def comparison(groups: Mapping[str, Mapping[str, Any]], names: Sequence[str]) -> Figure:
    """Draw the means of groups side by side with their 95 % intervals: a panel for each of `names`, a line a group."""
    with styled():
        figure = Figure(figsize=(9.6, 0.9 + 0.3 * len(groups)), layout="constrained")
        axes = figure.subplots(1, len(names), sharey=True)
        for axis, name in zip(axes, names, strict=True):
            there = [y for y, each in enumerate(groups.values()) if name in each]
            estimates = [each[name] for each in groups.values() if name in each]
            mean, low, high = of_estimates(estimates, QUANTITIES[name].scale)
            axis.errorbar(mean, there, xerr=around(mean, low, high), color=BLUE, fmt="o", markersize=4)
            axis.set(xlabel=QUANTITIES[name].label)
            axis.grid(visible=False, axis="y")
        axes[0].set_yticks(range(len(groups)), labels=list(groups))
        axes[0].set_ylim(len(groups) - 0.5, -0.5)
        return figure
