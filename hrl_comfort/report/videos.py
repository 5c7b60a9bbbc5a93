"""Videos of a report: recorded episodes drawn anew, a failure before a success, or the episode asked for."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

from pandas import DataFrame

from hrl_comfort.analysis.episodes import terminations
from hrl_comfort.config import CellConfig, ConfigError, ReportConfig, RobotConfig
from hrl_comfort.config.structured import section
from hrl_comfort.files.run_folder import Recorded, Run, recorded_paths, row_of
from hrl_comfort.files.tables import column

FILES = {"failure": "failure.mp4", "success": "video.mp4"}
"""Files in `eval/`; the second is also that of an episode that was asked for."""
NEEDED = {"robot", "cell", "task"}
"""Sections of a run's configuration without which nothing can be drawn."""
NONE = "No video: it needs eval/paths.csv (evaluate with record=true) and the run's config.yaml."


def videos(runs: Sequence[Run], config: ReportConfig) -> tuple[list[tuple[str, str]], str]:
    """Return videos as data URIs with their captions, drawn anew or found in the folders, and why there is none.

    Raises:
      ConfigError: no run has recorded `config.episode`.
    """
    there = [run for run in reversed(runs) if run.paths is not None and run.config.keys() >= NEEDED]  # the cycle first
    if config.episode is not None:
        there = [_with_episode(there, config.episode)]
    if config.video and there:
        from hrl_comfort.scene.camera import PicturesUnavailableError  # mujoco takes its time

        try:
            return [_data(*each) for each in _drawn(there[0], config)], NONE
        except PicturesUnavailableError as error:
            return [], str(error)
    for run in reversed(runs):
        folder = run.paths.parent if run.paths else run.folder / "eval"
        if found := [folder / name for name in FILES.values() if (folder / name).is_file()]:
            return [_data(file, f"{run.name}: a recorded episode.") for file in found], NONE
    return [], NONE if config.video else "No video: video=false, and none was drawn before."


def _data(file: Path, caption: str) -> tuple[str, str]:
    return f"data:video/mp4;base64,{base64.b64encode(file.read_bytes()).decode('ascii')}", caption


def _with_episode(runs: Sequence[Run], episode: int) -> Run:
    for run in runs:
        if recorded_paths(run, 1, [episode]):
            return run
    raise ConfigError(f"episode={episode} is not recorded; evaluate with record=true and more episodes")


def _drawn(run: Run, config: ReportConfig) -> list[tuple[Path, str]]:
    """Draw the episode asked for, or the first recorded failure and the first success; return files and captions.

    Raises:
      PicturesUnavailableError: there is no off-screen OpenGL, or the run does not say what was where.
    """
    from hrl_comfort.scene.camera import PicturesUnavailableError

    assert run.paths is not None
    task = run.config["task"]
    if task.get("balls", 1) > 1 or task.get("ball_jitter_m", 0.0) > 0:
        raise PicturesUnavailableError(f"No video: {run.name} has its balls in other places than the picture knows of.")
    if config.episode is not None:
        chosen = {"success": next(iter(recorded_paths(run, 1, [config.episode])))}
    else:
        chosen = {kind: key for kind in FILES if (key := _first(run, kind == "success")) is not None}
    if not chosen:
        chosen = {"success": next(iter(recorded_paths(run, 1)))}
    found = []
    for kind, key in chosen.items():
        file = run.paths.parent / FILES[kind]
        found.append((file, _draw(run, key, file, config.speed)))
    return found


def _first(run: Run, success: bool) -> Recorded | None:
    """Return the first recorded episode that succeeded, or failed."""
    if run.episodes is None:
        return None
    rows = run.episodes[(column(run.episodes, "success") > 0) == success]
    recorded = recorded_paths(run, episodes=rows["episode"].unique().tolist())
    return next((key for key in recorded if (row := row_of(run, key)) and bool(row["success"]) == success), None)


def _draw(run: Run, key: Recorded, file: Path, speed: float) -> str:
    """Draw an episode and return a caption; of one recorded at several levels, first and last beside each other."""
    from hrl_comfort.plots.video import azimuth_deg, beside, frames, write_video  # seconds, for torch
    from hrl_comfort.scene.camera import PicturesUnavailableError

    recorded = recorded_paths(run, episodes=[key[0]])
    ends = [next(iter(recorded)), list(recorded)[-1]]
    shown = ends if len(recorded) > 1 and key in ends else [key]
    try:
        robot, cell = section(RobotConfig, run.config["robot"]), section(CellConfig, run.config["cell"])
    except ConfigError as error:
        why = f"No video: {run.name}/config.yaml does not fit this version ({error})"
        raise PicturesUnavailableError(why) from None
    row = row_of(run, key) or {}
    task, colour = row.get("task") or run.config["task"]["name"], row.get("colour") or "orange"
    view = azimuth_deg(recorded[key])
    write_video(file, beside([frames(recorded[each], robot, cell, task, colour, speed, view) for each in shown]))
    pace = "real time" if speed == 1 else "half speed" if speed == 0.5 else f"speed × {speed:g}"
    if len(shown) > 1:
        sides = zip(shown, ("left", "right"), strict=True)
        how = " and".join(f" at level {each[1]} ({side}: {_ended(run, each)})" for each, side in sides)
    else:
        how = ("" if key[1] is None else f" at level {key[1]}") + f", {_ended(run, key)}"
    return f"{run.name}, episode {key[0]}{how}; drawn from its joint angles, {pace}."


def _ended(run: Run, key: Recorded) -> str:
    """Return how a recorded episode ended, in words."""
    row = row_of(run, key)
    return "end unknown" if row is None else str(terminations(DataFrame([row])).iloc[0])
