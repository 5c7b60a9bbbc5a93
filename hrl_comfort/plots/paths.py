"""Tool paths from above: one walk of the person at several levels, or several walks (as Figs. 4, 7, 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import ScaledTranslation

from hrl_comfort.analysis.intervals import Floats, Row, number
from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, ConfigError
from hrl_comfort.files.run_folder import Run, recorded_paths, termination
from hrl_comfort.plots.figures import BLACK, CYCLE, GOALS, STYLE, TRUNK_RADIUS_M
from hrl_comfort.plots.levels import OUTLINE

LEVELS = (1, 4, 7, 10)
"""Drawn where none are asked for: those of the paper's figures."""
MARK_S = 0.5
"""Time between two dots on a path."""
MARGIN_M = 0.06
LABEL_M = 0.03
"""Between a table's edge and the middle of its name."""
PANEL_IN = 4.3
"""Width of a panel, inches; its height follows from what is drawn, for both axes have one scale."""
UNDER_IN = 0.42
"""From a panel to its legend, inches: what the x axis takes."""
BASE_M = 0.15
"""Side of the square that stands for the robot's base, about as wide as a UR3e's."""
GREY = "#777777"

Runs = Mapping[str, Mapping[str, tuple[Run, Row]]]
"""What is compared, by its name in the legend; for each, its episodes by index."""


@dataclass(frozen=True)
class Track:
    """One episode as it is drawn."""

    name: str
    colour: Any
    path: Mapping[str, Floats]
    """Columns of paths.csv, (steps + 1,)."""
    row: Row
    """Its line of episodes.csv."""


def paths(runs: Sequence[Run], levels: Sequence[int], episodes: Sequence[int]) -> Figure:
    """Draw tool paths at some `levels` (default LEVELS) under one walk, a panel for each of `episodes`.

    Args:
      runs: evaluations that hold the levels together, recorded.
      levels: comfort levels; none is LEVELS.
      episodes: one or two; none is the first with an orange ball and the first with a pink one that succeed
        at all levels.
    """
    found: dict[str, dict[str, tuple[Run, Row]]] = {f"level {level}": {} for level in levels or LEVELS}
    for run in runs:
        for row in run.episodes or []:
            name = f"level {row.get('comfort_level')}"
            if name in found and found[name].setdefault(row["episode"], (run, row)) != (run, row):
                raise ConfigError(f"episode {row['episode']} at {name} is there twice; give one training seed")
    for name, there in found.items():
        if not there:
            raise ConfigError(f"the evaluations hold no episode at {name}; evaluate with levels=[...]")
    shades = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.87, len(found)))
    colours = dict(zip(found, shades, strict=True))
    return _draw(found, colours, _chosen(found, episodes))


def people(named: Mapping[str, Run], levels: Sequence[int], episodes: Sequence[int]) -> Figure:
    """Draw tool paths of one policy under different walks, a panel for each of `episodes` (as in `paths`).

    Args:
      named: one recorded evaluation a walk, by the name it has in the figure.
      levels: the level to draw, where evaluations hold several.
      episodes: one or two; none is the first orange and the first pink one that succeed under every walk.
    """
    found: dict[str, dict[str, tuple[Run, Row]]] = {}
    for name, run in named.items():
        rows = run.episodes or []
        there = list(dict.fromkeys(row.get("comfort_level") or "" for row in rows))
        level = str(levels[0]) if levels else there[0]
        if level not in there or (len(there) > 1 and not levels):
            raise ConfigError(f"{run.folder} holds the levels {', '.join(there)}; choose one: levels=[5]")
        found[name] = {row["episode"]: (run, row) for row in rows if (row.get("comfort_level") or "") == level}
    colours = {name: CYCLE[i % len(CYCLE)] for i, name in enumerate(found)}
    return _draw(found, colours, _chosen(found, episodes))


def _chosen(found: Runs, episodes: Sequence[int]) -> list[str]:
    """Return the episodes to draw: those asked for, or the first successful ones of each colour of ball."""
    common = [name for name in next(iter(found.values())) if all(name in there for there in found.values())]
    for index in episodes:
        if str(index) not in common:
            raise ConfigError(f"episodes={list(episodes)}: {index} is not in {' and '.join(found)} alike")
    if episodes:
        return [str(index) for index in episodes]
    won: dict[str, str] = {}
    for name in common:
        rows = [there[name][1] for there in found.values()]
        if all(number(row.get("success")) > 0 for row in rows):
            won.setdefault(rows[0].get("colour") or "", name)
    if not won:
        raise ConfigError(f"no episode succeeds in {' and '.join(found)} alike; choose with episodes=[0,1]")
    return [won[colour] for colour in sorted(won)]


def _tracks(found: Runs, colours: Mapping[str, Any], episode: str) -> list[Track]:
    """Return the recorded paths of one episode."""
    tracks = []
    for name, there in found.items():
        run, row = there[episode]
        level = row.get("comfort_level") or None
        recorded = recorded_paths(run, episodes=(episode,))
        path = next((path for key, path in recorded.items() if level in (None, key[1])), None)
        if path is None:
            raise ConfigError(f"{run.folder} has no paths.csv with episode {episode}; evaluate with record=true")
        tracks.append(Track(name, colours[name], path, row))
    return tracks


def _draw(found: Runs, colours: Mapping[str, Any], episodes: Sequence[str]) -> Figure:
    run = next(iter(next(iter(found.values())).values()))[0]
    panels = [_tracks(found, colours, episode) for episode in episodes]
    cell = run.config.get("cell", {})
    points = np.concatenate([_extent(tracks, cell) for tracks in panels])
    low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
    height = PANEL_IN * (high[1] - low[1]) / (high[0] - low[0])
    with matplotlib.rc_context(STYLE):
        legend_rows = -(-len(found) // 2)
        size = (0.5 + PANEL_IN * len(panels), min(height, 2 * PANEL_IN) + 1.7 + 0.17 * legend_rows)
        figure = Figure(figsize=size)
        axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
        for axis, tracks in zip(axes, panels, strict=True):
            _panel(axis, tracks, cell)
            axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x (m)")
            axis.set_aspect("equal", adjustable="box")
        axes[0].set_ylabel("y (m)")
        figure.legend(
            handles=_handles(),
            loc="outside lower center",
            ncols=4 * len(panels),
            handletextpad=0.3,
            columnspacing=1.1,
        )
        return figure


def _handles() -> list[Line2D]:
    """Return what the legend explains of the drawing itself."""
    tool: dict[str, Any] = {"linestyle": "", "color": BLACK}
    person: dict[str, Any] = {"linestyle": "", "color": GREY, "marker": "o"}
    return [
        Line2D([], [], color=BLACK, label="tool"),
        Line2D([], [], marker=".", markersize=5, label=f"every {MARK_S:g} s", **tool),
        Line2D([], [], marker="o", markerfacecolor="white", markersize=5, label="start", **tool),
        Line2D([], [], marker="o", markersize=5, label="success", **tool),
        Line2D([], [], marker="X", markersize=7, label="failure", **tool),
        Line2D([], [], color=GREY, linewidth=0.9, label="person's walk"),
        Line2D([], [], markerfacecolor="white", markersize=9, label="at start", **person),
        Line2D([], [], alpha=0.4, markersize=10, label="at the end", **person),
    ]


def _panel(axis: Axes, tracks: Sequence[Track], cell: Mapping[str, Any]) -> None:
    """Draw one episode's paths from above, m in the cell's frame."""
    first = tracks[0].row
    ball = first.get("colour") or "orange"
    _draw_cell(axis, cell, ball)
    for track in tracks:
        x, y = track.path["tcp_x"], track.path["tcp_y"]
        axis.plot(x, y, color=track.colour, label=_words(track), zorder=3)
        marks = slice(None, None, round(MARK_S / CONTROL_STEP_S))
        axis.plot(x[marks], y[marks], ".", color=track.colour, markersize=5, zorder=3)
        won = number(track.row.get("success")) > 0
        axis.plot(x[-1], y[-1], "o" if won else "X", color=track.colour, markersize=5 if won else 8, zorder=4)
        axis.plot(x[0], y[0], "o", color="white", markeredgecolor=track.colour, markersize=5, zorder=4)
    for colour, walk in _walks(tracks):
        axis.plot(walk[:, 0], walk[:, 1], color=colour, linewidth=0.9, zorder=2)
        axis.add_patch(Circle(walk[0], TRUNK_RADIUS_M, fill=False, edgecolor=colour, linewidth=0.8, zorder=2))
        axis.add_patch(Circle(walk[-1], TRUNK_RADIUS_M, color=colour, alpha=0.3, linewidth=0, zorder=2))
    axis.xaxis.set_major_locator(MultipleLocator(0.4))
    axis.yaxis.set_major_locator(MultipleLocator(0.4))
    seen_word = {1.0: "seen", 0.0: "unseen"}.get(number(first.get("seen")), "drawn")
    axis.set_title(f"{ball.capitalize()} ball, episode {first['episode']} ({seen_word} spawn)")
    axis.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=axis.transAxes + ScaledTranslation(0, -UNDER_IN, axis.figure.dpi_scale_trans),
        ncols=2,
        columnspacing=1.0,
        handlelength=1.4,
        title="mean distance to person, control steps",
        title_fontsize=7.5,
    )


def _extent(tracks: Sequence[Track], cell: Mapping[str, Any]) -> Floats:
    """Return points (n, 2), m, that span everything drawn of one episode."""
    half = cell.get("table_half_width_m", 0.0) + LABEL_M
    goals = np.array([[0.0, 0.0], *(cell[key][:2] for key in GOALS if key in cell)])
    tools = [np.stack([track.path["tcp_x"], track.path["tcp_y"]], axis=1) for track in tracks]
    walks = [walk + side for _, walk in _walks(tracks) for side in (-TRUNK_RADIUS_M, TRUNK_RADIUS_M)]
    return np.concatenate([goals - half, goals + half, *tools, *walks])


def _words(track: Track) -> str:
    """Return what the legend says of a path."""
    distance, steps = number(track.row.get("human_distance_mean_m")), number(track.row.get("steps"))
    parts = [f"{steps:.0f} steps"] if np.isnan(distance) else [f"{distance:.2f} m", f"{steps:.0f} steps"]
    how = termination(track.row)
    return f"{track.name}: {', '.join(parts if how == 'success' else [*parts, how])}"


def _walks(tracks: Sequence[Track]) -> list[tuple[Any, Floats]]:
    """Return the person's walks (steps + 1, 2) and their colours: one in grey if it is the same in all.

    Nobody there, no walk. An episode that lasts longer shows more of the same walk.
    """
    walks = []
    for track in tracks:
        walk = np.stack([track.path["human_x"], track.path["human_y"]], axis=1)
        if np.isfinite(walk).all() and np.abs(walk).max() < FAR_AWAY_M / 2:
            walks.append((track.colour, walk))
    if not walks:
        return []
    longest = max((walk for _, walk in walks), key=len)
    if all(np.allclose(walk, longest[: len(walk)], atol=1e-4) for _, walk in walks):
        return [(GREY, longest)]
    return walks


def _draw_cell(axis: Axes, cell: Mapping[str, Any], ball: str) -> None:
    """Draw base, tables, ball and drop points with their names."""
    shade: dict[str, Any] = {"facecolor": "#f0f0f0", "edgecolor": "#cccccc", "linewidth": 0.6, "zorder": 1}
    axis.add_patch(Rectangle((-BASE_M / 2, -BASE_M / 2), BASE_M, BASE_M, **{**shade, "facecolor": "#d9d9d9"}))
    labels = [("base", 0.0, 0.0)]
    half = cell.get("table_half_width_m", 0.0)
    for key, (label, colour) in GOALS.items():
        if key not in cell:
            continue
        x, y = cell[key][:2]
        own = GOALS[f"{ball}_drop_m"][1] if key == "ball_m" and f"{ball}_drop_m" in GOALS else colour
        axis.add_patch(Rectangle((x - half, y - half), 2 * half, 2 * half, **shade))
        axis.plot(x, y, "o" if key == "ball_m" else "D", color=own, markersize=7, markeredgecolor="white", zorder=5)
        # Paths to and from a place run on the robot's side of it.
        labels.append((label, x, y + (half + LABEL_M) * (1 if y > 0 else -1)))
    for label, x, y in labels:
        text = axis.text(x, y, label, fontsize=7, ha="center", va="center", color="#555555", zorder=2)
        text.set_path_effects([OUTLINE])
