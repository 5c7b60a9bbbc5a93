"""One self-contained HTML page about a run, or about all runs in a folder.

What a run folder lacks is named on the page with the command that writes it; nothing missing
makes the report fail, and a damaged file is named. Figures are inlined as SVG, the video as mp4: the page
needs no other file.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
from markupsafe import Markup
from pandas import DataFrame, Series
from rich.console import Console

from hrl_comfort.analysis.episodes import TERMINATIONS, terminations
from hrl_comfort.analysis.learning_curve import POLICY, curve_of
from hrl_comfort.analysis.option_use import shares_by_kind
from hrl_comfort.analysis.summary import KEYS, with_totals
from hrl_comfort.analysis.tables import HEADLINE, SHOWN, SPAWNS, cell, cells, of_groups
from hrl_comfort.config import ReportConfig
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.output import output_file
from hrl_comfort.files.run_folder import Run, find_runs, recorded
from hrl_comfort.files.tables import column
from hrl_comfort.plots import hierarchy, training
from hrl_comfort.plots.paths import at_levels, overview
from hrl_comfort.plots.style import data_uri
from hrl_comfort.report.sweeps import render, sweep_report
from hrl_comfort.report.texts import missing, summary
from hrl_comfort.report.videos import videos

SHOWN_PATHS = 4
SHOWN_FAILURES = 40
FAILURE = {
    "run": "run", "episode": "episode", "object": "kind", "spawn_id": "spawn", "motion_id": "motion", "seen": "seen",
    "steps": "steps", "drops": "drops", "slip_mm": "slip (mm)", "ended": "ended by",
}  # fmt: skip
"""Columns of the table of failures, and their heads; those of a hand are left out where there is none."""
COUNTED = {"contact": "with a contact", "unsafe_contact": "with an unsafe contact", "drops": "drops"}
"""Columns of episodes.csv that the table of endings counts too, whatever ended the episode."""
HEADS = [each.label for each in HEADLINE.values()]
OPTION_ENDS = ["success", "failure", "preempted", "interrupted"]


def headline(runs: Sequence[Run]) -> list[dict[str, str]]:
    """Return the rows of the main table, one a group of each summary.json and a total: heading with unit to text."""
    rows = []
    for run in runs:
        for group in with_totals(run.groups or [], run.episodes):
            precision = group.get("precision_m")
            rows.append(
                {
                    "task": str(group["task"]),
                    "policy": Path(str(group["policy"])).name,
                    "human": str(group["human"]),
                    "comfort level": str(group.get("comfort_level") or "off"),
                    "precision (cm)": "–" if precision is None else f"{100 * precision:g}",
                    "split": str(group.get("split") or "–"),
                    **{
                        SHOWN.get(key, key): SPAWNS.get(str(group[key]), str(group[key]))
                        for key in group
                        if key not in (*KEYS, "episodes", "metrics") and group[key] is not None
                    },
                    "episodes": str(group["episodes"]),
                    **dict(zip(HEADS, cells(group["metrics"], HEADLINE), strict=True)),
                    "training (min)": cell(run.minutes),
                }
            )
    return rows


def _curves(runs: Sequence[Run]) -> dict[str, str]:
    """Return the figures of training that the runs have data for, as data URIs."""
    logs = {run.name: run.metrics for run in runs if run.metrics is not None and len(run.metrics) > 1}
    policies = {name: log for name, log in logs.items() if curve_of(log) is POLICY}
    controllers = {name: log for name, log in logs.items() if name not in policies}
    checkpoints = {
        _title(run.name, run.checkpoints): run.checkpoints
        for run in runs
        if run.checkpoints is not None and run.checkpoints["policy_steps"].nunique() > 1
    }
    figures = {}
    if policies:
        figures["learning"] = training.learning_curves(policies)
        figures["diagnostics"] = training.over_training(policies, training.DIAGNOSTICS)
    if controllers:
        figures["controllers"] = training.over_training(controllers, training.CONTROLLER)
    if shares := {name: log for name, log in controllers.items() if shares_by_kind(log)}:
        figures["options"] = training.option_shares(shares)
    if checkpoints:
        figures["checkpoints"] = training.by_checkpoint(checkpoints)
    return {name: data_uri(figure) for name, figure in figures.items()}


def _title(name: str, checkpoints: DataFrame) -> str:
    """Return the title of a panel of checkpoints: the run, and what makes panels differ."""
    first = checkpoints.iloc[0]
    about = [str(first["split"])] if "split" in first else []
    about += [f"human={first['human']}"] if "human" in first else []
    about += [f"{100 * first['precision_m']:g} cm"] if "precision_m" in first else []
    return f"{name}\n{', '.join(about)}"


def _paths(runs: Sequence[Run]) -> list[tuple[str, Run, int]]:
    """Return, for each recorded run, a figure of its first paths, the run and the number of paths."""
    found = []
    for run in runs:
        if drawn := recorded(run, SHOWN_PATHS):
            precision = run.config.get("task", {}).get("precision", {})
            picture = overview(drawn, run.config.get("cell", {}), precision)
            found.append((data_uri(picture), run, len(drawn)))
    return found


def _level_paths(runs: Sequence[Run]) -> list[tuple[str, Run]]:
    """Return, for each run recorded at several levels, a figure of two episodes at up to four of the levels."""
    found = []
    for run in runs:
        keys = [(each.episode, each.level) for each in recorded(run)]
        there = sorted({level for _, level in keys if level is not None})
        if run.episodes is None or len(there) < 2:
            continue
        shown = [there[round(k)] for k in np.linspace(0, len(there) - 1, min(len(there), SHOWN_PATHS))]
        both = [index for index, level in keys if level == there[0] and all((index, each) in keys for each in shown)]
        if both:
            found.append((data_uri(at_levels([run], shown, both[:2])), run))
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


def report(config: ReportConfig) -> Path:
    """Write the page about `config.run` to `config.output` (report.html in the run), and return its path.

    A folder that holds the jobs of a sweep has a page of its own kind. The evaluations are printed too.
    """
    folder = Path(config.run)
    output = Path(config.output) if config.output else folder / "report.html"
    if not (folder.is_dir() and sweep_report(folder, output)):
        runs = find_runs(folder)
        for run in runs:
            if run.unfinished:
                warnings.warn(run.unfinished, stacklevel=2)
        with output_file(output):
            _write_page(runs, folder, output, config)
        totals = {run.name: with_totals(run.groups or [], run.episodes) for run in runs}
        if groups := [{"run": name, **group} for name, each in totals.items() for group in each]:
            Console().print(of_groups(groups))
    print(output)
    return output


def _endings(episodes: DataFrame) -> tuple[list[str], list[list[str]]]:
    """Return head and lines of a table of how many episodes of each run ended how, and had a contact."""
    kinds = [kind for kind in [*TERMINATIONS, "other"] if kind in {"success", *episodes["ended"]}]
    counted = {name: head for name, head in COUNTED.items() if np.isfinite(column(episodes, name)).any()}
    lines = _counts(episodes["run"], episodes["ended"], kinds)
    runs = {str(name): each for name, each in episodes.groupby("run", sort=False)}
    for line in lines:
        line[1:] = [str(len(runs[line[0]])), *line[1:]]
        line += [f"{np.nansum(column(runs[line[0]], name)):.0f}" for name in counted]
    return ["run", "episodes", *kinds, *counted.values()], lines


def _provenance(run: Run) -> list[list[str]]:
    """Return the lines of provenance.json; without `best`, the success of a training that explores."""
    content = run.provenance.model_dump(exclude={"best"}) if run.provenance else {}
    return [
        [key.replace("_", " "), ", ".join(f"{k} {v}" for k, v in each.items()) if isinstance(each, dict) else str(each)]
        for key, each in content.items()
    ]


def _write_page(runs: list[Run], folder: Path, output: Path, config: ReportConfig) -> None:
    lacks = missing(folder, runs)
    found, no_video = videos(runs, config)
    replay, no_replay = None, "No replay: it needs eval/paths.csv (evaluate with record=true)."
    if any(run.paths for run in runs):
        from hrl_comfort.report.replay import replays  # seconds, for torch and mujoco

        replay, no_replay = replays(runs)
    lacks += [(why, "") for why in ("" if found else no_video, no_replay) if why]
    evaluated = [run for run in runs if run.groups]
    logs = [run.metrics for run in runs if run.metrics is not None]
    checkpoints = [run.checkpoints for run in runs if run.checkpoints is not None]
    tables = [
        run.episodes.assign(run=run.name, ended=terminations(run.episodes)) for run in runs if run.episodes is not None
    ]
    episodes = pd.concat(tables) if tables else DataFrame(columns=list(FAILURE))
    failed = episodes[episodes["ended"] != "success"].round({"slip_mm": 1})
    listed = [name for name in FAILURE if name not in ("drops", "slip_mm") or np.isfinite(column(failed, name)).any()]
    shown = failed.reindex(columns=listed).head(SHOWN_FAILURES)
    page = render(
        "report.html.j2",
        title=folder.resolve().name,
        here=Path.cwd(),
        missing=lacks,
        summary=summary(evaluated[-1]) if evaluated else "Nothing is evaluated yet.",
        runs=runs,
        headline=headline(runs),
        curves=_curves(runs),
        notes=training.notes(logs),
        checkpoint_notes=training.checkpoint_notes(checkpoints),
        paths=_paths(runs),
        level_paths=_level_paths(runs),
        timelines=_timelines(runs),
        endings=_endings(episodes) if tables else None,
        failure_heads=[FAILURE[name] for name in listed],
        failures=shown.astype("str").mask(shown.isna(), "–").to_numpy().tolist(),
        failed=len(failed),
        provenance={run.name: _provenance(run) for run in runs},
        shown_timelines=hierarchy.SHOWN_TIMELINES,
        videos=found,
        replay=replay,
        script=Markup(resources.files("hrl_comfort.report").joinpath("replay.js").read_text(encoding="utf-8")),
    )
    write_text(output, page)
