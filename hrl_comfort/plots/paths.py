"""Figures of recorded paths: an overview from above and the side, and one walk at several levels or several walks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator, MultipleLocator
from matplotlib.transforms import ScaledTranslation
from pandas import DataFrame

from hrl_comfort.analysis.episodes import terminations
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError
from hrl_comfort.files.run_folder import Recorded, Run, recorded
from hrl_comfort.files.tables import Floats
from hrl_comfort.plots.cell import draw_from_above, draw_from_side, spots
from hrl_comfort.plots.style import BLACK, CYCLE, GREY, TRUNK_RADIUS_M, styled

LEVELS = (1, 4, 7, 10)
"""Drawn where none are asked for: those of the paper's figures."""
MARK_S = 0.5
"""Time between two dots on a path."""
PANEL_IN = 4.3
"""Width of a panel, inches; its height follows from what is drawn."""
UNDER_IN = 0.42
"""From a panel to its legend, inches: what the x axis takes."""
Runs = Mapping[str, tuple[Run, DataFrame]]
"""Evaluations by their name in the legend, each with its episodes; their index is the number of the episode."""
SHOWN = ("object", "seen", "comfort_level", "steps", "human_distance_mean_m")
"""Columns of episodes.csv that a figure shows where they are there."""


@dataclass(frozen=True)
class Track:
    """One episode as it is drawn."""

    name: str
    colour: Any
    path: DataFrame
    """Its rows of paths.csv."""
    row: Mapping[str, Any]
    """Its row of episodes.csv, with `ended`; in an overview, `success` alone."""


def _tool(axis: Axes, track: Track, up: str) -> None:
    """Draw a path of the tool over x, with its start, its end and marks in equal times."""
    x, y = track.path[["tcp_x", up]].to_numpy().T
    colour, success = track.colour, track.row["success"]
    marks = slice(None, None, round(MARK_S / CONTROL_STEP_S))
    axis.plot(x, y, color=colour, zorder=3)
    axis.plot(x[-1], y[-1], "o" if success else "X", color=colour, markersize=5 if success else 8, zorder=4)
    axis.plot(x[0], y[0], "o", color="white", markeredgecolor=colour, markersize=5, zorder=4)
    axis.plot(x[marks], y[marks], ".", color=colour, markersize=5, zorder=3)


def _walk(path: DataFrame) -> Floats:
    """Return the person's walk (steps + 1, 2), m; (0, 2) where nobody is there."""
    walk: Floats = path[["human_x", "human_y"]].to_numpy()
    there = np.isfinite(walk).all() and np.abs(walk).max() < FAR_AWAY_M / 2
    return walk if there else np.zeros((0, 2))


def overview(episodes: Sequence[Recorded], cell: Mapping[str, Any], precision: Mapping[str, float]) -> Figure:
    """Draw tool and human from above and from the side, and their horizontal distance over time.

    Args:
      episodes: what is drawn; one that did not succeed is marked with a cross.
      cell: `cell` of the run's configuration; empty when it is not known, then no goal is drawn.
      precision: `task.precision` of the run's configuration; empty when it is not known, then no tolerance is drawn.
    """
    tracks = [
        Track(str(each.episode), colour, each.path, {"success": each.row.get("success", True)})
        for colour, each in zip(CYCLE, episodes, strict=False)
    ]
    with styled():
        figure = Figure(figsize=(10.2, 5.0))
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15), height_ratios=(1.3, 1.0))
        top = figure.add_subplot(grid[:, 0])
        side, gap = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        _from_above(top, tracks, cell, precision)
        for track in tracks:
            _tool(side, track, "tcp_z")
            if len(walk := _walk(track.path)):
                side.axvline(float(walk[:, 0].mean()), color=track.colour, linewidth=5, alpha=0.2)
                gap.plot(track.path["step"] * CONTROL_STEP_S, track.path["human_distance_m"], color=track.colour)
        draw_from_side(side, spots(cell, precision))
        for axis in (top, side):
            axis.set_aspect("equal", adjustable="datalim", anchor="W")
        side.margins(0.08)
        side.xaxis.set_major_locator(MaxNLocator(6))
        top.set(title="Top view", xlabel="x (m)", ylabel="y (m)")
        side.set(title="Side view", xlabel="x (m)", ylabel="height z (m)")
        gap.set(title="Horizontal distance to human", xlabel="time (s)", ylabel="distance (m)")
        gap.set_ylim(bottom=0)
        if not gap.lines:
            gap.text(0.5, 0.5, "no human in these episodes", transform=gap.transAxes, ha="center", color="#666666")
        _legend(figure, 9, tracks, bool(precision and cell))
        return figure


def at_levels(runs: Sequence[Run], levels: Sequence[int], episodes: Sequence[int]) -> Figure:
    """Draw tool paths at some `levels` (default LEVELS) under one walk, a panel for each of `episodes`.

    Args:
      runs: evaluations that hold the levels together, recorded.
      levels: comfort levels; none is LEVELS.
      episodes: one or two; none is, of the first two kinds of object, the first that succeeds
        at all levels.
    """
    found: dict[str, tuple[Run, DataFrame]] = {}
    for level in levels or LEVELS:
        there = [(run, rows) for run in runs if len(rows := _at_level(run, level))]
        if not there:
            raise ConfigError(f"the evaluations hold no episode at level {level}; evaluate with levels=[...]")
        if len(there) > 1:
            raise ConfigError(f"episodes at level {level} are there twice; give one training seed")
        found[f"level {level}"] = there[0]
    return _draw(found, matplotlib.colormaps["viridis"](np.linspace(0.0, 0.87, len(found))), episodes)


def people(named: Mapping[str, Run], levels: Sequence[int], episodes: Sequence[int]) -> Figure:
    """Draw tool paths of one policy under different walks, a panel for each of `episodes` (as in `at_levels`).

    Args:
      named: one recorded evaluation a walk, by the name it has in the figure.
      levels: the level to draw, where evaluations hold several.
      episodes: one or two; none is, of the first two kinds of object, the first that succeeds under
        every walk.
    """
    found = {}
    for name, run in named.items():
        there = [None if pd.isna(level) else int(level) for level in _episodes(run)["comfort_level"].unique()]
        level = levels[0] if levels else there[0]
        if level not in there or (len(there) > 1 and not levels):
            raise ConfigError(f"{run.folder} holds the levels {', '.join(map(str, there))}; choose one: levels=[5]")
        found[name] = run, _at_level(run, level)
    return _draw(found, [CYCLE[i % len(CYCLE)] for i in range(len(found))], episodes)


def _episodes(run: Run) -> DataFrame:
    """Return the episodes of an evaluation with `ended`; what they lack of SHOWN is missing in every row."""
    assert run.episodes is not None, "the figure's evaluations have episodes"
    whole = run.episodes.reindex(columns=list(dict.fromkeys((*run.episodes, *SHOWN))))
    return whole.assign(ended=terminations(run.episodes))


def _at_level(run: Run, level: int | None) -> DataFrame:
    """Return the episodes of an evaluation at a level (None: without one), by episode, with `ended`."""
    rows = _episodes(run).set_index("episode", drop=False)
    levels = rows["comfort_level"]
    return rows[levels.isna() if level is None else levels.eq(level).fillna(False)]


def _chosen(found: Runs, episodes: Sequence[int]) -> list[int]:
    """Return the episodes to draw: those asked for, or the first successful ones of two kinds of object."""
    tables = [rows for _, rows in found.values()]
    common = [episode for episode in tables[0].index if all(episode in rows.index for rows in tables)]
    for index in episodes:
        if index not in common:
            raise ConfigError(f"episodes={list(episodes)}: {index} is not in {' and '.join(found)} alike")
    won = [episode for episode in common if all(rows.at[episode, "success"] for rows in tables)]
    if not episodes and not won:
        raise ConfigError(f"no episode succeeds in {' and '.join(found)} alike; choose with episodes=[0,1]")
    return list(episodes) or tables[0].loc[won].groupby("object", dropna=False)["episode"].first().tolist()[:2]


def _track(name: str, colour: Any, run: Run, row: Mapping[str, Any]) -> Track:
    """Return the recorded path of one episode, by its row of episodes.csv."""
    for each in recorded(run, episodes=(row["episode"],)):
        if pd.isna(row["comfort_level"]) or row["comfort_level"] == each.level:
            return Track(name, colour, each.path, row)
    raise ConfigError(f"{run.folder} has no paths.csv with episode {row['episode']}; evaluate with record=true")


def _draw(found: Runs, colours: Sequence[Any], episodes: Sequence[int]) -> Figure:
    """Draw a panel for each of the episodes, with a path for each evaluation in its colour."""
    chosen = _chosen(found, episodes)
    config = next(iter(found.values()))[0].config
    cell, precision = config.get("cell", {}), config.get("task", {}).get("precision", {})
    with styled():
        figure = Figure()
        axes = figure.subplots(1, len(chosen), squeeze=False, sharex=True, sharey=True)[0]
        every = []
        for axis, episode in zip(axes, chosen, strict=True):
            tracks = [
                _track(name, colour, run, rows.loc[episode].to_dict())
                for (name, (run, rows)), colour in zip(found.items(), colours, strict=True)
            ]
            _panel(axis, tracks, cell, precision)
            axis.set_aspect("equal", adjustable="box")
            every += tracks
        axes[0].set_ylabel("y (m)")
        (left, right), (low, high) = axes[0].get_xlim(), axes[0].get_ylim()
        height = min(PANEL_IN * (high - low) / (right - left), 2 * PANEL_IN)  # both axes have one scale
        figure.set_size_inches(0.5 + PANEL_IN * len(chosen), height + 1.7 + 0.17 * -(-len(found) // _columns(every)))
        _legend(figure, 5 * len(chosen), every, bool(precision and cell))
        return figure


def _legend(figure: Figure, columns: int, tracks: Sequence[Track], tolerances: bool) -> None:
    """Say under a figure what its lines and marks are, those that it has."""
    tool: dict[str, Any] = {"linestyle": "", "color": BLACK}
    person: dict[str, Any] = {"linestyle": "", "color": GREY, "marker": "o"}
    handles = [
        Line2D([], [], color=BLACK, label="tool"),
        Line2D([], [], marker="o", markerfacecolor="white", markersize=5, label="start", **tool),
        Line2D([], [], marker="o", markersize=5, label="success", **tool),
        Line2D([], [], marker="X", markersize=7, label="failure", **tool),
        Line2D([], [], marker=".", markersize=5, label=f"every {MARK_S:g} s", **tool),
    ]
    if tolerances:
        handles += [Line2D([], [], color=BLACK, linewidth=0.9, linestyle=":", label="tolerance")]
    if any(len(_walk(track.path)) for track in tracks):
        handles += [
            Line2D([], [], color=GREY, linewidth=0.9, label="person's walk"),
            Line2D([], [], markerfacecolor="white", markersize=9, label="at start", **person),
            Line2D([], [], alpha=0.4, markersize=10, label="at the end", **person),
        ]
    spaces: dict[str, Any] = {"handletextpad": 0.3, "columnspacing": 1.1}
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, **spaces)


def _from_above(
    axis: Axes,
    tracks: Sequence[Track],
    cell: Mapping[str, Any],
    precision: Mapping[str, float],
    kind: str | None = None,
) -> None:
    """Draw the cell, with an object of this kind, tools and walks from above, m in the cell's frame."""
    draw_from_above(axis, spots(cell, precision, kind))
    for track in tracks:
        _tool(axis, track, "tcp_y")
    for colour, walk in _walks(tracks):
        axis.plot(walk[:, 0], walk[:, 1], color=colour, linewidth=0.9, zorder=2)
        axis.add_patch(Circle(walk[0], TRUNK_RADIUS_M, fill=False, edgecolor=colour, linewidth=0.8, zorder=2))
        axis.add_patch(Circle(walk[-1], TRUNK_RADIUS_M, color=colour, alpha=0.3, linewidth=0, zorder=2))
    axis.xaxis.set_major_locator(MultipleLocator(0.4))
    axis.yaxis.set_major_locator(MultipleLocator(0.4))


def _panel(axis: Axes, tracks: Sequence[Track], cell: Mapping[str, Any], precision: Mapping[str, float]) -> None:
    """Draw one episode's paths from above, and what each came to."""
    first = tracks[0].row
    kind = None if pd.isna(first["object"]) else str(first["object"])
    _from_above(axis, tracks, cell, precision, kind)
    spawn = "drawn" if pd.isna(first["seen"]) else "seen" if first["seen"] else "unseen"
    title = f"{kind or 'object'}, episode {first['episode']} ({spawn} spawn)".capitalize()
    axis.set(title=title, xlabel="x (m)")
    axis.legend(
        handles=[Line2D([], [], color=track.colour, label=_words(track)) for track in tracks],
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=axis.transAxes + ScaledTranslation(0, -UNDER_IN, axis.figure.dpi_scale_trans),
        ncols=_columns(tracks),
        columnspacing=1.0,
        handlelength=1.4,
        title="mean distance to person, control steps",
        title_fontsize=7.5,
    )


def _columns(tracks: Iterable[Track]) -> int:
    """Return the columns of a panel's legend: one where it says how an episode failed."""
    return 2 if all(track.row["ended"] == "success" for track in tracks) else 1


def _words(track: Track) -> str:
    """Return the legend of a path."""
    distance, ended = track.row["human_distance_mean_m"], track.row["ended"]
    parts = [] if pd.isna(distance) else [f"{distance:.2f} m"]
    parts += [] if pd.isna(track.row["steps"]) else [f"{track.row['steps']} steps"]
    parts += [] if ended == "success" else [ended]
    return f"{track.name}: {', '.join(parts)}"


def _walks(tracks: Sequence[Track]) -> list[tuple[Any, Floats]]:
    """Return the person's walks (steps + 1, 2) and their colours: one in grey if it is the same in all.

    Nobody there, no walk. An episode that lasts longer shows more of the same walk.
    """
    walks = [(track.colour, walk) for track in tracks if len(walk := _walk(track.path))]
    longest = max((walk for _, walk in walks), key=len, default=np.zeros((0, 2)))
    same = walks and all(np.allclose(walk, longest[: len(walk)], atol=1e-4) for _, walk in walks)
    return [(GREY, longest)] if same else walks
