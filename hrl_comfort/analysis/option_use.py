"""Use of options: how much of the time each of them runs and when, how long it lasts, and why it ends."""

from __future__ import annotations

from typing import Any

import numpy as np
from pandas import DataFrame, Series

from hrl_comfort.analysis.episodes import kind_of
from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.files.tables import Floats, column

KINDS = ("pick", "place", "return", "retreat", "wait")
"""Kinds of options, in the order in which they are shown; those of a user's own table come after them."""
SHARE_OF = "share/"
"""Beginning of the names of columns of a training's log."""
INTERVALS = 40
"""Equal parts of the longest episode over which the use of options is told."""


def with_kinds(options: DataFrame) -> DataFrame:
    """Return rows of options.csv with `kind`, the option without object and level, and `duration_s`."""
    lasted = column(options, "end_step") - column(options, "start_step")
    return options.assign(kind=options["option"].map(kind_of), duration_s=lasted * CONTROL_STEP_S)


def kinds_of(options: DataFrame) -> list[str]:
    """Return the kinds among rows of `with_kinds`, in the order in which they are shown."""
    there = options["kind"].unique().tolist()
    return [*(kind for kind in KINDS if kind in there), *(kind for kind in there if kind not in KINDS)]


def over_time(options: DataFrame) -> tuple[Floats, dict[str, Floats]]:
    """Return the bounds of INTERVALS (T + 1,), s, and by kind the share of episodes in it, the mean over each (T,).

    An episode that is over counts as in no option. `options` are rows of `with_kinds`.
    """
    start, end = (column(options, name) * CONTROL_STEP_S for name in ("start_step", "end_step"))
    bounds = np.linspace(0.0, max(end.max(), CONTROL_STEP_S), INTERVALS + 1)
    spent = np.minimum(end[:, None], bounds[1:]) - np.maximum(start[:, None], bounds[:-1])
    shares = spent.clip(min=0.0) / (options["episode"].nunique() * (bounds[1] - bounds[0]))
    of = {kind: shares[(options["kind"] == kind).to_numpy()].sum(axis=0) for kind in kinds_of(options)}
    return bounds, of


def shares_by_kind(metrics: DataFrame) -> dict[str, Floats]:
    """Return by kind the share of time (T,) of options over a training, columns share/NAME of its log."""
    found: dict[str, Floats] = {}
    for name in metrics:
        if str(name).startswith(SHARE_OF):
            kind, share = kind_of(str(name).removeprefix(SHARE_OF)), np.nan_to_num(column(metrics, str(name)))
            found[kind] = found.get(kind, 0.0) + share
    return {kind: found[kind] for kind in sorted(found, key=lambda kind: [*KINDS, kind].index(kind))}


def summarise(episodes: DataFrame, options: DataFrame) -> dict[str, Any]:
    """Return, by kind, the number of runs, the share of time, quartiles of the duration, causes, and the mean regret.

    Args:
      episodes: rows of episodes.csv.
      options: rows of `with_kinds` of these episodes.
    """
    clusters, found = Clusters.of(episodes), {}
    total = options.groupby("episode")["duration_s"].sum().reindex(episodes["episode"])
    for kind in kinds_of(options):
        runs = options[options["kind"] == kind]
        spent = runs.groupby("episode")["duration_s"].sum().reindex(episodes["episode"], fill_value=0.0)
        share = clusters.estimate((spent / total).to_numpy(), bounds=SHARE)
        found[kind] = {
            "runs": len(runs),
            "time_share": share,
            "duration_s": dict(zip(("low", "median", "high"), _quartiles(runs["duration_s"]), strict=True)),
            "causes": runs["cause"].value_counts().to_dict(),
        }
        judged = column(runs, "regret")
        if np.isfinite(judged).any():
            found[kind]["regret"] = float(np.nanmean(judged))
    return found


def _quartiles(values: Series) -> list[float]:
    return [round(float(each), 6) for each in np.quantile(values.to_numpy(dtype=np.float64), (0.25, 0.5, 0.75))]


def table(numbers: dict[str, Any]) -> str:
    """Return results of `summarise`, by label, as a Markdown table: a line a label and kind of option."""
    told = any("regret" in at for each in numbers.values() for at in each.values())
    lines = []
    for label, each in numbers.items():
        for kind, at in each.items():
            lasts, causes = at["duration_s"], ", ".join(f"{cause} {count}" for cause, count in at["causes"].items())
            line = [label, kind, str(at["runs"]), cell(at["time_share"], 100)]
            line.append(f"{lasts['median']:.1f} [{lasts['low']:.1f}, {lasts['high']:.1f}]")
            lines.append([*line, causes, *([cell(at.get("regret"), digits=3)] if told else [])])
    heads = ["", "option", "runs", "time, %", "duration, s: median [quartiles]", "ends"]
    return markdown([*heads, *(["mean regret"] if told else [])], lines)
