"""Returns of entries of `kitting`: what a controller earns beside the best of its rivals, chosen in hindsight."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.benchmarks.entries import Entry, levels_in
from hrl_comfort.benchmarks.throughput import of_each_seed
from hrl_comfort.config import ConfigError

MISSED = 0.5
"""Cost of an order missed, in orders filled, as in conf/reward/kitting.yaml."""
PART = "kitting"
TERMS = ("objects_per_min", "orders_missed_per_min", "avoidable_discomfort_per_min")


def of_rivals(price: float, folder: Path, rivals: Sequence[Path]) -> str:
    """Return the return a minute of an entry beside that of its best rival at each level, which is named.

    A return is the orders filled, less MISSED of those missed, less `price` for a second of avoidable discomfort.
    Numbers are over training seeds; rivals with training seeds are paired by them. The best rival has the highest mean.

    Raises:
      ConfigError: two folders have the same name; an entry is damaged, lacks the part or a term, or was not measured at
        a level; or rivals have no training seed in common.
    """
    names = [each.name for each in (folder, *rivals)]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ConfigError(
            f"{twice[0]} is the name of {names.count(twice[0])} folders, but names the best rival; rename one"
        )
    own, beside = of_each_seed(folder), {rival.name: of_each_seed(rival) for rival in rivals}
    seeds = [seed for seed in own if all(seed in each or None in each for each in beside.values())]
    if not seeds:
        raise ConfigError(f"{folder} has no training seed in common with its rivals")
    runs, lines = Clusters.of_runs(len(seeds)), []
    earned = {
        name: [returns(each.get(seed) or each[None], price) for seed in seeds]
        for name, each in {folder.name: own, **beside}.items()
    }
    for level in earned[folder.name][0]:
        found = {name: np.array([at(each, level, name) for each in those]) for name, those in earned.items()}
        mine, theirs = found[folder.name], {name: found[name] for name in beside}
        best = max(theirs, key=lambda name: float(theirs[name].mean()))
        above = mine - theirs[best]
        share = cell(runs.estimate(above / theirs[best]), 100) if (theirs[best] > 0).all() else "–"
        shown = (cell(runs.estimate(each), digits=2) for each in (mine, theirs[best], above))
        lines.append([str(level), *shown, share, f"`{best}`"])
    heads = ["level", "return a minute", "of the best rival", "difference", "difference, %", "best rival"]
    return markdown(heads, lines)


def returns(entry: Entry, price: float) -> dict[int | None, float]:
    """Return the return a minute of an entry by level; raise ConfigError if it lacks the part or a term."""
    rows: list[Any] = levels_in(entry, PART)
    if absent := [name for name in TERMS if not all(row.get(name) for row in rows)]:
        raise ConfigError(f"the entry of {entry['policy']!r} has no {absent[0]}; measure it again")
    weights = (1.0, -MISSED, -price)
    return {
        row["level"]: sum(weight * row[name]["mean"] for weight, name in zip(weights, TERMS, strict=True))
        for row in rows
    }


def at(found: dict[int | None, float], level: int | None, name: str) -> float:
    """Return the return at a level; raise ConfigError if it was not measured there."""
    if level not in found:
        raise ConfigError(f"{name} was not measured at level {level}, but at {', '.join(map(str, found))}")
    return found[level]
