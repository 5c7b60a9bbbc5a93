"""The report's figures: one function a figure, from arrays and rows to a matplotlib Figure.

Colours are Okabe and Ito's, told apart by colour-blind readers; axes carry their units; an interval
that is known is drawn.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import MaxNLocator

from hrl_comfort.analysis.intervals import Floats, Row
from hrl_comfort.analysis.learning_curve import curve_of
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.files.run_folder import Recorded

BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PURPLE, BLACK = "#E69F00", "#56B4E9", "#CC79A7", "#222222"
CYCLE = (BLUE, VERMILLION, GREEN, SKY, PURPLE, ORANGE)
TRUNK_RADIUS_M = 0.13
GOALS = {
    "ball_m": ("ball", BLACK),
    "orange_drop_m": ("orange drop", ORANGE),
    "pink_drop_m": ("pink drop", PURPLE),
}
"""Keys of the cell's configuration that are goals: their labels and colours."""
SHOWN_TIMELINES = 12
"""Episodes of an option timeline, where none are named."""
TOLD = r"(?:_as_\d+)?"
"""How the name of an option ends that is told a level of its own."""
PICK = re.compile(rf"pick_(\d+){TOLD}")
"""An option that picks one of several balls."""
STYLE: dict[str, Any] = {
    "font.size": 9,
    "font.family": "sans-serif",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#e8e8e8",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "hrl-comfort",
}


def data_uri(figure: Figure) -> str:
    """Return the figure as an SVG data URI: an image of its own, so its ids cannot meet another's."""
    out = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def _trailing_mean(values: Floats, window: int) -> Floats:
    """Return the mean (n,) of the last `window` values that are there, NaN where none is."""
    there = np.isfinite(values)
    total = np.cumsum(np.where(there, values, 0.0))
    count = np.cumsum(there.astype(float))
    total[window:] -= total[:-window].copy()
    count[window:] -= count[:-window].copy()
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _grid(columns: int, heights: Sequence[float], height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(max(4.2, min(3.4 * columns, 10.2)), height))
    axes = figure.subplots(
        len(heights), columns, sharex="col", sharey="row", squeeze=False, height_ratios=list(heights)
    )
    return figure, axes


def smoothed(y: Floats) -> Floats:
    """Return the trailing mean (n,) of a logged quantity that is long enough to be noisy, or else it."""
    return y if len(y) <= 30 else _trailing_mean(y, max(3, len(y) // 25))


def _curve(axis: Axes, x: Floats, y: Floats, colour: str, label: str | None = None) -> None:
    """Draw a logged quantity: smoothed, over itself where that is something else."""
    if len(y) > 30:
        axis.plot(x, y, color=colour, alpha=0.22, linewidth=0.7)
    axis.plot(x, smoothed(y), color=colour, label=label)


def _thousands(table: Mapping[str, Floats]) -> Floats:
    return table[curve_of(table).progress] / 1000


def learning_curves(tables: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Success and collisions over training, the curriculum's precision under them; a column a run.

    Args:
      tables: run name to the columns of its metrics.csv, each (n,).
    """
    with matplotlib.rc_context(STYLE):
        figure, axes = _grid(len(tables), (2.2, 1.0), 3.9)
        for i, (name, table) in enumerate(tables.items()):
            top, below = axes[0, i], axes[1, i]
            x = _thousands(table)
            _curve(top, x, 100 * table["success"], BLUE, "success")
            if "human_collision" in table:
                _curve(top, x, 100 * table["human_collision"], VERMILLION, "human collision")
            top.set(title=name, ylim=(-2, 102))
            if "precision_m" in table:
                below.step(x, 100 * table["precision_m"], where="post", color=BLACK)
                below.set_ylim(bottom=0)
            below.set_xlabel("policy steps (thousands)")
        axes[0, 0].set_ylabel("episodes (%)")
        axes[1, 0].set_ylabel("precision (cm)")
        axes[0, 0].legend(loc="center right")
        return figure


def training_diagnostics(tables: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Return, Q value and entropy over training; a column a run.

    Args:
      tables: run name to the columns of its metrics.csv, each (n,).
    """
    rows = (("return", "return", BLUE), ("q_mean", "mean Q", GREEN), ("entropy", "entropy (nats)", PURPLE))
    return _over_training(tables, rows)


def controller_curves(tables: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Share of successes, control steps and return over controllers' trainings; a column a run.

    Args:
      tables: run name to the columns of its meta_controller_metrics.csv, each (n,).
    """
    rows = (("success", "success (share)", BLUE), ("steps", "steps", GREEN), ("return", "return", PURPLE))
    return _over_training(tables, rows)


def _over_training(tables: Mapping[str, Mapping[str, Floats]], rows: Sequence[tuple[str, str, str]]) -> Figure:
    """Draw logged columns, each with its label and colour, one below the other; a column a run."""
    with matplotlib.rc_context(STYLE):
        figure, axes = _grid(len(tables), (1, 1, 1), 4.8)
        for i, (name, table) in enumerate(tables.items()):
            for row, (key, _, colour) in enumerate(rows):
                if key in table:
                    _curve(axes[row, i], _thousands(table), table[key], colour)
            axes[0, i].set_title(name)
            axes[-1, i].set_xlabel(f"{curve_of(table).progress.replace('_', ' ')} (thousands)")
        for row, (_, label, _) in enumerate(rows):
            axes[row, 0].set_ylabel(label)
        return figure


def success_by_checkpoint(tables: Mapping[str, Mapping[str, Floats]]) -> Figure:
    """Success of every kept checkpoint at one precision, with its 95 % interval; a column a run.

    Args:
      tables: run name to the columns of its eval/checkpoints.csv, each (n,).
    """
    with matplotlib.rc_context(STYLE):
        figure, axes = _grid(len(tables), (1,), 2.6)
        for axis, (name, table) in zip(axes[0], tables.items(), strict=True):
            x, y = _thousands(table), 100 * table["success"]
            if {"success_low", "success_high"} <= table.keys():
                around = [y - 100 * table["success_low"], 100 * table["success_high"] - y]
                axis.errorbar(x, y, np.maximum(around, 0), color=BLUE, marker="o", markersize=3.5, capsize=2.5)
            else:
                axis.plot(x, y, color=BLUE, marker="o", markersize=3.5)
            axis.set(title=name, xlabel="policy steps (thousands)", ylim=(-2, 102))
        axes[0, 0].set_ylabel("success (%)")
        return figure


def _wide(axis: Axes, low: Floats, high: Floats) -> None:
    """Give an axis of equal units at least the limits low..high (2,), m."""
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axis.set_aspect("equal", adjustable="box", anchor="W")
    axis.xaxis.set_major_locator(MaxNLocator(6))


def paths(
    episodes: Mapping[Recorded, Mapping[str, Floats]], ended: Mapping[Recorded, str], cell: Mapping[str, Any]
) -> Figure:
    """Top and side view of tool and human, and their horizontal distance over time.

    Args:
      episodes: episode to the columns of its rows in paths.csv, each (steps,), m.
      ended: episode to how it ended; anything but "success" is marked with a cross.
      cell: `cell` of the run's configuration; empty when it is not known, then no goal is drawn.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 5.0))
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15), height_ratios=(1.3, 1.0))
        top = figure.add_subplot(grid[:, 0])
        side, gap = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        seen_x, seen_y = [np.zeros(1)], [np.zeros(1)]
        any_human = False
        for colour, (episode, path) in zip(CYCLE, episodes.items(), strict=False):
            x, y, z = path["tcp_x"], path["tcp_y"], path["tcp_z"]
            success = ended.get(episode, "success") == "success"
            for axis, across, up in ((top, x, y), (side, x, z)):
                axis.plot(across, up, color=colour)
                axis.plot(across[0], up[0], "o", color="white", markeredgecolor=colour, markersize=5)
                axis.plot(across[-1], up[-1], "o" if success else "X", color=colour, markersize=5 if success else 7)
            seen_x.append(x)
            seen_y.append(y)
            near = np.abs(path["human_x"]) < 10  # someone who is not there stands far away
            if not near.any():
                continue
            any_human = True
            human_x, human_y = path["human_x"][near], path["human_y"][near]
            top.plot(human_x, human_y, color=colour, linewidth=0.8, alpha=0.8)
            top.add_patch(Circle((human_x[-1], human_y[-1]), TRUNK_RADIUS_M, color=colour, alpha=0.25, linewidth=0))
            side.axvline(float(human_x.mean()), color=colour, linewidth=5, alpha=0.2)
            seen_x.append(human_x)
            seen_y.append(human_y)
            gap.plot(path["step"][near] * CONTROL_STEP_S, path["human_distance_m"][near], color=colour)
        for key, (label, colour) in GOALS.items():
            if key in cell:
                gx, gy, gz = cell[key]
                top.plot(gx, gy, "D", color=colour, markersize=6, markeredgecolor="white", label=label)
                side.plot(gx, gz, "D", color=colour, markersize=6, markeredgecolor="white")
                seen_x.append(np.array([gx]))
                seen_y.append(np.array([gy]))
        top.plot(0, 0, "s", color="#777777", markersize=9, label="robot base")
        side.plot(0, 0, "s", color="#777777", markersize=9)
        all_x, all_y = np.concatenate(seen_x), np.concatenate(seen_y)
        margin = 0.2
        low = np.array([all_x.min() - margin, all_y.min() - margin])
        high = np.array([all_x.max() + margin, all_y.max() + margin])
        _wide(top, low, high)
        heights = np.concatenate([np.zeros(1), *(path["tcp_z"] for path in episodes.values())])
        _wide(side, np.array([low[0], heights.min() - 0.1]), np.array([high[0], heights.max() + 0.1]))
        top.set(title="Top view", xlabel="x (m)", ylabel="y (m)")
        side.set(title="Side view", xlabel="x (m)", ylabel="height z (m)")
        gap.set(title="Horizontal distance to human", xlabel="time (s)", ylabel="distance (m)")
        gap.set_ylim(bottom=0)
        if not any_human:
            gap.text(0.5, 0.5, "no human in these episodes", transform=gap.transAxes, ha="center", color="#666666")
        handles = [
            Line2D([], [], color=BLACK, label="tool"),
            Line2D([], [], color=BLACK, marker="o", markerfacecolor="white", linestyle="", label="start"),
            Line2D([], [], color=BLACK, marker="o", linestyle="", label="success"),
            Line2D([], [], color=BLACK, marker="X", linestyle="", label="failure"),
            Patch(color=BLACK, alpha=0.25, linewidth=0, label="human (at the end)"),
        ]
        known = top.get_legend_handles_labels()[0]
        figure.legend(
            handles=[*handles, *known],
            loc="outside lower center",
            ncols=9,
            handletextpad=0.4,
            columnspacing=1.2,
        )
        return figure


KINDS = ("pick", "place", "return", "retreat", "wait")
"""What options do, in the order of their colours: the same in every timeline."""


def kind_of(option: str) -> str:
    """Return what an option does: its name without the ball and the level it is told."""
    return "pick" if PICK.fullmatch(option) else re.sub(f"{TOLD}$", "", option)


def option_timeline(rows: Sequence[Row], episodes: Sequence[str]) -> Figure:
    """Which option ran when, and how it ended; a bar an episode. A pick of one of several balls says which.

    Args:
      rows: rows of options.csv.
      episodes: which episodes to draw, top to bottom.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 1.3 + 0.24 * len(episodes)))
        axis = figure.subplots()
        rows = [row for row in rows if row["episode"] in episodes]
        names = list(dict.fromkeys([*KINDS, *(kind_of(row["option"]) for row in rows)]))
        colours = dict(zip(names, CYCLE * (1 + len(names) // len(CYCLE)), strict=False))
        drawn = {kind_of(row["option"]) for row in rows}
        marks = {"failure": "X", "preempted": "D"}
        for row in rows:
            y = episodes.index(row["episode"])
            start, end = (int(float(row[key])) * CONTROL_STEP_S for key in ("start_step", "end_step"))
            colour = colours[kind_of(row["option"])]
            axis.barh(y, end - start, left=start, height=0.68, color=colour, edgecolor="white", linewidth=1)
            if picked := PICK.fullmatch(row["option"]):
                axis.text((start + end) / 2, y, picked[1], ha="center", va="center", color="white", size=7)
            if row["termination"] in marks:
                look = {"color": BLACK, "markeredgecolor": "white", "markersize": 9, "clip_on": False}
                axis.plot(end, y, marks[row["termination"]], **look)
        axis.set_yticks(range(len(episodes)), labels=list(episodes))
        axis.set_ylim(len(episodes) - 0.4, -0.6)
        axis.set(title="Option timeline", xlabel="time (s)", ylabel="episode")
        axis.grid(visible=False, axis="y")
        handles: list[Any] = [Patch(color=colours[name], label=name) for name in names if name in drawn]
        handles += [
            Line2D([], [], color=BLACK, marker=mark, linestyle="", label=label) for label, mark in marks.items()
        ]
        figure.legend(handles=handles, loc="outside right upper")
        return figure
