"""Handover diagnostics of one or several training seeds: as numbers, a table and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.files.tables import column, read_table
from hrl_comfort.plots.style import BLACK, CYCLE, styled

STARTS = ("own", "previous", "expert")
"""Starts of a subtask: its own in training, the terminal states of the policy before it, or of the expert."""
SEAMS, CHAIN = "handover_episodes.csv", "chain.csv"


def summarise(groups: Mapping[str, Sequence[Path]]) -> dict[str, Any]:
    """Return, for each label, success of every subtask by start, also as a share of the own one, and chains.

    A label's folders are those of `evaluate handover`, one a training seed.

    Raises:
      ConfigError: a folder lacks a table of `evaluate handover`, or one is damaged or of other subtasks.
    """
    return {label: _summary(folders) for label, folders in groups.items()}


def _summary(folders: Sequence[Path]) -> dict[str, Any]:
    seams, chains = ([_read(folder / name) for folder in folders] for name in (SEAMS, CHAIN))
    subtasks, *others = (list(rows["subtask"].unique()) for rows in seams)
    if any(each != subtasks for each in others) or len({len(rows) for rows in chains}) > 1:
        raise ConfigError(f"{folders[0]}: handovers of other subtasks do not go under the same label")
    whole = pd.concat([rows.assign(train_seed=seed) for seed, rows in enumerate(seams)])
    found: dict[str, Any] = {"seams": {name: _seam(folders, whole[whole["subtask"] == name]) for name in subtasks}}
    success = DataFrame([rows["success"].to_numpy() for rows in chains])
    found["chain"] = [
        {"options": int(length), "success": float(each.mean()), "seeds": each.tolist()}
        for length, (_, each) in zip(chains[0]["options"], success.items(), strict=True)
    ]
    return found


def _seam(folders: Sequence[Path], rows: DataFrame) -> dict[str, Any]:
    """Return success by start, and as a share of that from the own starts."""
    key = ["train_seed", "episode", "spawn_id"]
    wide = rows.pivot(index=key, columns="start", values="success")
    if not {*STARTS} <= {*wide} or wide[list(STARTS)].isna().any(axis=None):
        raise ConfigError(f"{folders[0] / SEAMS}: {rows['subtask'].iloc[0]} has not the same episodes from every start")
    clusters, own = Clusters.of(wide.index.to_frame(index=False)), column(wide, "own")
    means: dict[str, Any] = {start: clusters.estimate(column(wide, start), bounds=SHARE) for start in STARTS}
    if own.any():
        for start in STARTS[1:]:
            means[start]["of_own"] = clusters.estimate(column(wide, start), own, statistic=lambda a, b: a / b)
    return means


def _read(path: Path) -> DataFrame:
    rows = read_table(path)
    if rows is None:
        raise ConfigError(f"{path} is not there or empty; kind=handover takes folders of evaluate handover")
    return rows


def draw(numbers: Mapping[str, Any]) -> Figure:
    """Draw success by start, a panel a subtask, with 95 % intervals, and how far the chains get."""
    subtasks = list(dict.fromkeys(name for each in numbers.values() for name in each["seams"]))
    with styled():
        figure = Figure(figsize=(3.1 * (len(subtasks) + 1), 2.8))
        *seams, chain = figure.subplots(1, len(subtasks) + 1)
        for i, (label, each) in enumerate(numbers.items()):
            look: dict[str, Any] = {"color": (*CYCLE, BLACK)[i % 7], "marker": "o", "markersize": 4}
            for axis, name in zip(seams, subtasks, strict=True):
                for k, start in enumerate(STARTS if name in each["seams"] else ()):
                    at = each["seams"][name][start]
                    mean, (low, high) = at["mean"], at["ci95"] or [at["mean"]] * 2
                    x = k + 0.16 * (i - (len(numbers) - 1) / 2)
                    reach = [[max(0, 100 * (mean - low))], [max(0, 100 * (high - mean))]]
                    axis.errorbar([x], [100 * mean], reach, capsize=2, **look)
                axis.set(title=name, xlabel="starts", ylabel="success (%)")
                axis.set_xticks(range(len(STARTS)), labels=list(STARTS))
                axis.grid(visible=False, axis="x")
            lengths = [at["options"] for at in each["chain"]]
            for of_seed in zip(*(at["seeds"] for at in each["chain"]), strict=True):
                chain.plot(lengths, [100 * at for at in of_seed], color=look["color"], linewidth=0.6, alpha=0.6)
            chain.plot(lengths, [100 * at["success"] for at in each["chain"]], label=label, **look)
        chain.set(title="chain", xlabel="options in a row", ylabel="episodes that got so far (%)")
        chain.xaxis.set_major_locator(MaxNLocator(integer=True))
        chain.legend()
        return figure


def table(numbers: Mapping[str, Any]) -> str:
    """Return the result of `summarise` as a Markdown table: a line a label and subtask."""
    lines = []
    for label, each in numbers.items():
        chain = ", ".join(f"{100 * at['success']:.1f}" for at in each["chain"])
        for name, at in each["seams"].items():
            shares = [cell(at[start], 100) for start in STARTS]
            lines.append([label, name, *shares, cell(at["previous"].get("of_own"), digits=3), chain])
    heads = ["", "subtask", *(f"from {start} starts, %" for start in STARTS), "previous / own"]
    return markdown([*heads, "1, 2, … options in a row, %"], lines)
