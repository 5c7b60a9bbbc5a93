"""Means of several groups side by side: a panel a quantity, a line a group; shared by several figures."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, UNBOUNDED, Clusters
from hrl_comfort.analysis.tables import Quantity
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import column
from hrl_comfort.plots.style import BLUE, styled

WHO = ["train_seed", "episode", "spawn_id"]
"""Columns that tell which episode of which training seed a row is of."""
Means = Mapping[str, Any]
"""Quantity -> {"mean", "ci95"}."""


def pooled(runs: Sequence[Run]) -> DataFrame:
    """Return the episodes of several evaluations, one table."""
    return pd.concat([run.episodes for run in runs if run.episodes is not None], ignore_index=True)


def described(who: DataFrame, values: DataFrame, names: Sequence[str], shares: Collection[str] = ()) -> dict[str, Any]:
    """Return mean and 95 % interval of columns of values (n), whose rows are of the episodes `who` (n).

    NaN is left out; so is a column without a value. Intervals of `shares` stay within 0 and 1.
    """
    clusters = Clusters.of(who)
    bounds = {name: SHARE if name in shares else UNBOUNDED for name in names}
    estimates = {name: clusters.estimate(column(values, name), bounds=bounds[name]) for name in names}
    return {name: estimate for name, estimate in estimates.items() if estimate is not None}


def check_alike(groups: Mapping[str, Sequence[Run]], sections: Sequence[str]) -> None:
    """Raise ConfigError unless all evaluations agree in these sections of their configuration."""
    first, *others = [run for runs in groups.values() for run in runs]
    for run in others:
        for section in sections:
            if first.config.get(section) != run.config.get(section):
                raise ConfigError(f"{first.folder} and {run.folder} differ in {section}; compare like with like")


def check_paired(labels: tuple[str, str], mine: DataFrame, other: DataFrame) -> None:
    """Raise ConfigError unless two labels have the same episodes in the same order."""
    if not mine[WHO].equals(other[WHO]):
        raise ConfigError(f"labels={list(labels)}: both must have run the same episodes with the same seeds")


def draw(groups: Mapping[str, Means], quantities: Mapping[str, Quantity]) -> Figure:
    """Draw the means of groups with their 95 % intervals."""
    with styled():
        figure = Figure(figsize=(9.6, 0.9 + 0.3 * len(groups)), layout="constrained")
        axes = figure.subplots(1, len(quantities), sharey=True)
        for axis, (name, quantity) in zip(axes, quantities.items(), strict=True):
            for y, each in enumerate(groups.values()):
                if name not in each:
                    continue
                mean, interval = each[name]["mean"], each[name]["ci95"] or [each[name]["mean"]] * 2
                axis.plot(quantity.scale * np.array(interval), [y, y], color=BLUE)
                axis.plot(quantity.scale * mean, y, color=BLUE, marker="o", markersize=4)
            axis.set(xlabel=quantity.label)
            axis.grid(visible=False, axis="y")
        axes[0].set_yticks(range(len(groups)), labels=list(groups))
        axes[0].set_ylim(len(groups) - 0.5, -0.5)
        return figure
