"""How far chains of options get: in numbers, and as a figure."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hrl_comfort.analysis.intervals import wilson_interval
from hrl_comfort.config import ConfigError
from hrl_comfort.plots.figures import BLACK, CYCLE, STYLE, kind_of


def chain_lengths(
    episodes: Iterable[Hashable], options: Iterable[Mapping[str, Any]], least: int = 0
) -> list[dict[str, Any]]:
    """Return, for 1, 2, ... options in a row, the share of episodes in which so many succeeded.

    As far as any episode got, and at least to `least`. What takes the task no further does not count: waits,
    a pick whose ball was lost, and retreats, but for those that take the place of a return. What a retreat
    places on its way home does not count either, nor does the pick after it.
    """
    done = dict.fromkeys(episodes, 0)
    last: dict[Hashable, str] = {}
    for run in options:
        episode, kind = run["episode"], kind_of(run["option"])
        before = last.get(episode)
        if kind == "retreat" and before == "place":
            kind = "return"
        if run["termination"] != "success" or kind in ("wait", "retreat"):
            continue
        if (kind, before) != ("pick", "pick"):  # else the ball was lost, or placed on a way home
            done[episode] += 1
        last[episode] = kind
    lengths = np.array(list(done.values()))
    found = []
    for length in range(1, max(least, int(lengths.max(initial=0))) + 1):
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
            axis.errorbar(length, share, around, label=label, color=colour, marker="o", markersize=3.5, capsize=2)
        axis.set(xlabel="options in a row", ylabel="episodes that got so far (%)")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        if len(groups) > 1:
            axis.legend(frameon=False)
        return figure
