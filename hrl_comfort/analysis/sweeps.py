"""A sweep as one table: a row a combination of what was swept, its training seeds pooled.

A mean is over the finished runs of a combination, one value each, with Student's 95 % interval over them.
Runs that are not finished are counted, and in no mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, UNBOUNDED, student
from hrl_comfort.analysis.learning_curve import LearningCurve, curve_of, training_end
from hrl_comfort.analysis.tables import Quantity, cells
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run, read_run
from hrl_comfort.files.sweep_record import Job, find_jobs, planned
from hrl_comfort.files.tables import column

SEED = "train_seed"
"""The key whose values are pooled."""
COUNTS = ("finished", "unfinished", "failed")


@dataclass(frozen=True)
class Entry:
    """A job of the sweep and the run in its folder; one that has not begun has neither."""

    overrides: Mapping[str, str]
    """Key -> value, of this job."""
    where: str
    state: str
    """One of COUNTS."""
    why: str
    """The reason why it is not finished."""
    run: Run | None


def _trained(name: str) -> Callable[[Run], float | None]:
    return lambda run: None if run.metrics is None else training_end(run.metrics).get(name)


def _evaluated(name: str, successes: bool) -> Callable[[Run], float | None]:
    def mean(run: Run) -> float | None:
        if run.episodes is None or name not in run.episodes:
            return None
        values = column(run.episodes, name)
        kept = values[np.isfinite(values) & ((column(run.episodes, "success") > 0) | (not successes))]
        return float(kept.mean()) if len(kept) else None

    return mean


QUANTITIES = {
    "success": Quantity("training success (%)", 100, 1),
    "return": Quantity("return", digits=2),
    "steps": Quantity("steps", digits=1),
    "placed": Quantity("balls placed", digits=2),
    "precision_m": Quantity("precision (cm)", 100, 1),
    "minutes": Quantity("training (min)", digits=1),
    "eval_success": Quantity("evaluated success (%)", 100, 1),
    "eval_steps": Quantity("evaluated steps", digits=1),
    "eval_human_distance_mean_m": Quantity("evaluated distance (m)"),
    "eval_human_collision": Quantity("evaluated human collisions (%)", 100, 1),
}
VALUES: dict[str, Callable[[Run], float | None]] = {
    **{name: _trained(name) for name in ("success", "return", "steps", "placed", "precision_m")},
    "minutes": lambda run: run.minutes,
    "eval_success": _evaluated("success", False),
    "eval_steps": _evaluated("steps", True),
    "eval_human_distance_mean_m": _evaluated("human_distance_mean_m", True),
    "eval_human_collision": _evaluated("human_collision", False),
}
"""Quantities to their value in a run; None where it has none."""
SHARES = ("success", "eval_success", "eval_human_collision")


@dataclass(frozen=True)
class Row:
    """A combination of what was swept."""

    combination: dict[str, str]
    """Swept key -> value; a dash where a job did not say."""
    entries: list[Entry]
    means: dict[str, dict[str, Any]]
    """Name of a quantity -> mean and ci95 (None of a single run)."""

    @property
    def name(self) -> str:
        """The combination in words."""
        return ", ".join(f"{key}={value}" for key, value in self.combination.items()) or "all runs"

    def count(self, state: str) -> int:
        """Return how many of its jobs are `finished`, `unfinished` or `failed`."""
        return sum(entry.state == state for entry in self.entries)


@dataclass(frozen=True)
class Sweep:
    """All combinations, and the overrides that all jobs share."""

    rows: list[Row]
    alike: dict[str, str]

    @property
    def entries(self) -> list[Entry]:
        """Every job, by combination."""
        return [entry for row in self.rows for entry in row.entries]

    @property
    def curve(self) -> LearningCurve | None:
        """The learning curve of its trainings; None where none has logged anything."""
        logged = (entry.run.metrics for entry in self.entries if entry.run is not None)
        return next((curve_of(metrics) for metrics in logged if metrics is not None), None)


def read_sweep(folder: Path) -> Sweep:
    """Return the sweep in a folder; one without rows where the folder holds none.

    Raises:
      ConfigError: a file in it is damaged, or its jobs are of several verbs.
    """
    jobs = find_jobs(folder)
    verbs = sorted({job.verb for job in jobs.values()})
    if len(verbs) > 1:
        raise ConfigError(f"{folder} holds jobs of {' and of '.join(verbs)}; give each sweep a folder of its own")
    entries = [_entry(folder, where, job) for where, job in jobs.items()]
    begun = {job.overrides for job in jobs.values()}
    asked = planned(folder) if jobs else []
    if begun & set(asked):  # else the note is of another sweep, which wrote to the same folder
        entries += [Entry(_told(each), "", "unfinished", "not begun", None) for each in asked if each not in begun]
    keys = list(dict.fromkeys(key for entry in entries for key in entry.overrides))
    told = {key: {entry.overrides.get(key, "–") for entry in entries} for key in keys}
    swept = [key for key in keys if len(told[key]) > 1 and key != SEED]
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for entry in entries:
        groups.setdefault(tuple(entry.overrides.get(key, "–") for key in swept), []).append(entry)
    rows = [Row(dict(zip(swept, values, strict=True)), group, _means(group)) for values, group in groups.items()]
    alike = {key: next(iter(values)) for key, values in told.items() if len(values) == 1 and key != SEED}
    return Sweep(rows, alike)


def _told(overrides: Sequence[str]) -> dict[str, str]:
    return dict(line.lstrip("+").split("=", 1) for line in overrides)


def _entry(folder: Path, where: Path, job: Job) -> Entry:
    run = read_run(where)
    state, why = _state(job, run)
    return Entry(_told(job.overrides), str(where.relative_to(folder)), state, why, run)


def _state(job: Job, run: Run) -> tuple[str, str]:
    """Return which of COUNTS a job is, and why it is not finished."""
    far = ""
    if job.verb in ("train", "train meta_controller"):
        finished = run.provenance is not None and run.provenance.finished
        if run.metrics is not None:
            name = curve_of(run.metrics).progress
            far = f", {run.metrics[name].iloc[-1]:.0f} {name.replace('_', ' ')} logged"
    else:
        finished = job.state == "done" and run.groups is not None
    if finished:
        return "finished", ""
    if job.state == "failed":
        return "failed", job.why
    return "unfinished", (job.why or "running, or killed") + far


def _means(entries: Sequence[Entry]) -> dict[str, dict[str, Any]]:
    runs = [entry.run for entry in entries if entry.state == "finished" and entry.run is not None]
    found = {}
    for name, value_of in VALUES.items():
        values = np.array([value for run in runs if (value := value_of(run)) is not None])
        if len(values):
            bounds = SHARE if name in SHARES else UNBOUNDED if name == "return" else (0.0, np.inf)
            found[name] = {"mean": float(values.mean()), "ci95": student(values, bounds)}
    return found


def table(sweep: Sweep) -> tuple[list[str], list[list[str]]]:
    """Return heads and lines of the table as text; a quantity that no run has is left out."""
    there = {name: each for name, each in QUANTITIES.items() if any(name in row.means for row in sweep.rows)}
    heads = [*(list(sweep.rows[0].combination) or ["combination"]), *COUNTS, *(each.label for each in there.values())]
    lines = [
        [
            *(row.combination.values() or ["all runs"]),
            *(str(row.count(state)) for state in COUNTS),
            *cells(row.means, there),
        ]
        for row in sweep.rows
    ]
    return heads, lines


def not_finished(sweep: Sweep) -> list[list[str]]:
    """Return folder, overrides, state and reason of every job that is not finished."""
    return [
        [
            entry.where or "–",
            " ".join(f"{key}={value}" for key, value in entry.overrides.items() if key not in sweep.alike),
            entry.state,
            entry.why,
        ]
        for entry in sweep.entries
        if entry.state != "finished"
    ]


def as_csv(sweep: Sweep) -> str:
    """Return the table as CSV: swept keys, counts; NAME_mean, NAME_low, NAME_high, shares from 0 to 1."""
    lines = []
    for row in sweep.rows:
        line: dict[str, Any] = {**row.combination, **{state: row.count(state) for state in COUNTS}}
        for name in VALUES:
            mean = row.means.get(name, {"mean": None, "ci95": None})
            low, high = mean["ci95"] or (None, None)
            line |= {f"{name}_mean": mean["mean"], f"{name}_low": low, f"{name}_high": high}
        lines.append(line)
    return str(DataFrame(lines).to_csv(index=False, float_format="%.6g", lineterminator="\n"))
