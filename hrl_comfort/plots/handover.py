"""What handover diagnostics found, of one or several training seeds: as numbers, a table and a figure."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hrl_comfort.analysis.clusters import Clusters
from hrl_comfort.analysis.intervals import Row, column, number, read_rows
from hrl_comfort.analysis.tables import cell
from hrl_comfort.config import ConfigError
from hrl_comfort.plots import compare as panels
from hrl_comfort.plots.figures import BLACK, CYCLE, STYLE

STARTS = ("own", "previous", "expert")
"""Where a subtask takes over: its own starts in training, where the policy before it stops, or the expert."""
SEAMS, CHAIN = "handover_episodes.csv", "chain.csv"
NEEDED = {SEAMS: ("subtask", "start", "episode", "spawn_id", "success"), CHAIN: ("options", "success")}
"""What is read, and the columns that are needed."""


def summarise(groups: Mapping[str, Sequence[Path]]) -> dict[str, Any]:
    """Return, for each label, success of every subtask by start, also as a share of the own one, and chains.

    A label's folders are those of `evaluate handover`, one a training seed. Intervals are the bootstrap over
    seeds and, within them, spawn points.

    Raises:
      ConfigError: a folder lacks a table of `evaluate handover`, or one is damaged or of other subtasks.
    """
    return {label: _summary(folders) for label, folders in groups.items()}


def _summary(folders: Sequence[Path]) -> dict[str, Any]:
    seams, chains = ([_rows(folder / name) for folder in folders] for name in (SEAMS, CHAIN))
    subtasks, *others = [list(dict.fromkeys(row["subtask"] for row in rows)) for rows in seams]
    if any(each != subtasks for each in others) or len({len(rows) for rows in chains}) > 1:
        raise ConfigError(f"{folders[0]}: handovers of other subtasks do not go under the same label")
    found: dict[str, Any] = {"seams": {name: _seam(name, folders, seams) for name in subtasks}, "chain": []}
    for at in zip(*chains, strict=True):
        each = column(at, "success").tolist()
        mean = {"options": int(number(at[0]["options"])), "success": float(np.mean(each)), "seeds": each}
        found["chain"].append(mean)
    return found


def _seam(subtask: str, folders: Sequence[Path], seams: Sequence[Sequence[Row]]) -> dict[str, Any]:
    who, values = [], []
    for seed, (folder, rows) in enumerate(zip(folders, seams, strict=True)):
        wins = [
            {row["episode"]: row for row in rows if (row["subtask"], row["start"]) == (subtask, start)}
            for start in STARTS
        ]
        if not wins[0] or any(set(each) != set(wins[0]) for each in wins):
            raise ConfigError(f"{folder / SEAMS}: {subtask} has not the same episodes from every start")
        who += [(seed, row["spawn_id"]) for row in wins[0].values()]
        values += [[number(each[episode]["success"]) for each in wins] for episode in wins[0]]
    seed_of, spawn = (np.array(each) for each in zip(*who, strict=True))
    clusters, success = Clusters.nested(seed_of, spawn), np.array(values)
    means = panels.described(clusters, success, STARTS)
    whole, draws = clusters.means(success)
    if (draws[:, 0] > 0).all():  # a share of what may be nothing says nothing
        for k, start in enumerate(STARTS[1:], start=1):
            interval = clusters.interval(draws[:, k] / draws[:, 0])
            means[start]["of_own"] = {"mean": float(whole[k] / whole[0]), "ci95": interval}
    return means


def _rows(path: Path) -> list[Row]:
    if not path.is_file():
        raise ConfigError(f"{path} is not there; kind=handover takes folders of evaluate handover")
    try:
        rows = read_rows(path)
    except (ValueError, csv.Error) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    if not rows or any(row.get(name) is None for name in NEEDED[path.name] for row in rows):
        raise ConfigError(f"{path} is damaged: it lacks a line or one of {', '.join(NEEDED[path.name])}")
    return rows


def draw(numbers: Mapping[str, Any]) -> Figure:
    """Draw success by start, a panel a subtask, with 95 % intervals, and how far the chains get."""
    subtasks = list(dict.fromkeys(name for each in numbers.values() for name in each["seams"]))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.1 * (len(subtasks) + 1), 2.8))
        *seams, chain = figure.subplots(1, len(subtasks) + 1)
        for i, (label, each) in enumerate(numbers.items()):
            look: dict[str, Any] = {"color": (*CYCLE, BLACK)[i % 7], "marker": "o", "markersize": 4}
            for axis, name in zip(seams, subtasks, strict=True):
                for k, start in enumerate(STARTS if name in each["seams"] else ()):
                    at = each["seams"][name][start]
                    mean, (low, high) = at["mean"], at["ci95"] or [at["mean"]] * 2
                    x = k + 0.16 * (i - (len(numbers) - 1) / 2)
                    around = [[100 * (mean - low)], [100 * (high - mean)]]
                    axis.errorbar([x], [100 * mean], around, capsize=2, **look)
                axis.set(title=name, ylabel="success (%)")
                axis.set_xticks(range(len(STARTS)), labels=list(STARTS))
                axis.grid(visible=False, axis="x")
            lengths = [at["options"] for at in each["chain"]]
            for k in range(len(each["chain"][0]["seeds"])):
                of_seed = [100 * at["seeds"][k] for at in each["chain"]]
                chain.plot(lengths, of_seed, color=look["color"], linewidth=0.6, alpha=0.6)
            chain.plot(lengths, [100 * at["success"] for at in each["chain"]], label=label, **look)
        chain.set(title="chain", xlabel="options in a row", ylabel="episodes that got so far (%)")
        chain.xaxis.set_major_locator(MaxNLocator(integer=True))
        for axis in seams:
            axis.set_xlabel("starts")
        chain.legend()
        return figure


def table(numbers: Mapping[str, Any]) -> str:
    """Return what `summarise` found as a Markdown table: a line a label and subtask."""
    lines = []
    for label, each in numbers.items():
        chain = ", ".join(f"{100 * at['success']:.1f}" for at in each["chain"])
        for name, at in each["seams"].items():
            shares = [cell(at[start], "mean", 100, 1) for start in STARTS]
            lines.append([label, name, *shares, cell(at["previous"].get("of_own"), "mean", 1, 3), chain])
    heads = ["", "subtask", *(f"from {start} starts, %" for start in STARTS), "previous / own"]
    return panels.markdown([*heads, "1, 2, … options in a row, %"], lines)
