"""A run folder as the report reads it: what is there, and None for what is not."""

from __future__ import annotations

import csv
import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hrl_comfort.analysis.intervals import Floats, Row, column, number, read_rows
from hrl_comfort.analysis.learning_curve import CURVES
from hrl_comfort.config import ConfigError

ORDER = ("pick", "place", "return", "pick_place", "cycle")
"""Runs appear in the order of the work, then by name."""
TERMINATIONS = (
    "success",
    "robot hit human",
    "human walked into still robot",
    "hit table",
    "self-collision",
    "time limit",
)


Recorded = tuple[str, str]
"""A recorded episode: its index, and the comfort level that it began with (empty without one)."""


@dataclass(frozen=True)
class Run:
    """What a run folder holds; None where the file is not there."""

    name: str
    folder: Path
    configs: dict[str, str]
    """Text of the config.yaml of training and of evaluation, where there is one."""
    config: dict[str, Any]
    """What was evaluated, or else trained; empty when no config.yaml says."""
    provenance: dict[str, Any] | None
    metrics: dict[str, Floats] | None
    """Columns of what its training logged: see `learning_curve`."""
    minutes: float | None
    groups: list[dict[str, Any]] | None
    episodes: list[Row] | None
    checkpoints: dict[str, Floats] | None
    options: list[Row] | None
    paths: Path | None


NEEDED = {
    "metrics.csv": ("policy_steps", "episodes", "success", "return", "steps", "precision_m"),
    "meta_controller_metrics.csv": ("options", "episodes", "success", "placed", "return", "steps"),
    "timing.csv": ("seconds",),
    "episodes.csv": ("episode", "success"),
    "checkpoints.csv": ("policy_steps", "success"),
    "options.csv": ("episode", "option", "termination", "start_step", "end_step"),
    "paths.csv": ("episode", "step", "tcp_x", "tcp_y", "tcp_z", "human_x", "human_y", "human_distance_m"),
}
"""Columns that the report cannot do without."""


def _rows(path: Path) -> list[Row] | None:
    """Return the rows of a table, None where there is none; raise ConfigError where it is damaged."""
    if not path.is_file():
        return None
    try:
        rows = read_rows(path)
    except (ValueError, csv.Error) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    for name in NEEDED[path.name]:
        if any(row.get(name) is None for row in rows):
            raise ConfigError(f"{path} is damaged: it lacks the column {name}, or a line is cut short")
    return rows


def _table(path: Path) -> dict[str, Floats] | None:
    rows = _rows(path)
    return {name: column(rows, name) for name in rows[0] if name != "stage"} if rows else None


def _logged(folder: Path) -> dict[str, Floats] | None:
    tables = (_table(folder / curve.file) for curve in CURVES)
    return next((table for table in tables if table is not None), None)


def _minutes(folder: Path, provenance: dict[str, Any] | None) -> float | None:
    """Return how long a training took; of a controller's its provenance tells, once it is finished."""
    timing = _table(folder / "timing.csv")
    if timing is not None:
        return float(timing["seconds"][-1]) / 60
    if provenance is None or not provenance.get("finished") or "wall_seconds" not in provenance:
        return None
    seconds = provenance["wall_seconds"]
    if not isinstance(seconds, int | float):
        raise ConfigError(f"{folder / 'provenance.json'} is damaged: wall_seconds={seconds!r} is no number")
    return seconds / 60


def _json(path: Path, needed: str) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
    if needed not in found:
        raise ConfigError(f"{path} is damaged: it lacks {needed!r}")
    return found


def _config(path: Path) -> tuple[str, dict[str, Any]]:
    try:
        text = path.read_text(encoding="utf-8")
        return text, dict(yaml.safe_load(text))
    except (ValueError, TypeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} is damaged: {' '.join(str(error).split())}") from error


def read_run(folder: Path) -> Run:
    """Read a run folder with its `eval/`, or a folder that an evaluation alone has written.

    Raises:
      ConfigError: a file in it is damaged.
    """
    evaluation = folder / "eval" if (folder / "eval").is_dir() else folder
    files = {"training": folder / "config.yaml", "evaluation": evaluation / "config.yaml"}
    if evaluation == folder:
        del files["training" if (folder / "episodes.csv").is_file() else "evaluation"]
    read = {name: _config(file) for name, file in files.items() if file.is_file()}
    provenance = _json(folder / "provenance.json", "commit")
    summary = _json(evaluation / "summary.json", "groups")
    paths = evaluation / "paths.csv"
    return Run(
        name=folder.resolve().name,
        folder=folder,
        configs={name: text for name, (text, _) in read.items()},
        config=list(read.values())[-1][1] if read else {},
        provenance=provenance,
        metrics=_logged(folder),
        minutes=_minutes(folder, provenance),
        groups=None if summary is None else summary["groups"],
        episodes=_rows(evaluation / "episodes.csv"),
        checkpoints=_table(evaluation / "checkpoints.csv"),
        options=_rows(evaluation / "options.csv"),
        paths=paths if paths.is_file() else None,
    )


def find_runs(folder: Path) -> list[Run]:
    """Return the run that `folder` is, or the runs in it.

    Raises:
      ConfigError: there is none.
    """

    def is_run(path: Path) -> bool:
        logs = (curve.file for curve in CURVES)
        marks = (*logs, "episodes.csv", "eval/episodes.csv", "eval/summary.json", "config.yaml")
        return any((path / mark).is_file() for mark in marks)

    if not folder.is_dir():
        raise ConfigError(f"run={str(folder)!r} is not a folder")
    if is_run(folder):
        return [read_run(folder)]
    inside = [path for path in folder.iterdir() if path.is_dir() and is_run(path)]
    if not inside:
        raise ConfigError(f"run={str(folder)!r} holds no run: neither config.yaml nor eval/episodes.csv is in it")
    place = {name: i for i, name in enumerate(ORDER)}
    inside.sort(key=lambda path: (place.get(path.name, len(ORDER)), path.name))
    return [read_run(path) for path in inside]


def termination(row: Row) -> str:
    """Return how an episode ended, in words."""
    if number(row.get("success")) > 0:
        return "success"
    if number(row.get("human_collision")) > 0:
        moving = number(row.get("robot_moving_at_collision"))
        return "human walked into still robot" if moving == 0 else "robot hit human"
    other = row.get("other_collision") or "none"
    if other != "none":
        return {"table": "hit table", "self": "self-collision"}.get(other, other)
    return "time limit" if number(row.get("truncated")) > 0 else "other"


def recorded_paths(
    run: Run, count: int | None = None, episodes: Collection[str] | None = None
) -> dict[Recorded, dict[str, Floats]]:
    """Return the columns of recorded episodes by episode and level; none when not recorded.

    An evaluation at several levels records an episode once at each, one level after the other. What is
    returned is the first `count` of them, if given, and of `episodes` alone, if given.
    """
    if run.paths is None:
        return {}
    kept: dict[Recorded, list[Row]] = {}
    current: dict[str, Recorded] = {}
    with run.paths.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if any(row.get(name) in (None, "") for name in NEEDED["paths.csv"]):
                raise ConfigError(f"{run.paths} is damaged: it lacks a column, or a line is cut short")
            episode = row["episode"]
            if episode not in current or row["step"] == "0":  # there it begins, or begins anew
                current[episode] = (episode, row.get("level") or "")
            if episodes is not None and episode not in episodes:
                continue
            if current[episode] in kept or count is None or len(kept) < count:
                kept.setdefault(current[episode], []).append(row)
    tables = {key: {name: column(rows, name) for name in rows[0]} for key, rows in kept.items()}
    return {key: _ordered(table) for key, table in tables.items()}


def row_of(run: Run, recorded: Recorded) -> Row:
    """Return the row of episodes.csv that a recorded episode belongs to; empty when there is none."""
    episode, level = recorded
    rows = [row for row in run.episodes or [] if row["episode"] == episode]
    # A level that changes within the episode is none of the episode's own.
    return next((row for row in rows if (row.get("comfort_level") or level) == level), {})


def _ordered(table: dict[str, Floats]) -> dict[str, Floats]:
    order = np.argsort(table["step"], kind="stable")
    return {name: values[order] for name, values in table.items()}
