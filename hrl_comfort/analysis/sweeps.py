"""A sweep as one table: a row a combination of what was swept, its training seeds pooled.

A mean is over the finished runs of a combination, one value each, with Student's 95 % interval over them.
Runs that are not finished are counted, and in no mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame, Series

from hrl_comfort.analysis.comfort import DISTANCE, STEPS
from hrl_comfort.analysis.intervals import SHARE, Clusters, Estimate
from hrl_comfort.analysis.learning_curve import LearningCurve, curve_of, training_end
from hrl_comfort.analysis.tables import Quantity, cells
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run, read_result
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


POSITIVE = (0.0, np.inf)
QUANTITIES = {
    "eval_success": Quantity("evaluated success (%)", 100, 1, SHARE),
    "eval_precision_m": Quantity("evaluated at (cm)", 100, 1, POSITIVE),
    "eval_steps": Quantity("evaluated steps", digits=1, bounds=POSITIVE),
    "eval_human_distance_mean_m": Quantity("evaluated distance (m)", bounds=POSITIVE),
    "eval_contact": Quantity("evaluated contacts (%)", 100, 1, SHARE),
    "success": Quantity("training success (%)", 100, 1, SHARE),
    "return": Quantity("return", digits=2),
    "steps": Quantity("steps", digits=1, bounds=POSITIVE),
    "placed": Quantity("objects placed", digits=2, bounds=POSITIVE),
    "precision_m": Quantity("training at (cm)", 100, 1, POSITIVE),
    "minutes": Quantity("training (min)", digits=1, bounds=POSITIVE),
}


def numbers_of(run: Run) -> dict[str, float | None]:
    """Return the values of QUANTITIES in a run; NaN or None, or none at all, where it has none."""
    found: dict[str, float | None] = {} if run.metrics is None else {**training_end(run.metrics)}
    found["minutes"] = run.minutes
    if run.episodes is not None:
        won = column(run.episodes, "success") > 0
        for name in ("success", "precision_m", STEPS, DISTANCE, "contact"):
            values = Series(column(run.episodes, name))
            found[f"eval_{name}"] = (values[won] if name in (STEPS, DISTANCE) else values).mean()
    return found


@dataclass(frozen=True)
class Row:
    """A combination of what was swept."""

    combination: dict[str, str]
    """Swept key -> value; a dash where a job did not say."""
    entries: list[Entry]
    means: dict[str, Estimate]
    """Quantities to mean and interval over the finished runs."""

    @property
    def name(self) -> str:
        """The combination in words."""
        return ", ".join(f"{key}={value}" for key, value in self.combination.items()) or "all runs"

    @property
    def counts(self) -> dict[str, int]:
        """The number of its jobs that are `finished`, `unfinished` and `failed`."""
        return {state: sum(entry.state == state for entry in self.entries) for state in COUNTS}


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
    return dict(line.lstrip("+").partition("=")[::2] for line in overrides)


def _entry(folder: Path, where: Path, job: Job) -> Entry:
    """Return a job that has begun, with its state and why it is not finished."""
    run = read_result(where)
    if job.verb.startswith("train"):
        finished = run.provenance is not None and run.provenance.finished
    else:
        finished = job.state == "done" and run.groups is not None
    state, why = "unfinished", job.why or "running, or killed"
    if finished:
        state, why = "finished", ""
    elif job.state == "failed":
        state, why = "failed", job.why
    elif run.metrics is not None:
        progress = curve_of(run.metrics).progress
        why += f", {run.metrics[progress].iloc[-1]:.0f} {progress.replace('_', ' ')} logged"
    return Entry(_told(job.overrides), str(where.relative_to(folder)), state, why, run)


def _means(entries: Sequence[Entry]) -> dict[str, Estimate]:
    runs = [entry.run for entry in entries if entry.state == "finished" and entry.run is not None]
    values = DataFrame([numbers_of(run) for run in runs], columns=list(QUANTITIES), dtype=float)
    return Clusters.of_runs(len(runs)).estimates(values, {name: each.bounds for name, each in QUANTITIES.items()})


def table(sweep: Sweep) -> tuple[list[str], list[list[str]]]:
    """Return heads and lines of the table as text; a quantity that no run has is left out."""
    there = {name: each for name, each in QUANTITIES.items() if any(name in row.means for row in sweep.rows)}
    heads = [*(list(sweep.rows[0].combination) or ["combination"]), *COUNTS, *(each.label for each in there.values())]
    lines = [
        [*(row.combination.values() or ["all runs"]), *map(str, row.counts.values()), *cells(row.means, there)]
        for row in sweep.rows
    ]
    return heads, lines


def not_finished(sweep: Sweep) -> list[list[str]]:
    """Return folder, overrides, state and reason of every job that is not finished."""
    lines = []
    for entry in sweep.entries:
        if entry.state != "finished":
            own = [f"{key}={value}" for key, value in entry.overrides.items() if key not in sweep.alike]
            lines.append([entry.where or "–", " ".join(own), entry.state, entry.why])
    return lines


def as_csv(sweep: Sweep) -> str:
    """Return the table as CSV: swept keys, counts; NAME_mean, NAME_low, NAME_high, shares from 0 to 1."""
    lines = []
    for row in sweep.rows:
        line: dict[str, Any] = {**row.combination, **row.counts}
        for name in QUANTITIES:
            each = row.means.get(name)
            low, high = (each and each["ci95"]) or (None, None)
            line |= {f"{name}_mean": each and each["mean"], f"{name}_low": low, f"{name}_high": high}
        lines.append(line)
    return str(DataFrame(lines).to_csv(index=False, float_format="%.6g", lineterminator="\n"))
