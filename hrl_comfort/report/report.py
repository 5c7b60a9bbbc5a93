"""One self-contained HTML page about a run, or about all runs in a folder.

What a run folder lacks is named on the page with the command that would write it; nothing missing
makes the report fail, and a damaged file is named. Figures are inlined as SVG, the video as mp4: the page
needs no other file.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd
from pandas import DataFrame, Series
from rich.console import Console

from hrl_comfort.analysis.episodes import TERMINATIONS, terminations
from hrl_comfort.analysis.learning_curve import POLICY, curve_of
from hrl_comfort.analysis.summary import KEYS
from hrl_comfort.analysis.tables import HEADLINE, cell, cells, of_groups
from hrl_comfort.config import CellConfig, ConfigError, ReportConfig, RobotConfig
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.output import output_file
from hrl_comfort.files.run_folder import Recorded, Run, find_runs, recorded_paths, row_of
from hrl_comfort.plots import hierarchy, training
from hrl_comfort.plots.paths import overview
from hrl_comfort.plots.style import data_uri
from hrl_comfort.report.sweeps import render, sweep_report

SHOWN_PATHS = 4
SEARCHED_PATHS = 20
SHOWN_FAILURES = 40
FAILURE = ["run", "episode", "colour", "spawn_id", "motion_id", "seen", "steps", "ended"]
"""Columns of the table of failures."""
HEADS = [each.label for each in HEADLINE.values()]
OPTION_ENDS = ["success", "failure", "preempted"]


def headline(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Return the rows of the main table, one a group of each summary.json: heading with unit to text."""
    rows = []
    for run in runs:
        for group in run.groups or []:
            precision = group.get("precision_m")
            rows.append(
                {
                    "task": str(group["task"]),
                    "policy": Path(str(group["policy"])).name,
                    "human": str(group["human"]),
                    "comfort level": str(group.get("comfort_level") or "off"),
                    "precision (cm)": "–" if precision is None else f"{100 * precision:g}",
                    **{key: str(group[key]) for key in group if key not in (*KEYS, "episodes", "metrics")},
                    "episodes": str(group["episodes"]),
                    **dict(zip(HEADS, cells(group["metrics"], HEADLINE), strict=True)),
                    "training (min)": cell(run.minutes),
                }
            )
    return rows


def _curves(runs: Sequence[Run]) -> dict[str, str]:
    """Return the figures of training that the runs have data for, as data URIs."""
    logs = {run.name: run.metrics for run in runs if run.metrics is not None}
    policies = {name: log for name, log in logs.items() if curve_of(log) is POLICY}
    controllers = {name: log for name, log in logs.items() if name not in policies}
    checkpoints = {run.name: run.checkpoints for run in runs if run.checkpoints is not None}
    figures = {}
    if policies:
        figures["learning"] = training.learning_curves(policies)
        figures["diagnostics"] = training.over_training(policies, training.DIAGNOSTICS)
    if controllers:
        figures["controllers"] = training.over_training(controllers, training.CONTROLLER)
    if checkpoints:
        figures["checkpoints"] = training.success_by_checkpoint(checkpoints)
    return {name: data_uri(figure) for name, figure in figures.items()}


def _ends(run: Run, recorded: Iterable[Recorded]) -> dict[Recorded, str]:
    """Return how recorded episodes ended, those that episodes.csv tells of."""
    rows = {key: row for key in recorded if (row := row_of(run, key)) is not None}
    return dict(zip(rows, terminations(DataFrame(rows.values())), strict=True)) if rows else {}


def _paths(runs: Sequence[Run]) -> list[tuple[str, Run, int]]:
    """Return, for each recorded run, a figure of its first paths, the run and the number of paths."""
    found = []
    for run in runs:
        if recorded := recorded_paths(run, SHOWN_PATHS):
            picture = overview(recorded, _ends(run, recorded), run.config.get("cell", {}))
            found.append((data_uri(picture), run, len(recorded)))
    return found


def _timelines(runs: Sequence[Run]) -> list[tuple[str, Run, list[list[str]]]]:
    """Return, for each chain of options, its timeline, the run, and a table of how each option ended."""
    found = []
    for run in runs:
        if run.options is not None and run.options["option"].nunique() > 1:  # a lone policy is no chain
            counts = _counts(run.options["option"], run.options["termination"], OPTION_ENDS)
            found.append((data_uri(hierarchy.timeline(run.options)), run, counts))
    return found


def _counts(groups: Series, values: Series, kinds: Sequence[str]) -> list[list[str]]:
    """Return lines of how often each group, in the order of its first row, has each kind of value."""
    counts = pd.crosstab(groups, values).reindex(index=groups.unique(), columns=kinds, fill_value=0)
    return [[str(group), *map(str, line)] for group, line in zip(counts.index, counts.to_numpy(), strict=True)]


def _video(runs: Sequence[Run], draw: bool) -> tuple[str | None, str]:
    """Return the video as a data URI, drawn anew or found in the folder, and its caption or why there is none."""
    for run in reversed(runs):  # the cycle, where there is one
        file = (run.paths.parent if run.paths else run.folder / "eval") / "video.mp4"
        caption = f"{run.name}: a recorded episode, real time."
        if draw and run.paths is not None and {"robot", "cell", "task"} <= run.config.keys():
            from hrl_comfort.scene.camera import PicturesUnavailableError  # mujoco takes its time

            try:
                caption = _draw(run, file)
            except PicturesUnavailableError as error:
                return None, str(error)
        if file.is_file():
            data = base64.b64encode(file.read_bytes()).decode("ascii")
            return f"data:video/mp4;base64,{data}", caption
    if not draw:
        return None, "No video: video=false, and none was drawn before."
    return None, "No video: it needs eval/paths.csv (evaluate with record=true) and the run's config.yaml."


def _draw(run: Run, file: Path) -> str:
    """Draw the first recorded success to `file` and return its caption.

    Raises:
      PicturesUnavailableError: there is no off-screen OpenGL, or the run does not say what was where.
    """
    from hrl_comfort.plots.video import frames, write_video  # seconds, for torch
    from hrl_comfort.scene.camera import PicturesUnavailableError

    task = run.config["task"]
    if task.get("balls", 1) > 1 or task.get("ball_jitter_m", 0.0) > 0:
        raise PicturesUnavailableError(f"No video: {run.name} has its balls in other places than the picture knows of.")
    recorded = recorded_paths(run, SEARCHED_PATHS)
    successes = [key for key, ended in _ends(run, recorded).items() if ended == "success"]
    episode = (successes or list(recorded))[0]
    row = row_of(run, episode) or {}
    try:
        robot, cell = RobotConfig(**run.config["robot"]), CellConfig(**run.config["cell"])
    except (TypeError, ConfigError) as error:
        why = f"No video: {run.name}/config.yaml does not fit this version ({error})"
        raise PicturesUnavailableError(why) from None
    pictures = frames(recorded[episode], robot, cell, row.get("task") or task["name"], row.get("colour") or "orange")
    write_video(file, pictures)
    which = "the first recorded success" if successes else "a recorded episode"
    at_level = "" if episode[1] is None else f" at level {episode[1]}"
    return f"{run.name}, episode {episode[0]}{at_level}, {which}; drawn from its joint angles, real time."


def report(config: ReportConfig) -> Path:
    """Write the page about `config.run` to `config.output` (report.html in the run), and return its path.

    A folder that holds the jobs of a sweep has a page of its own kind. The evaluations are printed too.
    """
    folder = Path(config.run)
    output = Path(config.output) if config.output else folder / "report.html"
    if not (folder.is_dir() and sweep_report(folder, output)):
        runs = find_runs(folder)
        with output_file(output):
            _write_page(runs, folder.resolve().name, output, config.video)
        if groups := [{"run": run.name, **group} for run in runs for group in run.groups or []]:
            Console().print(of_groups(groups))
    print(output)
    return output


def _write_page(runs: list[Run], title: str, output: Path, draw: bool) -> None:
    video, about_video = _video(runs, draw)
    tables = [
        run.episodes.assign(run=run.name, ended=terminations(run.episodes)) for run in runs if run.episodes is not None
    ]
    episodes = pd.concat(tables) if tables else DataFrame(columns=FAILURE)
    kinds = list(dict.fromkeys([*TERMINATIONS, *episodes["ended"]]))
    failed = episodes[episodes["ended"] != "success"].reindex(columns=FAILURE)
    page = render(
        "report.html.j2",
        title=title,
        runs=runs,
        headline=headline(runs),
        curves=_curves(runs),
        paths=_paths(runs),
        timelines=_timelines(runs),
        kinds=kinds,
        terminations=_counts(episodes["run"], episodes["ended"], kinds),
        failures=failed.head(SHOWN_FAILURES).astype("str").mask(failed.isna(), "–").to_numpy().tolist(),
        failed=len(failed),
        shown_timelines=hierarchy.SHOWN_TIMELINES,
        video=video,
        about_video=about_video,
    )
    write_text(output, page)
