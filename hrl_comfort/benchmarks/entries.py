"""Entries of the benchmark: those committed, pooled over training seeds, as tables.

An entry is `NAME.json`. A folder `NAME/` has one a training seed, and counts as one entry: means and Student's t
intervals over seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.tables import Quantity, cell, cells, markdown
from hrl_comfort.config.checks import ConfigError
from hrl_comfort.evaluation.ledger import FILE
from hrl_comfort.files.documents import read_json

ENTRIES = FILE.parent / "benchmark"
"""Folder of the entries."""
Entry = dict[str, Any]
QUANTITIES = {
    "balls_per_min": Quantity("balls a minute", digits=2),
    "discomfort_per_min": Quantity("discomfort, s a minute", digits=2),
    "unsafe_contacts_per_h": Quantity("unsafe contacts an hour", digits=2),
    "contacts_per_h": Quantity("contacts an hour", digits=1),
    "other_collisions_per_h": Quantity("other collisions an hour", digits=1),
    "protective_stops_per_min": Quantity("protective stops a minute", digits=2),
    "arm_distance_mean_m": Quantity("arm distance, m", digits=2),
    "tool_speed_beside_m_s": Quantity("tool speed within 1 m, m/s", digits=2),
    "person_level_mean": Quantity("level of a frightened person", digits=2),
}
"""Columns of the table."""
HEADLINE = (
    "balls_per_min", "discomfort_per_min", "tool_speed_beside_m_s", "arm_distance_mean_m", "unsafe_contacts_per_h",
)  # fmt: skip
"""Quantities of the short table."""
ANSWERS = ("arm_distance_mean_m", "tool_speed_beside_m_s", "balls_per_min")
"""Quantities that a level is meant to change."""


def committed(folder: Path) -> list[Entry]:
    """Return the entries of a folder by name, those of a sub-folder as one.

    Raises:
      ConfigError: the entries of a sub-folder differ in their levels or in what they changed of the suite.
    """
    found = sorted(path for path in folder.glob("*") if path.is_dir() or path.suffix == ".json")
    return [pooled(path) if path.is_dir() else read_json(path, dict) for path in found]


def of_seeds(folder: Path) -> dict[str, Entry]:
    """Return the entries of a folder by the name of their file, the training seed."""
    return {file.stem: read_json(file, dict) for file in sorted(folder.glob("*.json"))}


def pooled(folder: Path) -> Entry:
    """Return the entries of a folder, one a training seed, as one entry with its name."""
    seeds = list(of_seeds(folder).values())
    told = [(entry["changed"], [at["level"] for at in entry["levels"]]) for entry in seeds]
    if not seeds or any(each != told[0] for each in told):
        raise ConfigError(f"{folder}: its entries must be of the same levels and the same suite")
    runs = Clusters.of_runs(len(seeds))
    levels: list[dict[str, Any]] = []
    for each in zip(*(entry["levels"] for entry in seeds), strict=True):
        level = {"level": each[0]["level"], "shifts": sum(at["shifts"] for at in each)}
        there = [name for name in QUANTITIES if all(name in at for at in each)]
        levels.append(level | {name: runs.estimate(np.array([at[name]["mean"] for at in each])) for name in there})
    return {"policy": f"{folder.name}, {len(seeds)} seeds", "changed": told[0][0], "levels": levels}


def table(entries: Sequence[Entry], names: Sequence[str] = tuple(QUANTITIES)) -> str:
    """Return quantities of the entries as a Markdown table, a line a level.

    A star marks an entry of another suite or split.
    """
    quantities = {name: QUANTITIES[name] for name in names}
    return markdown(
        ["policy", "level", "shifts", *(each.label for each in quantities.values())],
        (
            [
                name_of(entry),
                "–" if at["level"] is None else str(at["level"]),
                str(at["shifts"]),
                *cells(at, quantities),
            ]
            for entry in entries
            for at in entry["levels"]
        ),
    )


def name_of(entry: Mapping[str, Any]) -> str:
    """Return the name of an entry, with a star if it is of another suite."""
    return entry["policy"] + "*" * bool(entry["changed"])


def responses(folder: Path, off: Path) -> str:
    """Return what levels change: the first against the last and each against comfort off, in %, over training seeds.

    Seeds that both folders have are compared, each with its own.
    """
    mine, others = of_seeds(folder), of_seeds(off)
    names = sorted(mine.keys() & others.keys())
    runs = Clusters.of_runs(len(names))
    lines = []
    for quantity in ANSWERS:
        first, last = (means([mine[name] for name in names], quantity, end) for end in (0, -1))
        without = means([others[name] for name in names], quantity, 0)
        scale = QUANTITIES[quantity]
        changes = (last / first - 1, first / without - 1, last / without - 1)
        lines.append(
            [
                scale.label,
                *(cell(runs.estimate(each), scale.scale, scale.digits) for each in (first, without, last)),
                *(cell(runs.estimate(each), 100) for each in changes),
            ]
        )
    start, end = (mine[names[0]]["levels"][at]["level"] for at in (0, -1))
    heads = ["", f"level {start}", "comfort off", f"level {end}", f"{start} to {end}, %"]
    return markdown([*heads, f"{start} against off, %", f"{end} against off, %"], lines)


def means(entries: Sequence[Entry], quantity: str, at: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the mean (n,) of a quantity in n entries, at their level number `at`."""
    return np.array([entry["levels"][at][quantity]["mean"] for entry in entries])


def at_same_throughput(folder: Path, fixed: Path) -> str:
    """Return a frightened person's level beside a robot that is told of it, and beside fixed levels as productive.

    Between two fixed levels balls and the person's level are interpolated, as when some shifts are worked at one and
    some at the other.
    """
    told, untold = of_seeds(folder), of_seeds(fixed)
    names = sorted(told.keys() & untold.keys())
    runs = Clusters.of_runs(len(names))
    columns = []
    for name in names:
        (mine, person), *_ = work_and_mood(told[name])
        balls, moods = zip(*sorted(work_and_mood(untold[name])), strict=True)
        same = float(np.interp(mine, balls, moods))
        columns.append((mine, person, same, person - same))
    heads = ["balls a minute", "person's level, told", "the same, at a fixed level", "difference"]
    return markdown(heads, [[cell(runs.estimate(np.array(each)), digits=2) for each in zip(*columns, strict=True)]])


def work_and_mood(entry: Entry) -> list[tuple[float, float]]:
    """Return the balls a minute and the level of a frightened person at each level of an entry."""
    return [(at["balls_per_min"]["mean"], at["person_level_mean"]["mean"]) for at in entry["levels"]]
