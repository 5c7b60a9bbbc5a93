"""A run folder: what is in it, and None for what is not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pandas import DataFrame

from hrl_comfort.config.checks import ConfigError
from hrl_comfort.config.constants import HIERARCHY
from hrl_comfort.files.documents import Summary, read_config, read_json
from hrl_comfort.files.provenance import Provenance, read_provenance, unfinished
from hrl_comfort.files.tables import read_table

ORDER = ("pick", "place", "return", "pick_place", "cycle")
"""Runs appear in the order of the work, then by name."""
LOGS = ("metrics.csv", "meta_controller_metrics.csv")
"""Logs of a training: of a policy and of a meta-controller."""
EVALUATED = ("episodes.csv", "episodes.parquet", "checkpoints.csv")
"""A folder that holds one of these files is an evaluation."""
CHAIN = "cycle"
"""Folder of the chain in that of a hierarchy."""


@dataclass(frozen=True)
class Run:
    """The content of a run folder; None where a file is not there."""

    name: str
    folder: Path
    configs: dict[str, str] = field(default_factory=dict)
    """Text of the config.yaml of training and of evaluation, where there is one."""
    evaluation: Path | None = None
    """Folder of the evaluation."""
    config: dict[str, Any] = field(default_factory=dict)
    """Configuration of the evaluation, or else of the training; empty without a config.yaml."""
    provenance: Provenance | None = None
    unfinished: str | None = None
    """Progress of the training in words; None if it is finished."""
    metrics: DataFrame | None = None
    minutes: float | None = None
    """Duration of the training."""
    groups: list[dict[str, Any]] | None = None
    """Groups of summary.json."""
    episodes: DataFrame | None = None
    checkpoints: DataFrame | None = None
    options: DataFrame | None = None
    paths: Path | None = None


def evaluations(folder: Path) -> list[Path]:
    """Return the evaluations in the folder of a run: `eval`, `eval_validation` and so on."""
    return sorted(path for path in folder.glob("eval*") if is_evaluation(path))


def is_evaluation(folder: Path) -> bool:
    """Return whether an evaluation was written to `folder`."""
    return any((folder / name).is_file() for name in EVALUATED)


def read_run(folder: Path) -> Run:
    """Read a run folder with the first of its evaluations, or a folder that an evaluation alone has written.

    Raises:
      ConfigError: a file in it is damaged.
    """
    evaluation = next(iter(evaluations(folder)), folder)
    episodes = read_table(evaluation / "episodes.csv")
    files = {"training": folder / "config.yaml", "evaluation": evaluation / "config.yaml"}
    if evaluation == folder:
        del files["training" if is_evaluation(folder) else "evaluation"]
    configs = {name: read_config(file) for name, file in files.items() if file.is_file()}
    provenance = read_provenance(folder) if (folder / "provenance.json").is_file() else None
    summary = evaluation / "summary.json"
    paths = evaluation / "paths.csv"
    logs = (read_table(folder / name) for name in LOGS)
    return Run(
        name=folder.resolve().name,
        folder=folder,
        configs={name: text for name, (text, _) in configs.items()},
        evaluation=evaluation if is_evaluation(evaluation) else None,
        config=list(configs.values())[-1][1] if configs else {},
        provenance=provenance,
        unfinished=unfinished(folder),
        metrics=next((log for log in logs if log is not None), None),
        minutes=_minutes(folder, provenance),
        groups=read_json(summary, Summary).model_dump()["groups"] if summary.is_file() else None,
        episodes=episodes,
        checkpoints=read_table(evaluation / "checkpoints.csv"),
        options=read_table(evaluation / "options.csv"),
        paths=paths if paths.is_file() else None,
    )


def read_result(folder: Path) -> Run:
    """Read a run folder, of a hierarchy the evaluation of its chain with the duration and state of the hierarchy.

    Raises:
      ConfigError: a file in it is damaged.
    """
    run = read_run(folder)
    if not (folder / HIERARCHY).is_file():
        return run
    chain = read_run(folder / CHAIN)
    told = {name: getattr(chain, name) for name in ("evaluation", "groups", "episodes", "options", "paths")}
    return replace(run, config=chain.config, **told)


def _minutes(folder: Path, provenance: Provenance | None) -> float | None:
    """Return the duration of a training: timing.csv tells it, of a finished one also provenance.json."""
    timing = read_table(folder / "timing.csv")
    if timing is not None:
        return float(timing["seconds"].iloc[-1]) / 60
    if provenance is None or not provenance.finished or math.isnan(provenance.wall_seconds):
        return None
    return provenance.wall_seconds / 60


def find_runs(folder: Path) -> list[Run]:
    """Return the run that `folder` is, or the runs in it, each with its further evaluations after it.

    Raises:
      ConfigError: there is none, or a file is damaged.
    """

    def is_run(path: Path) -> bool:
        return any((path / mark).is_file() for mark in (*LOGS, "config.yaml", *EVALUATED)) or bool(evaluations(path))

    def read(path: Path) -> list[Run]:
        others = [replace(read_run(each), name=f"{path.resolve().name}/{each.name}") for each in evaluations(path)[1:]]
        return [read_run(path), *others]

    if not folder.is_dir():
        raise ConfigError(f"run={str(folder)!r} is not a folder")
    if is_run(folder):
        return read(folder)
    inside = [path for path in folder.glob("[!.]*") if path.is_dir() and is_run(path)]
    if not inside:
        raise ConfigError(f"run={str(folder)!r} holds no run: neither config.yaml nor eval/episodes.csv is in it")
    place = {name: i for i, name in enumerate(ORDER)}
    inside.sort(key=lambda path: (place.get(path.name, len(ORDER)), path.name))
    return [run for path in inside for run in read(path)]


@dataclass(frozen=True, eq=False)
class Recorded:
    """An episode as it was recorded at one comfort level."""

    episode: int
    level: int | None
    """That it began with; None without one."""
    path: DataFrame
    """Its rows of paths.csv."""
    row: dict[str, Any]
    """Its row of episodes.csv; empty where there is none."""


def recorded(run: Run, count: int | None = None, episodes: Sequence[int] | None = None) -> list[Recorded]:
    """Return the recorded episodes of a run; none where no path was recorded.

    An evaluation at several levels records an episode once at each, one level after the other.

    Args:
      run: the run.
      count: the most to return, the first ones; None is all.
      episodes: the indices to return; None is all.
    """
    frame = None if run.paths is None else read_table(run.paths)
    if frame is None:
        return []
    if episodes is not None:
        frame = frame[frame["episode"].isin(episodes)]
    beginning = (frame["step"] == 0).groupby(frame["episode"]).cumsum()
    found = []
    for (episode, _), path in list(frame.groupby([frame["episode"], beginning], sort=False))[:count]:
        level = path["level"].iloc[0] if "level" in path else math.nan
        known = None if math.isnan(level) else round(level)
        path = path.sort_values("step", kind="stable").reset_index(drop=True)
        found.append(Recorded(int(episode), known, path, _row(run, int(episode), known)))
    return found


def _row(run: Run, episode: int, level: int | None) -> dict[str, Any]:
    """Return the row of episodes.csv of a recorded episode; empty where there is none."""
    if run.episodes is None:
        return {}
    rows = run.episodes[run.episodes["episode"] == episode]
    if "comfort_level" in rows:  # it is missing where the level changes within the episode
        rows = rows[(rows["comfort_level"].isna() | (rows["comfort_level"] == level)).fillna(False)]
    return {} if rows.empty else {str(name): value for name, value in rows.iloc[0].items()}
