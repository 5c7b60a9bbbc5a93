"""Videos of a report: recorded episodes drawn anew, a failure before a success, or the episode asked for."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hrl_comfort.config import ConfigError, ReportConfig
from hrl_comfort.files.run_folder import Run, recorded

if TYPE_CHECKING:
    from hrl_comfort.plots.tape import Recording, Take

FILES = {"failure": "failure.mp4", "success": "video.mp4"}
"""Files in `eval/`; the second is also that of an episode that was asked for."""
NEEDED = {"robot", "cell", "task"}
"""Sections of a run's configuration without which nothing can be drawn."""
LONGEST_S = 20.0
"""Longest part of an episode that is drawn unless it is asked for: one that fails at level 1 may last minutes."""
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
        folder = run.evaluation or run.folder / "eval"
        if found := [folder / name for name in FILES.values() if (folder / name).is_file()]:
            return [_data(file, f"{run.name}: a recorded episode.") for file in found], NONE
    return [], NONE if config.video else "No video: video=false, and none was drawn before."


def _data(file: Path, caption: str) -> tuple[str, str]:
    return f"data:video/mp4;base64,{base64.b64encode(file.read_bytes()).decode('ascii')}", caption


def _with_episode(runs: Sequence[Run], episode: int) -> Run:
    for run in runs:
        if recorded(run, 1, [episode]):
            return run
    raise ConfigError(f"episode={episode} is not recorded; evaluate with record=true and more episodes")


def _drawn(run: Run, config: ReportConfig) -> list[tuple[Path, str]]:
    """Draw the episode asked for, or the first recorded failure and the first success; return files and captions.

    Raises:
      PicturesUnavailableError: there is no off-screen OpenGL, or the run does not say what was where.
    """
    from hrl_comfort.plots.tape import Tape
    from hrl_comfort.scene.camera import PicturesUnavailableError

    assert run.paths is not None
    try:
        tape = Tape(run)
    except ConfigError as error:
        raise PicturesUnavailableError(f"No video: {error}") from None
    if not tape.knows_objects:
        raise PicturesUnavailableError(
            f"No video: {run.name} has its objects in other places than the picture knows of."
        )
    takes = [(recording, take) for recording in tape.recordings for take in recording.takes]
    if config.episode is not None:
        chosen = {"success": next(each for each in takes if each[0].episode == config.episode)}
    else:
        told = [each for each in takes if each[1].row]
        first = {kind: [each for each in told if each[1].success == (kind == "success")][:1] for kind in FILES}
        chosen = {kind: each[0] for kind, each in first.items() if each} or {"success": takes[0]}
    files = {kind: run.paths.parent / FILES[kind] for kind in chosen}
    longest_s = LONGEST_S if config.episode is None else None
    return [(files[kind], _draw(*each, files[kind], config.speed, longest_s)) for kind, each in chosen.items()]


def _draw(recording: Recording, take: Take, file: Path, speed: float, longest_s: float | None) -> str:
    """Draw a take and return a caption; of one at the first or last of several levels, both beside each other.

    With `longest_s`, of a longer take only so much is drawn: its end, or the beginning of two beside each other.
    """
    from hrl_comfort.plots.video import azimuth_deg, beside, frames, write_video

    view = azimuth_deg(take.path)
    shown = recording.ends if take in recording.ends else [take]
    duration_s, begin_s, end_s, told = max(each.clip.duration_s for each in shown), 0.0, None, ""
    if longest_s is not None and duration_s > longest_s:
        begin_s, end_s = (0.0, longest_s) if len(shown) > 1 else (duration_s - longest_s, None)
        told = f", the {'first' if len(shown) > 1 else 'last'} {longest_s:g} s"
    pictures = [frames(each, speed, view, begin_s, end_s) for each in shown]
    write_video(file, beside(pictures))
    pace = "real time" if speed == 1 else "half speed" if speed == 0.5 else f"speed × {speed:g}"
    if len(shown) > 1:
        sides = zip(shown, ("left", "right"), strict=True)
        how = " and".join(f" at level {each.level} ({side}: {each.ended})" for each, side in sides)
    else:
        how = ("" if take.level is None else f" at level {take.level}") + f", {take.ended}"
    return f"{take.tape.run.name}, episode {recording.episode}{how}; drawn from its joint angles, {pace}{told}."
