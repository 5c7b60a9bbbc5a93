"""Fill the tables of docs/reproduce.md and docs/benchmarks.md from committed files: `python docs/tables.py`.

A table stands between `<!-- evaluations: FOLDER ... -->` and `<!-- end -->`. Folders are those of
evaluations in runs/reference; one with a `*` pools the episodes of all that match (say, of three training
seeds). A table of comfort levels stands between `<!-- levels: FILE -->` and `<!-- end -->`; the file, in
runs/reference, is what `hrl-comfort figure kind=levels` or `kind=speed` writes beside its picture. One of
several series of levels stands after `<!-- series: FILE -->`; its file is that of `kind=plane`. One of
controllers stands after `<!-- controllers: FILE -->`, of divisions after `<!-- divisions: FILE -->`, of
handovers after `<!-- handover: FILE -->`; their files are those of the `kind` of the same name. One of
benchmarks stands after `<!-- bench env: FILE -->` or another of OTHERS.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hrl_comfort.experiments.bench_cores import table as cores
from hrl_comfort.experiments.bench_start import table as start
from hrl_comfort.experiments.bench_together import table as together

from hrl_comfort.analysis.intervals import column, describe, read_rows
from hrl_comfort.analysis.tables import markdown, series
from hrl_comfort.benchmarks.env import table as environment
from hrl_comfort.benchmarks.train import table as learning
from hrl_comfort.benchmarks.update import table as update
from hrl_comfort.plots.controllers import table as controllers
from hrl_comfort.plots.divisions import table as divisions
from hrl_comfort.plots.handover import table as handover

ROOT = Path(__file__).resolve().parent.parent
PAGES = (ROOT / "docs" / "reproduce.md", ROOT / "docs" / "benchmarks.md")
REFERENCE = ROOT / "runs" / "reference"
MARKED = re.compile(r"(<!-- evaluations: ([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
SERIES = re.compile(r"(<!-- series: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
LEVELS = re.compile(r"(<!-- levels: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
OTHERS: dict[str, Callable[[Any], str]] = {
    "controllers": controllers, "divisions": divisions, "handover": handover,
    "bench env": environment, "bench update": update, "bench start": start,
    "bench train": learning, "bench cores": cores, "bench together": together,
}  # fmt: skip
"""What one file, by itself, is a table of."""
OTHER = re.compile(rf"(<!-- ({'|'.join(OTHERS)}): (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
COLUMNS = (
    "evaluation", "episodes", "success, % [95 %]", "on seen spawns", "on unseen spawns", "steps",
    "human distance, m", "human hit, %", "cell or self hit, %",
)  # fmt: skip


def table(folders: list[str]) -> str:
    """Return the Markdown table of evaluations, one line each."""
    head = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"
    return head + "".join(line(name) for name in folders)


def line(name: str) -> str:
    """Return the line of one evaluation, or of the pooled episodes of those that match."""
    found = sorted(REFERENCE.glob(f"{name}/episodes.csv"))
    if not found:
        raise FileNotFoundError(f"no runs/reference/{name}/episodes.csv")
    rows = [row for path in found for row in read_rows(path)]
    success = column(rows, "success")
    described = describe(success, [row["train_seed"] for row in rows], share=True)
    assert described is not None, f"{name} has no episode"
    low, high = described["ci95"]
    cells = [name.removesuffix("/eval"), str(len(rows)), f"{100 * success.mean():.1f}"]
    cells[-1] += f" [{100 * low:.1f}, {100 * high:.1f}]"
    seen = column(rows, "seen") > 0
    cells += [f"{100 * success[which].mean():.1f}" for which in (seen, ~seen)]
    for metric, digits in (("steps", 0), ("human_distance_mean_m", 3)):
        values = column(rows, metric)[success > 0]
        cells.append(f"{values.mean():.{digits}f}" if len(values) else "–")
    cells.append(f"{100 * column(rows, 'human_collision').mean():.1f}")
    cells.append(f"{100 * sum(row['other_collision'] != 'none' for row in rows) / len(rows):.1f}")
    return "| " + " | ".join(cells) + " |\n"


def filled(page: str) -> str:
    """Return the page with every marked table made anew."""
    page = MARKED.sub(lambda found: found[1] + table(found[2].split()) + found[3], page)
    page = LEVELS.sub(lambda found: found[1] + levels(found[2]) + found[3], page)
    page = SERIES.sub(lambda found: found[1] + several(found[2]) + found[3], page)
    return OTHER.sub(lambda found: found[1] + OTHERS[found[2]](contents(found[3])) + found[4], page)


def contents(name: str) -> Any:
    """Return the rows of a CSV, or what a JSON file holds; `name` is in runs/reference."""
    return read_rows(REFERENCE / name) if name.endswith(".csv") else numbers(name)


def numbers(name: str) -> dict[str, Any]:
    """Return what the file `name` in runs/reference holds."""
    found: dict[str, Any] = json.loads((REFERENCE / name).read_text(encoding="utf-8"))
    return found


def levels(name: str) -> str:
    """Return the table of the comfort levels whose numbers are in the file `name`."""
    return markdown(numbers(name))


def several(name: str) -> str:
    """Return the table of the series of levels whose numbers are in the file `name`."""
    return series({label: summaries["each"] for label, summaries in numbers(name).items()})


if __name__ == "__main__":
    for each in PAGES:
        each.write_text(filled(each.read_text(encoding="utf-8")), encoding="utf-8")
