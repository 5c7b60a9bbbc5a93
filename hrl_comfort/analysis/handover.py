"""Handover diagnostics of one or several training seeds, from the tables of `evaluate handover`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.files.tables import column, read_table

STARTS = ["own", "previous", "expert"]
"""Starts of a subtask: its own in training, the terminal states of the policy before it, or of the expert."""
SEAMS, CHAIN = "handover_episodes.csv", "chain.csv"
EPISODE = ["train_seed", "episode", "spawn_id"]


def summarise(folders: Sequence[Path]) -> dict[str, Any]:
    """Return success of every subtask by start, also as a share of that from its own starts, and of chains.

    Args:
      folders: those of `evaluate handover`, one a training seed.

    Raises:
      ConfigError: a folder lacks a table of `evaluate handover`, or one is damaged or of other subtasks.
    """
    seams = pd.concat([_read(folder / SEAMS).assign(train_seed=seed) for seed, folder in enumerate(folders)])
    chains = pd.concat([_read(folder / CHAIN).assign(train_seed=seed) for seed, folder in enumerate(folders)])
    found: dict[str, Any] = {"seams": {}, "chain": []}
    for subtask, rows in seams.groupby("subtask", sort=False):
        wide = rows.pivot(index=EPISODE, columns="start", values="success").reindex(columns=STARTS)
        if wide.isna().any(axis=None) or rows["train_seed"].nunique() < len(folders):
            raise ConfigError(f"{folders[0] / SEAMS}: {subtask} has not the same episodes from every start and seed")
        clusters, own = Clusters.of(wide.index.to_frame(index=False)), column(wide, "own")
        means: dict[str, Any] = {**clusters.estimates(wide, dict.fromkeys(STARTS, SHARE))}
        for start in STARTS[1:] if own.any() else ():
            ratio = clusters.estimate(column(wide, start), own, statistic=lambda a, b: a / b)
            means[start]["of_own"] = ratio
        found["seams"][subtask] = means
    for length, rows in chains.groupby("options"):
        if len(rows) < len(folders):
            raise ConfigError(f"{folders[0]}: chains of other lengths do not go under the same label")
        seeds = rows["success"].tolist()
        found["chain"].append({"options": int(length), "success": sum(seeds) / len(seeds), "seeds": seeds})
    return found


def _read(path: Path) -> DataFrame:
    rows = read_table(path)
    if rows is None:
        raise ConfigError(f"{path} is not there or empty; kind=handover takes folders of evaluate handover")
    return rows


def table(numbers: Mapping[str, Any]) -> str:
    """Return the results of `summarise`, by label, as a Markdown table: a line a label and subtask."""
    lines = []
    for label, each in numbers.items():
        chain = ", ".join(f"{100 * at['success']:.1f}" for at in each["chain"])
        for name, at in each["seams"].items():
            shares = [cell(at[start], 100) for start in STARTS]
            lines.append([label, name, *shares, cell(at["previous"].get("of_own"), digits=3), chain])
    heads = ["", "subtask", *(f"from {start} starts, %" for start in STARTS), "previous / own"]
    return markdown([*heads, "1, 2, … options in a row, %"], lines)
