"""Entries of the benchmark: those committed, pooled over training seeds, as tables.

An entry is a folder `NAME/` with `benchmark.json`. With one such folder for each training seed in it, `NAME/SEED/`,
it counts as one entry: means and Student's t intervals over seeds. Its parts are tasks of the suite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, PositiveInt, with_config
from typing_extensions import TypedDict  # pydantic takes that of typing from Python 3.12 on

from hrl_comfort.analysis.intervals import Clusters, Estimate
from hrl_comfort.analysis.mixes import WORK
from hrl_comfort.analysis.tables import Quantity, cell, cells, markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.config.suite import SUITE
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
    orders_missed_per_min: NotRequired[Estimate | None]
    contacts_per_h: NotRequired[Estimate | None]
    other_collisions_per_h: NotRequired[Estimate | None]
    protective_stops_per_min: NotRequired[Estimate | None]
    arm_distance_mean_m: NotRequired[Estimate | None]
    tool_speed_beside_m_s: NotRequired[Estimate | None]
    person_level_mean: NotRequired[Estimate | None]
    person_rating_mean: NotRequired[Estimate | None]


@with_config(ConfigDict(extra="allow"))
class Entry(TypedDict):
    """A policy: name and hash of each skill's, top, what it observes, what it changed of the suite, levels by part."""

    policy: str
    policies: NotRequired[dict[str, str]]
    top: NotRequired[dict[str, Any]]
    commit: NotRequired[str | None]
    observation: NotRequired[dict[str, Any]]
    changed: dict[str, Any]
    parts: Annotated[dict[str, Annotated[list[Level], Field(min_length=1)]], Field(min_length=1)]


RATE = (0.0, math.inf)
"""Bounds of a rate."""
QUANTITIES = {
    "objects_per_min": Quantity("objects a minute", digits=2, bounds=RATE),
    "discomfort_per_min": Quantity("discomfort, s a minute", digits=2, bounds=RATE),
    "avoidable_discomfort_per_min": Quantity("avoidable discomfort, s a minute", digits=2, bounds=RATE),
    "idle_discomfort_per_min": Quantity("discomfort of an idle arm, s a minute", digits=2, bounds=RATE),
    "orders_missed_per_min": Quantity("orders missed a minute", digits=2, bounds=RATE),
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
"""Columns of the table; `quantity` has the labels of a part."""
ANSWERS = ("arm_distance_mean_m", "excess_closeness_mean_m", "tool_speed_beside_m_s", "objects_per_min")
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
    told = [(entry["changed"], entry.get("top"), levels_of(entry)) for entry in seeds]
    if any(each != told[0] for each in told):
        raise ConfigError(f"{folder}: its entries must be of the same levels, the same top and the same suite")
    named = [entry["policies"] for entry in seeds if "policies" in entry]
    if any(one == other for one, other in combinations(named, 2)):
        raise ConfigError(f"{folder}: two of its entries are of the same policies; give one for each training seed")
    count = f"{len(seeds)} seed" + "s" * (len(seeds) > 1)
    parts = {part: _over_seeds([entry["parts"][part] for entry in seeds]) for part in seeds[0]["parts"]}
    whole: Entry = {"policy": f"{folder.name}, {count}", "changed": told[0][0], "parts": parts}
    if "top" in seeds[0]:
        whole["top"] = seeds[0]["top"]
    return whole


def _over_seeds(seeds: Sequence[Sequence[Level]]) -> list[Level]:
    """Return the levels of n training seeds as means over them."""
    runs, levels = Clusters.of_runs(len(seeds)), list[Any]()
    for each in zip(*seeds, strict=True):
        rows: tuple[Any, ...] = each
        there = [name for name in QUANTITIES if all(row.get(name) for row in rows)]
        means = {name: np.array([row[name]["mean"] for row in rows]) for name in there}
        numbers = {name: runs.estimate(mean, bounds=QUANTITIES[name].bounds) for name, mean in means.items()}
        levels.append({"level": rows[0]["level"], "shifts": sum(row["shifts"] for row in rows), **numbers})
    return levels


def levels_of(entry: Entry) -> dict[str, list[int | None]]:
    """Return the levels of an entry by part."""
    return {part: [at["level"] for at in levels] for part, levels in entry["parts"].items()}


def levels_in(entry: Entry, part: str) -> list[Level]:
    """Return the levels of a part of an entry; raise ConfigError if it has no such part."""
    if part not in entry["parts"]:
        has = ", ".join(entry["parts"])
        raise ConfigError(f"the entry of {entry['policy']!r} has no part {part}; it has {has}")
    return entry["parts"][part]


def quantity(name: str, part: str) -> Quantity:
    """Return a quantity with its label in a part: the objects of an order fill it."""
    return replace(QUANTITIES[name], label=WORK[part]) if name == "objects_per_min" else QUANTITIES[name]


def tables(entries: Sequence[Entry]) -> str:
    """Return the table of each part of the entries under its name."""
    there = [part for part in SUITE if any(part in entry["parts"] for entry in entries)]
    return "\n".join(f"{part}\n\n{table(part, entries)}" for part in there)


def table(part: str, entries: Sequence[Entry]) -> str:
    """Return quantities of the entries that have a part, a line a level, without those that none of them has.

    A star marks an entry of another suite or split.
    """
    entries = [entry for entry in entries if part in entry["parts"]]
    rows: list[Any] = [at for entry in entries for at in entry["parts"][part]]
    quantities = {name: quantity(name, part) for name in QUANTITIES if any(row.get(name) for row in rows)}
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
            for at in entry["parts"][part]
        ),
    )


def name_of(entry: Entry) -> str:
    """Return the name of an entry, with a star if it is of another suite."""
    return entry["policy"] + "*" * bool(entry["changed"])


def responses(part: str, folder: Path) -> str:
    """Return the quantities that levels are meant to change, at each level, and the first level's change to the last.

    Numbers are over training seeds; the change is of each seed, in %, and left out where a first value is not positive.

    Raises:
      ConfigError: an entry is damaged or lacks the part, or the seeds' levels differ.
    """
    seeds, lines = [levels_in(entry, part) for entry in of_seeds(folder).values()], []
    runs, levels = Clusters.of_runs(len(seeds)), [at["level"] for at in seeds[0]]
    if any([at["level"] for at in seed] != levels for seed in seeds):
        raise ConfigError(f"{folder}: its entries must be of the same levels")
    for name in ANSWERS:
        shown, values = quantity(name, part), [means(seeds, name, at) for at in range(len(levels))]
        first, last = values[0], values[-1]
        change = cell(runs.estimate(last / first - 1), 100) if (first > 0).all() else "–"
        lines.append([shown.label, *(cell(runs.estimate(each), shown.scale, shown.digits) for each in values), change])
    return markdown(["", *(f"level {level}" for level in levels), f"level {levels[0]} to {levels[-1]}, %"], lines)


def means(entries: Sequence[Sequence[Level]], name: str, at: int) -> NDArray[np.float64]:
    """Return the mean (n,) of a quantity in the levels of n entries, at their level number `at`.

    Raises:
      ConfigError: an entry lacks the quantity.
    """
    rows: list[Any] = [levels[at] for levels in entries]
    if any(name not in row for row in rows):
        raise ConfigError(f"an entry lacks {name}; measure it again")
    return np.array([row[name]["mean"] for row in rows])


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
