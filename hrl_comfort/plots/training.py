"""Figures of trainings: learning curves, diagnostics and checkpoints; a column a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pandas import DataFrame

from hrl_comfort.analysis.learning_curve import curve_of
from hrl_comfort.files.tables import Floats, column
from hrl_comfort.plots.style import BLACK, BLUE, GREEN, GREY, OUTLINE, PURPLE, VERMILLION, curve, panels, points, styled

DIAGNOSTICS = (("return", "return", BLUE), ("q_mean", "mean Q", GREEN), ("entropy", "entropy (nats)", PURPLE))
CONTROLLER = (("success", "success (share)", BLUE), ("steps", "steps", GREEN), ("return", "return", PURPLE))
"""Columns of a log, their labels and colours."""


def _thousands(table: DataFrame) -> Floats:
    return column(table, curve_of(table).progress) / 1000


def _stages(axes: Sequence[Axes], table: DataFrame) -> None:
    """Draw a line at every boundary of curriculum stages, with the name of each stage in the last axis."""
    if "stage" not in table or table["stage"].nunique() < 2:
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
        axes[-1].text(left, 0.04, f" {names[k]}", transform=across, **look)


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
        axes[0, 0].legend(loc="center right")
        return figure


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


def success_by_checkpoint(tables: Mapping[str, DataFrame]) -> Figure:
    """Draw success of every kept checkpoint by run, at one precision, with its 95 % interval."""
    with styled():
        figure, axes = panels(len(tables), (1,), 2.6)
        for axis, (name, table) in zip(axes[0], tables.items(), strict=True):
            share = (100 * column(table, each) for each in ("success", "success_low", "success_high"))
            points(axis, _thousands(table), *share, color=BLUE)
            at = f", {100 * table['precision_m'].iloc[0]:g} cm" if "precision_m" in table else ""
            axis.set(title=f"{name}{at}", xlabel="policy steps (thousands)", ylim=(-2, 102))
        axes[0, 0].set_ylabel("success (%)")
        return figure
