"""Entries of the benchmark: those committed, pooled over training seeds, as tables.

An entry is a folder `NAME/` with `benchmark.json`. With one such folder for each training seed in it, `NAME/SEED/`,
it counts as one entry: means and Student's t intervals over seeds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, PositiveInt, with_config
from typing_extensions import TypedDict  # pydantic takes that of typing from Python 3.12 on

from hrl_comfort.analysis.intervals import Clusters, Estimate
from hrl_comfort.analysis.tables import Quantity, cell, cells, markdown
from hrl_comfort.config.checks import ConfigError
from hrl_comfort.files.documents import read_json
from hrl_comfort.files.provenance import ROOT

ENTRIES = ROOT / "runs" / "reference" / "benchmark"
"""Folder of the entries in a checkout; a wheel has none."""
FILE = "benchmark.json"


class Level(TypedDict):
    """Results of a policy at a level: means over `shifts`, in the units of QUANTITIES; no level where it changes."""

    level: int | None
    shifts: PositiveInt
    objects_per_min: Estimate
    discomfort_per_min: Estimate
    unsafe_contacts_per_h: Estimate
    avoidable_discomfort_per_min: NotRequired[Estimate | None]
    idle_discomfort_per_min: NotRequired[Estimate | None]
    excess_closeness_mean_m: NotRequired[Estimate | None]
    contacts_per_h: NotRequired[Estimate | None]
    other_collisions_per_h: NotRequired[Estimate | None]
    protective_stops_per_min: NotRequired[Estimate | None]
    arm_distance_mean_m: NotRequired[Estimate | None]
    tool_speed_beside_m_s: NotRequired[Estimate | None]
    person_level_mean: NotRequired[Estimate | None]
    person_rating_mean: NotRequired[Estimate | None]


@with_config(ConfigDict(extra="allow"))
class Entry(TypedDict):
    """A policy, the name and hash of each skill's, what it observes, what was changed of the suite, and the levels."""

    policy: str
    policies: NotRequired[dict[str, str]]
    commit: NotRequired[str | None]
    observation: NotRequired[dict[str, Any]]
    changed: dict[str, Any]
    levels: Annotated[list[Level], Field(min_length=1)]


RATE = (0.0, math.inf)
"""Bounds of a rate."""
QUANTITIES = {
    "objects_per_min": Quantity("objects a minute", digits=2, bounds=RATE),
    "discomfort_per_min": Quantity("discomfort, s a minute", digits=2, bounds=RATE),
    "avoidable_discomfort_per_min": Quantity("avoidable discomfort, s a minute", digits=2, bounds=RATE),
    "idle_discomfort_per_min": Quantity("discomfort of an idle arm, s a minute", digits=2, bounds=RATE),
    "unsafe_contacts_per_h": Quantity("unsafe contacts an hour", digits=2, bounds=RATE),
    "contacts_per_h": Quantity("contacts an hour", digits=1, bounds=RATE),
    "other_collisions_per_h": Quantity("other collisions an hour", digits=1, bounds=RATE),
    "protective_stops_per_min": Quantity("protective stops a minute", digits=2, bounds=RATE),
    "arm_distance_mean_m": Quantity("arm distance, m", digits=2),
    "excess_closeness_mean_m": Quantity("nearer than an idle arm, m", digits=2),
    "tool_speed_beside_m_s": Quantity("tool speed within 1 m, m/s", digits=2),
    "person_level_mean": Quantity("level of a frightened person", digits=2),
    "person_rating_mean": Quantity("rating of a fitted person, 1 to 7", digits=2),
}
"""Columns of the table."""
HEADLINE = (
    "objects_per_min", "discomfort_per_min", "tool_speed_beside_m_s", "arm_distance_mean_m", "unsafe_contacts_per_h",
)  # fmt: skip
"""Quantities of the short table."""
ANSWERS = ("arm_distance_mean_m", "tool_speed_beside_m_s", "objects_per_min")
"""Quantities that a level is meant to change."""


def committed(folder: Path) -> dict[str, Entry]:
    """Return the entries of a folder by name, those of training seeds as one.

    Raises:
      ConfigError: a file is damaged, or the entries of training seeds cannot be pooled.
    """
    return {path.name: read_entry(path) for path in sorted(folder.glob("[!.]*")) if [*path.rglob(FILE)]}


def read_entry(folder: Path) -> Entry:
    """Return the entry in a folder, with the folder's name; raise ConfigError as `committed` does."""
    if (folder / FILE).is_file():
        return {**read_json(folder / FILE, Entry), "policy": folder.name}
    return pooled(folder)


def of_seeds(folder: Path) -> dict[str, Entry]:
    """Return the entries in a folder by the name of their own folder, the training seed.

    Raises:
      ConfigError: there is none, or one is damaged.
    """
    found = {file.parent.name: read_json(file, Entry) for file in sorted(folder.glob(f"[!.]*/{FILE}"))}
    if not found:
        raise ConfigError(f"{folder} holds no entry")
    return found


def pooled(folder: Path) -> Entry:
    """Return the entries of a folder, one a training seed, as one entry with its name.

    Raises:
      ConfigError: there is none, one is damaged, two are of the same policies, or their levels or suites differ.
    """
    seeds = list(of_seeds(folder).values())
    told = [(entry["changed"], [at["level"] for at in entry["levels"]]) for entry in seeds]
    if any(each != told[0] for each in told):
        raise ConfigError(f"{folder}: its entries must be of the same levels and the same suite")
    named = [entry["policies"] for entry in seeds if "policies" in entry]
    if any(one == other for one, other in combinations(named, 2)):
        raise ConfigError(f"{folder}: two of its entries are of the same policies; give one for each training seed")
    runs = Clusters.of_runs(len(seeds))
    levels: list[Any] = []
    for each in zip(*(entry["levels"] for entry in seeds), strict=True):
        rows: tuple[Any, ...] = each
        there = [name for name in QUANTITIES if all(row.get(name) for row in rows)]
        means = {name: np.array([row[name]["mean"] for row in rows]) for name in there}
        numbers = {name: runs.estimate(mean, bounds=QUANTITIES[name].bounds) for name, mean in means.items()}
        levels.append({"level": rows[0]["level"], "shifts": sum(row["shifts"] for row in rows), **numbers})
    count = f"{len(seeds)} seed" + "s" * (len(seeds) > 1)
    return {"policy": f"{folder.name}, {count}", "changed": told[0][0], "levels": levels}


def table(entries: Sequence[Entry], names: Sequence[str] = tuple(QUANTITIES)) -> str:
    """Return quantities of the entries as a Markdown table, a line a level, without those that none of them has.

    A star marks an entry of another suite or split.
    """
    rows: list[Any] = [at for entry in entries for at in entry["levels"]]
    quantities = {name: QUANTITIES[name] for name in names if any(row.get(name) for row in rows)}
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


def name_of(entry: Entry) -> str:
    """Return the name of an entry, with a star if it is of another suite."""
    return entry["policy"] + "*" * bool(entry["changed"])


def responses(folder: Path, off: Path) -> str:
    """Return what levels change, in %, over training seeds: the first against the last, and each against comfort off.

    Each seed of `folder` is compared with that of `off`, at the same level.

    Raises:
      ConfigError: an entry is damaged, or the folders have no seed or not the same levels in common.
    """
    mine, others = pairs(folder, off)
    runs = Clusters.of_runs(len(mine))
    ends = [mine[0]["levels"][at]["level"] for at in (0, -1)]
    for entry in (*mine, *others):
        if [entry["levels"][at]["level"] for at in (0, -1)] != ends:
            raise ConfigError(f"{folder} and {off}: their entries must be of the same levels")
    lines = []
    for name in ANSWERS:
        quantity, line, owns = QUANTITIES[name], [], []
        for at in (0, -1):
            own, without = means(mine, name, at), means(others, name, at)
            line += [cell(runs.estimate(each), quantity.scale, quantity.digits) for each in (own, without)]
            line.append(cell(runs.estimate(own / without - 1), 100))
            owns.append(own)
        lines.append([quantity.label, *line, cell(runs.estimate(owns[1] / owns[0] - 1), 100)])
    heads = [head for level in ends for head in (f"level {level}", f"comfort off, {level}", "change, %")]
    return markdown(["", *heads, f"level {ends[0]} to {ends[1]}, %"], lines)


def differences(folder: Path, other: Path, names: Sequence[str] = tuple(QUANTITIES)) -> str:
    """Return quantities of `folder` less those of `other`, over training seeds, a line for each level of both.

    Raises:
      ConfigError: an entry is damaged, or the folders have no seed in common.
    """
    mine, others = pairs(folder, other)
    runs = Clusters.of_runs(len(mine))
    here, there = ({row["level"]: at for at, row in enumerate(found[0]["levels"])} for found in (mine, others))
    lines = []
    for level in [level for level in here if level in there]:
        gaps = {name: means(mine, name, here[level]) - means(others, name, there[level]) for name in names}
        numbers = [
            cell(runs.estimate(gap), QUANTITIES[name].scale, QUANTITIES[name].digits) for name, gap in gaps.items()
        ]
        lines.append([str(level), *numbers])
    return markdown(["level", *(QUANTITIES[name].label for name in names)], lines)


def means(entries: Sequence[Entry], quantity: str, at: int) -> NDArray[np.float64]:
    """Return the mean (n,) of a quantity in n entries, at their level number `at`."""
    rows: list[Any] = [entry["levels"][at] for entry in entries]
    return np.array([row[quantity]["mean"] for row in rows])


def pairs(folder: Path, other: Path) -> tuple[list[Entry], list[Entry]]:
    """Return the entries (n,) of the training seeds that two folders have in common.

    Raises:
      ConfigError: there is none, or an entry is damaged.
    """
    mine, others = of_seeds(folder), of_seeds(other)
    names = sorted(mine.keys() & others.keys())
    if not names:
        raise ConfigError(f"{folder} and {other} have no training seed in common")
    return [mine[name] for name in names], [others[name] for name in names]


def at_same_throughput(folder: Path, fixed: Path) -> str:
    """Return a frightened person's level beside a robot that is told of it, and beside fixed levels as productive.

    The latter is the best that a mix of two fixed levels gives at the same objects a minute, some shifts being worked
    at one and some at the other.

    Raises:
      ConfigError: an entry is damaged, the folders have no seed in common or other policies for it, or no mix is as
        productive.
    """
    columns = []
    for told, untold in zip(*pairs(folder, fixed), strict=True):
        if told.get("policies") != untold.get("policies"):
            raise ConfigError(f"{folder} and {fixed}: {told['policy']!r} and {untold['policy']!r} are other policies")
        (objects, person), *_ = work_and_mood(told)
        same = best_mix(work_and_mood(untold), objects)
        if same is None:
            raise ConfigError(f"{folder}: no mix of the levels in {fixed} gives {objects:g} objects a minute")
        columns.append((objects, person, same, person - same))
    runs = Clusters.of_runs(len(columns))
    heads = ["objects a minute", "person's level, told", "the same, at fixed levels", "difference"]
    return markdown(heads, [[cell(runs.estimate(np.array(each)), digits=2) for each in zip(*columns, strict=True)]])


def best_mix(points: Sequence[tuple[float, float]], x: float) -> float | None:
    """Return the largest y at `x` of the lines between any two points (x, y); None if none reaches so far."""
    found = [y for at, y in points if at == x]
    for (low, y_low), (high, y_high) in combinations(sorted(points), 2):
        if low <= x <= high and low < high:
            found.append(y_low + (y_high - y_low) * (x - low) / (high - low))
    return max(found, default=None)


def work_and_mood(entry: Entry) -> list[tuple[float, float]]:
    """Return the objects a minute and the level of a frightened person at each level of an entry."""
    rows: list[Any] = list(entry["levels"])
    return [(row["objects_per_min"]["mean"], row["person_level_mean"]["mean"]) for row in rows]
