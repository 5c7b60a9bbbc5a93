"""One self-contained HTML page about a run, or about all runs in a folder.

What a run folder lacks is named on the page with the command that would write it; nothing missing
makes the report fail, and a damaged file is named. Figures are inlined as SVG, the video as mp4: the page
needs no other file.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from pandas import DataFrame

from hrl_comfort.analysis.episodes import TERMINATIONS, terminations
from hrl_comfort.analysis.learning_curve import POLICY, curve_of
from hrl_comfort.analysis.summary import KEYS
from hrl_comfort.analysis.tables import cell
from hrl_comfort.config import CellConfig, ConfigError, ReportConfig, RobotConfig
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.run_folder import Recorded, Run, find_runs, recorded_paths, row_of
from hrl_comfort.plots import options, training
from hrl_comfort.plots.paths import overview
from hrl_comfort.plots.style import data_uri
from hrl_comfort.report.sweeps import render, sweep_report

SHOWN_PATHS = 4
SEARCHED_PATHS = 20
SHOWN_FAILURES = 40


@dataclass(frozen=True)
class Picture:
    """A figure or video: its data URI, its caption, and the text that stands for it."""

    uri: str
    caption: str
    alt: str


def headline(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Return the rows of the main table, one a group of each summary.json: heading with unit to text."""
    rows = []
    for run in runs:
        for group in run.groups or []:
            metrics = group["metrics"]
            extras = {key: str(value) for key, value in group.items() if key not in (*KEYS, "episodes", "metrics")}
            level = group.get("comfort_level")
            precision = group.get("precision_m")
            rows.append(
                {
                    "task": str(group["task"]),
                    "policy": Path(str(group["policy"])).name,
                    "human": str(group["human"]),
                    "comfort level": "off" if level is None else str(level),
                    "precision (cm)": "–" if precision is None else f"{100 * precision:g}",
                    **extras,
                    "episodes": str(group["episodes"]),
                    "success (%)": cell(metrics.get("success"), 100),
                    "steps": cell(metrics.get("steps"), digits=0),
                    "distance (m)": cell(metrics.get("human_distance_mean_m"), digits=2),
                    "human collisions (%)": cell(metrics.get("human_collision"), 100),
                    "other collisions (%)": cell(metrics.get("other_collision"), 100),
                    "training (min)": "–" if run.minutes is None else f"{run.minutes:.1f}",
                }
            )
    return rows


def _of(runs: Sequence[Run], table_of: Callable[[Run], DataFrame | None]) -> dict[str, DataFrame]:
    return {run.name: table for run in runs if (table := table_of(run)) is not None}


def _curves(runs: Sequence[Run]) -> dict[str, Picture]:
    """Return the figures of training that the runs have data for."""
    found = {}
    trained = _of(runs, lambda run: run.metrics)
    if metrics := {name: table for name, table in trained.items() if curve_of(table) is POLICY}:
        found["learning"] = Picture(
            data_uri(training.learning_curves(metrics)),
            "Training episodes that succeeded, and that ended in a collision with the human, above the "
            "precision in force, which the curriculum tightens: success is not at one fixed precision. "
            "Thin lines are logged values, thick ones trailing means; dotted lines part curriculum stages.",
            "Success and precision over training",
        )
        found["diagnostics"] = Picture(
            data_uri(training.over_training(metrics, training.DIAGNOSTICS)),
            "Mean return of training episodes, mean Q value of the batch, and policy entropy.",
            "Return, Q value and entropy over training",
        )
    if controllers := {name: table for name, table in trained.items() if name not in metrics}:
        found["controllers"] = Picture(
            data_uri(training.over_training(controllers, training.CONTROLLER)),
            "Training episodes that succeeded, control steps of an episode, and mean return. "
            "Some options are chosen at random, ever fewer of them. "
            "Thin lines are logged values, thick ones trailing means.",
            "Success, steps and return over training of a controller",
        )
    if checkpoints := _of(runs, lambda run: run.checkpoints):
        precisions = {100 * p for table in checkpoints.values() for p in table.get("precision_m", ())}
        at = f" at {', '.join(f'{p:g}' for p in sorted(precisions))} cm" if precisions else ""
        found["checkpoints"] = Picture(
            data_uri(training.success_by_checkpoint(checkpoints)),
            f"Success on the evaluation set{at}, checkpoint by checkpoint; bars are 95 % intervals.",
            "Success by checkpoint",
        )
    return found


def _endings(run: Run, recorded: Mapping[Recorded, object]) -> dict[Recorded, str]:
    """Return how recorded episodes ended, those that episodes.csv tells of."""
    rows = {key: row for key in recorded if (row := row_of(run, key)) is not None}
    return dict(zip(rows, terminations(DataFrame(rows.values())), strict=True)) if rows else {}


def _path_pictures(runs: Sequence[Run]) -> list[Picture]:
    pictures = []
    for run in runs:
        recorded = recorded_paths(run, SHOWN_PATHS)
        if recorded:
            cell_config = run.config.get("cell", {})
            lacking = "" if cell_config else " Goals are not drawn: the folder has no config.yaml."
            pictures.append(
                Picture(
                    data_uri(overview(recorded, _endings(run, recorded), cell_config)),
                    f"{run.name}: tool and human in the first {len(recorded)} recorded episodes, "
                    f"not chosen by outcome, a colour each; cell frame, robot base at the origin.{lacking}",
                    f"Paths of tool and human, {run.name}",
                )
            )
    return pictures


def _timelines(runs: Sequence[Run]) -> list[tuple[Picture, list[list[str]]]]:
    """Return, for each chain of options, its timeline and a table of how each option ended."""
    found = []
    for run in runs:
        if run.options is None or run.options["option"].nunique() < 2:
            continue  # a lone policy is no chain
        shown = run.options["episode"].unique().tolist()[: options.SHOWN_TIMELINES]
        picture = Picture(
            data_uri(options.timeline(run.options, shown)),
            f"{run.name}: the options of the first {len(shown)} episodes, as the meta-controller ran them.",
            f"Option timeline, {run.name}",
        )
        counts = Counter(zip(run.options["option"], run.options["termination"], strict=True))
        table = [
            [option, *(str(counts[option, end]) for end in ("success", "failure", "preempted"))]
            for option in run.options["option"].unique()
        ]
        found.append((picture, table))
    return found


def _terminations(runs: Sequence[Run]) -> tuple[list[str], list[list[str]]]:
    """Return the header and rows of the table that counts how episodes ended, a row a run."""
    counted = {run.name: Counter(terminations(run.episodes)) for run in runs if run.episodes is not None}
    others = sorted({kind for counts in counted.values() for kind in counts} - set(TERMINATIONS))
    kinds = [*TERMINATIONS, *others]
    return kinds, [[name, *(str(counts[kind]) for kind in kinds)] for name, counts in counted.items()]


def _failures(runs: Sequence[Run]) -> tuple[list[list[str]], int]:
    """Return rows about the first failed episodes, and how many failed."""
    columns = ["run", "episode", "colour", "spawn_id", "motion_id", "seen", "steps", "ended"]
    tables = [
        run.episodes.assign(run=run.name, ended=terminations(run.episodes)) for run in runs if run.episodes is not None
    ]
    failed = [row for table in tables for row in table[table["ended"] != "success"].reindex(columns=columns).to_numpy()]
    return [["–" if pd.isna(each) else str(each) for each in row] for row in failed[:SHOWN_FAILURES]], len(failed)


def _video(runs: Sequence[Run], draw: bool) -> tuple[Picture | None, str]:
    """Return the video, drawn anew or found in the folder, and a line that says why there is none."""
    for run in reversed(runs):  # the cycle, where there is one
        file = (run.paths.parent if run.paths else run.folder / "eval") / "video.mp4"
        why = ""
        caption = f"{run.name}: a recorded episode, real time."
        if draw and run.paths is not None and {"robot", "cell", "task"} <= run.config.keys():
            caption, why = _draw(run, file)
        if not why and file.is_file():
            data = base64.b64encode(file.read_bytes()).decode("ascii")
            return Picture(f"data:video/mp4;base64,{data}", caption, "Video of an episode"), ""
        if why:
            return None, why
    if not draw:
        return None, "No video: video=false, and none was drawn before."
    return None, "No video: it needs eval/paths.csv (evaluate with record=true) and the run's config.yaml."


def _draw(run: Run, file: Path) -> tuple[str, str]:
    """Draw the first recorded success to `file`; return its caption, and why it could not be drawn."""
    from hrl_comfort.plots import video
    from hrl_comfort.scene.camera import PicturesUnavailableError

    recorded = recorded_paths(run, SEARCHED_PATHS)
    successes = [key for key, ended in _endings(run, recorded).items() if ended == "success"]
    episode = (successes or list(recorded))[0]
    row = row_of(run, episode) or {}
    task, colour = row.get("task") or run.config["task"]["name"], row.get("colour") or "orange"
    task_config = run.config["task"]
    if task_config.get("balls", 1) > 1 or task_config.get("ball_jitter_m", 0.0) > 0:
        return "", f"No video: {run.name} has its balls in other places than the picture knows of."
    try:
        robot, cell = RobotConfig(**run.config["robot"]), CellConfig(**run.config["cell"])
        video.write_video(file, video.frames(recorded[episode], robot, cell, task, colour))
    except PicturesUnavailableError as error:
        return "", str(error)
    except (TypeError, ConfigError) as error:
        return "", f"No video: {run.name}/config.yaml does not fit this version ({error})."
    which = "the first recorded success" if successes else "a recorded episode"
    at_level = "" if episode[1] is None else f" at level {episode[1]}"
    return f"{run.name}, episode {episode[0]}{at_level}, {which}; drawn from its joint angles, real time.", ""


def _evaluation(run: Run) -> str:
    """Return the command that would evaluate a run."""
    if "meta_controller_agent" in run.config:
        return (
            "hrl-comfort evaluate task=sort meta_controller=learned comfort=sort reward=sort "
            "policies.meta_controller=RUN "
            "policies.pick=… policies.place=… policies.return=… output=RUN/eval"
        )
    return f"hrl-comfort evaluate policy=RUN task={run.name}"


def report(config: ReportConfig) -> Path:
    """Write the page about `config.run` to `config.output` (report.html in the run), and return its path.

    A folder that holds the jobs of a sweep has a page of its own kind.
    """
    folder = Path(config.run)
    output = Path(config.output) if config.output else folder / "report.html"
    if folder.is_dir() and sweep_report(folder, output):
        return output
    runs = find_runs(folder)
    video, no_video = _video(runs, config.video)
    kinds, terminations = _terminations(runs)
    failures, failed = _failures(runs)
    page = render(
        "report.html.j2",
        title=folder.resolve().name,
        runs=runs,
        headline=headline(runs),
        not_evaluated=[(run.name, _evaluation(run)) for run in runs if run.groups is None],
        curves=_curves(runs),
        paths=_path_pictures(runs),
        timelines=_timelines(runs),
        kinds=kinds,
        terminations=terminations,
        failures=failures,
        failed=failed,
        video=video,
        no_video=no_video,
    )
    write_text(output, page)
    return output
