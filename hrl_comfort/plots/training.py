"""Figures of trainings: learning curves, diagnostics and checkpoints; a column a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, cycle
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from pandas import DataFrame

from hrl_comfort.analysis.learning_curve import curve_of
from hrl_comfort.analysis.option_use import shares_by_kind
from hrl_comfort.files.tables import Floats, column
from hrl_comfort.plots.hierarchy import colours_of
from hrl_comfort.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    OUTLINE,
    PURPLE,
    SMOOTHED_FROM,
    VERMILLION,
    curve,
    panels,
    points,
    styled,
)

DIAGNOSTICS = (("return", "return", BLUE), ("q_mean", "mean Q", GREEN), ("entropy", "entropy (nats)", PURPLE))
CONTROLLER = (("success", "success (share)", BLUE), ("steps", "steps", GREEN), ("return", "return", PURPLE))
"""Columns of a log, their labels and colours."""
LONGEST = 40
"""Characters of a stage's name that are drawn; a file may hold any number."""


def _thousands(table: DataFrame) -> Floats:
    return column(table, curve_of(table).progress) / 1000


def _several_stages(table: DataFrame) -> bool:
    return "stage" in table and bool(table["stage"].nunique() > 1)


def _stages(axes: Sequence[Axes], table: DataFrame) -> None:
    """Draw a line at every boundary of curriculum stages, with the name of each stage in the last axis."""
    if not _several_stages(table):
        return
    x, names = _thousands(table), table["stage"].fillna("").to_numpy()
    begins = np.flatnonzero(names[1:] != names[:-1]) + 1
    for axis in axes:
        for k in begins:
            axis.axvline(x[k - 1], color=GREY, linewidth=0.8, linestyle=":")
    for k in (0, *begins):
        across = axes[-1].get_xaxis_transform()
        left = x[k - 1] if k else 0.0
        look: dict[str, Any] = {"fontsize": 7, "color": GREY, "path_effects": [OUTLINE]}
        axes[-1].text(left, 0.04, f" {names[k]}"[: LONGEST + 1], transform=across, **look)


def learning_curves(tables: Mapping[str, DataFrame]) -> Figure:
    """Draw success and contacts over training by run, and under them the curriculum's precision."""
    with styled():
        figure, axes = panels(len(tables), (2.2, 1.0), 3.9)
        for (name, table), (top, below) in zip(tables.items(), axes.T, strict=True):
            x = _thousands(table)
            curve(top, x, 100 * column(table, "success"), BLUE, "success")
            if "contact" in table:
                curve(top, x, 100 * column(table, "contact"), VERMILLION, "contact")
            top.set(title=name, ylim=(-2, 102))
            if "precision_m" in table:
                below.step(x, 100 * column(table, "precision_m"), where="post", color=BLACK)
                below.set_ylim(bottom=0)
            below.set_xlabel("policy steps (thousands)")
            _stages((top, below), table)
        axes[0, 0].set_ylabel("episodes (%)")
        axes[1, 0].set_ylabel("precision (cm)")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
        return figure


def notes(tables: Iterable[DataFrame]) -> str:
    """Return what a caption says of lines that not every figure of logs has."""
    tables = list(tables)
    smooth = "Thin lines are logged values, thick ones trailing means. "
    stages = "Dotted lines separate curriculum stages."
    return smooth * any(len(each) > SMOOTHED_FROM for each in tables) + stages * any(map(_several_stages, tables))


def over_training(tables: Mapping[str, DataFrame], rows: Sequence[tuple[str, str, str]]) -> Figure:
    """Draw columns of logs by run, one below the other; `rows` are their names, labels and colours."""
    with styled():
        figure, axes = panels(len(tables), (1,) * len(rows), 1.6 * len(rows))
        for (name, table), below in zip(tables.items(), axes.T, strict=True):
            for axis, (key, _, colour) in zip(below, rows, strict=True):
                if key in table:
                    curve(axis, _thousands(table), column(table, key), colour)
            below[0].set_title(name)
            below[-1].set_xlabel(f"{curve_of(table).progress.replace('_', ' ')} (thousands)")
            _stages(below, table)
        for axis, (_, label, _) in zip(axes[:, 0], rows, strict=True):
            axis.set_ylabel(label)
        return figure


def option_shares(tables: Mapping[str, DataFrame]) -> Figure:
    """Draw by run the share of time of each kind of option, columns share/NAME of its log, over its training."""
    shares = {name: shares_by_kind(table) for name, table in tables.items()}
    colours = colours_of(kind for each in shares.values() for kind in each)
    with styled():
        figure, axes = panels(len(tables), (1,), 2.4)
        for (name, each), axis in zip(shares.items(), axes[0], strict=True):
            x = _thousands(tables[name])
            bounds = np.concatenate([[0.0], x])
            below = np.zeros_like(x)
            for kind, share in each.items():
                axis.stairs(below + 100 * share, bounds, baseline=below, fill=True, color=colours[kind])
                below = below + 100 * share
            axis.set(title=name, xlabel="options (thousands)", ylim=(0, 100), xlim=(0, x[-1]))
        axes[0, 0].set_ylabel("time in the option (%)")
        drawn = dict.fromkeys(kind for kind in colours if any(kind in each for each in shares.values()))
        figure.legend(handles=[Patch(color=colours[kind], label=kind) for kind in drawn], loc="outside right upper")
        return figure


def checkpoint_notes(tables: Iterable[DataFrame]) -> str:
    """Return what a caption says of levels and of chains, whose last columns are the policy steps of their parts."""
    tables = list(tables)
    levels = "Levels are drawn a little beside each other. "
    chain = "Policy steps of a chain are those of all its parts, each at the same fraction of its training."
    several = any(len(np.unique(column(each, "comfort_level"))) > 1 for each in tables)
    return levels * several + chain * any(each.columns[-1] != "unsafe_contact_high" for each in tables)


def by_checkpoint(tables: Mapping[str, DataFrame]) -> Figure:
    """Draw success, and below it unsafe contacts, of every checkpoint: a column an evaluation, a line a level."""
    levels = np.unique(np.concatenate([column(table, "comfort_level") for table in tables.values()]))
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.87, len(levels))) if len(levels) > 1 else [BLUE]
    looks = dict(zip(levels, zip(colours, cycle("osD^v<>pXh"), strict=False), strict=True))
    shares = {"success": "success (%)", "unsafe_contact": "unsafe\ncontact (%)"}
    with styled():
        figure, axes = panels(len(tables), (2.2, 1.0), 4.2)
        for (name, table), below in zip(tables.items(), axes.T, strict=True):
            for level, (colour, marker) in looks.items():
                rows = table[np.isclose(column(table, "comfort_level"), level, equal_nan=True)]
                aside = 0.01 * _thousands(table).max() * (list(looks).index(level) - (len(looks) - 1) / 2)
                for axis, share in zip(below, shares, strict=True):
                    estimates = (100 * column(rows, f"{share}{end}") for end in ("", "_low", "_high"))
                    points(axis, _thousands(rows) + aside, *estimates, color=colour, marker=marker, linewidth=1.2)
            below[0].set_title(name)
            below[1].set_xlabel("policy steps (thousands)")
        for axis, label, least in zip(axes[:, 0], shares.values(), (100, 10), strict=True):
            most = max(least, axis.get_ylim()[1])
            axis.set(ylabel=label, ylim=(-0.04 * most, 1.04 * most))
        if len(levels) > 1:
            names = ["no level" if np.isnan(level) else f"level {level:g}" for level in levels]
            lines = [Line2D([], [], color=colour, marker=marker, markersize=4) for colour, marker in looks.values()]
            figure.legend(lines, names, loc="outside upper right", ncols=5)
        return figure


def checkpoint_grid(table: DataFrame, parts: Sequence[str]) -> Figure:
    """Draw the success of every combination of two parts' checkpoints, the mean over all else: a panel a pair of parts.

    Args:
      table: rows of grid.csv.
      parts: its columns of parts with several checkpoints.
    """
    pairs = [*combinations(parts, 2)]
    with styled():
        figure = Figure(figsize=(1.0 + 3.1 * len(pairs), 3.0))
        axes = figure.subplots(1, len(pairs), squeeze=False)[0]
        for axis, (below, beside) in zip(axes, pairs, strict=True):
            means = 100 * table.pivot_table(values="success", index=beside, columns=below)
            image = axis.imshow(means, origin="lower", vmin=0, vmax=100, cmap="viridis", aspect="auto")
            for (y, x), share in np.ndenumerate(means.to_numpy()):
                axis.text(x, y, f"{share:.0f}", ha="center", va="center", size=7, path_effects=[OUTLINE])
            for ticks, steps in (axis.set_xticks, means.columns), (axis.set_yticks, means.index):
                ticks(range(len(steps)), labels=[f"{each / 1000:g}" for each in steps])
            axis.set(xlabel=f"{below} (thousand policy steps)", ylabel=f"{beside} (thousand policy steps)")
            axis.grid(visible=False)
        figure.colorbar(image, ax=axes.tolist(), label="success (%)")
        return figure
