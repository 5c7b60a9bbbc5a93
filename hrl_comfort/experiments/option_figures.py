"""Figures of what controllers do: which option ran when, and how far chains get."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.experiments.figures import BLACK, BLUE, CYCLE, GREEN, ORANGE, PURPLE, SKY, STYLE, VERMILLION
from hrl_comfort.experiments.statistics import Row, number, wilson_interval

COLOURS = {"pick": BLUE, "place": ORANGE, "return": GREEN, "wait": SKY, "retreat": PURPLE}
PICK = re.compile(r"pick_(\d+)")
SHOWN = 8
"""Episodes of a timeline, where none are named."""


def timeline(name: str, options: Sequence[Row], episodes: Sequence[int]) -> Figure:
    """Draw which option ran when in some episodes of one evaluation; what did not succeed is hatched."""
    runs: dict[int, list[Row]] = {}
    for row in options:
        runs.setdefault(int(number(row["episode"])), []).append(row)
    chosen = list(episodes) or sorted(runs)[:SHOWN]
    missing = [episode for episode in chosen if episode not in runs]
    if missing:
        raise ConfigError(f"episodes={list(episodes)}: options.csv has no episode {missing[0]}")
    kinds: dict[str, str] = {}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 1.2 + 0.32 * len(chosen)))
        axis = figure.subplots()
        for line, episode in enumerate(chosen):
            for run in runs[episode]:
                picked = PICK.fullmatch(run["option"])
                kind = "pick" if picked else run["option"]
                start, end = (CONTROL_STEP_S * number(run[key]) for key in ("start_step", "end_step"))
                colour = kinds.setdefault(kind, COLOURS.get(kind, VERMILLION))
                hatch = "" if run["ending"] == "success" else "////"
                axis.barh(
                    line, end - start, left=start, color=colour, edgecolor="white", hatch=hatch, height=0.8
                )
                if picked:
                    axis.text(
                        (start + end) / 2, line, picked[1], ha="center", va="center", color="white", size=7
                    )
        axis.set(xlabel="time (s)", ylabel="episode", title=name)
        axis.set_yticks(range(len(chosen)), [str(episode) for episode in chosen])
        axis.invert_yaxis()
        marks = [Patch(color=colour, label=kind) for kind, colour in kinds.items()]
        marks.append(Patch(facecolor="#bbbbbb", edgecolor="white", hatch="////", label="not a success"))
        axis.legend(
            handles=marks,
            ncols=len(marks),
            loc="lower center",
            bbox_to_anchor=(0.5, -0.1 - 1.1 / len(chosen)),
            frameon=False,
        )
        return figure


def chain_lengths(episodes: Sequence[Row], options: Sequence[Row]) -> list[dict[str, Any]]:
    """Return, for 1, 2, ... options in a row, the share of episodes in which so many succeeded.

    Waits and retreats take the task no further and do not count, nor does a pick whose ball was lost.
    """
    done = {row["episode"]: 0 for row in episodes}
    held: set[str] = set()
    for run in options:
        episode, picks = run["episode"], run["option"] == "pick" or PICK.fullmatch(run["option"])
        if run["ending"] != "success" or run["option"] in ("wait", "retreat"):
            continue
        if not (picks and episode in held):  # else the ball was lost, and is picked again
            done[episode] += 1
        held = held | {episode} if picks else held - {episode}
    lengths = np.array(list(done.values()))
    found = []
    for length in range(1, int(lengths.max(initial=0)) + 1):
        wins = int((lengths >= length).sum())
        share = {"options": length, "success": wins / len(lengths)}
        found.append({**share, "ci95": list(wilson_interval(wins, len(lengths)))})
    return found


def chain(groups: Mapping[str, list[dict[str, Any]]]) -> Figure:
    """Draw how many episodes get through so many options in a row; bars are Wilson's 95 % intervals."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.8, 3.0))
        axis = figure.subplots()
        for (label, found), colour in zip(groups.items(), (*CYCLE, BLACK) * len(groups), strict=False):
            if not found:
                raise ConfigError(f"{label}: no option succeeded in any episode, so there is nothing to draw")
            length = np.array([at["options"] for at in found])
            share = 100 * np.array([at["success"] for at in found])
            low, high = 100 * np.array([at["ci95"] for at in found]).T
            around = np.abs(np.stack([share - low, high - share]))
            axis.errorbar(
                length, share, around, label=label, color=colour, marker="o", markersize=3.5, capsize=2
            )
        axis.set(xlabel="options in a row", ylabel="episodes that got so far (%)")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        if len(groups) > 1:
            axis.legend(frameon=False)
        return figure
