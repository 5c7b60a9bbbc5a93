"""Means of several groups side by side: a panel a quantity, a line a group, with their table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hrl_comfort.analysis.clusters import Clusters
from hrl_comfort.analysis.intervals import Floats
from hrl_comfort.analysis.tables import cell
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.plots.figures import BLUE, STYLE


@dataclass(frozen=True)
class Quantity:
    """What is told of an episode: its name with the unit, a factor, and how many digits a table gives."""

    label: str
    scale: float = 1.0
    digits: int = 3


Means = Mapping[str, Any]
"""Quantity -> {"mean", "ci95"}."""


def described(clusters: Clusters, values: Floats, names: Sequence[str]) -> dict[str, Any]:
    """Return mean and 95 % interval of each column of values (n, K), by name.

    NaN is left out; so is a column without a value.
    """
    means, draws = clusters.means(values)
    return {
        name: {"mean": float(means[k]), "ci95": clusters.interval(draws[:, k])}
        for k, name in enumerate(names)
        if np.isfinite(means[k])
    }


def check_alike(groups: Mapping[str, Sequence[Run]], sections: Sequence[str]) -> None:
    """Raise ConfigError unless all evaluations agree in these sections of their configuration."""
    first, *others = [run for runs in groups.values() for run in runs]
    for run in others:
        for section in sections:
            if first.config.get(section) != run.config.get(section):
                raise ConfigError(f"{first.folder} and {run.folder} differ in {section}; compare like with like")


def check_paired(labels: tuple[str, str], mine: NDArray[Any], other: NDArray[Any]) -> None:
    """Raise ConfigError unless two labels have the same episodes (n, 3): seed, episode, spawn point."""
    if mine.shape != other.shape or (mine != other).any():
        raise ConfigError(f"labels={list(labels)}: both must have run the same episodes with the same seeds")


def draw(groups: Mapping[str, Means], quantities: Mapping[str, Quantity]) -> Figure:
    """Draw the means of groups with their 95 % intervals."""
    with matplotlib.rc_context(STYLE):
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


def cells(means: Means, quantities: Mapping[str, Quantity]) -> list[str]:
    """Return the cells of a table's line: each mean with its interval."""
    return [cell(means.get(name), "mean", each.scale, each.digits) for name, each in quantities.items()]


def markdown(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in [heads, ["---"] * len(heads), *lines])
