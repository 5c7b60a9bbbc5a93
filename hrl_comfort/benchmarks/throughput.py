"""Comparisons at equal throughput: an entry beside the best mix of others that does as much work."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.mixes import IDLE, WORK, Points, best_mix
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.benchmarks.entries import FILE, Entry, levels_in, of_seeds, pairs
from hrl_comfort.config import ConfigError
from hrl_comfort.files.documents import read_json

COMPARED = "both compared at"
"""Head of the column of the throughput to which entries rest."""
X, Y, PERSON = "objects_per_min", "avoidable_discomfort_per_min", "person_rating_mean"


def of_a_told_robot(part: str, folder: Path, fixed: Path, idle: Path) -> str:
    """Return a fitted person's rating of a robot that is told of it, and of fixed levels as productive.

    The latter is the best mix of the levels of `fixed` and the rest of `idle` with as much work, for each training
    seed. A seed that does more work than every level rests for a part of the time.

    Raises:
      ConfigError: an entry is damaged, or the folders have no seed in common or other policies for it.
    """
    own, others = pairs(folder, fixed)
    for told, untold in zip(own, others, strict=True):
        if told.get("policies") != untold.get("policies"):
            raise ConfigError(f"{folder} and {fixed}: {told['policy']!r} and {untold['policy']!r} are other policies")
    at_rest = float(np.mean([each for _, each in points(read_json(idle / FILE, Entry), part, PERSON).values()]))
    found = [at_level(points(entry, part, PERSON), None, folder) for entry in own]
    mixed = [[(0.0, at_rest), *points(entry, part, PERSON).values()] for entry in others]
    line = [_work(found), *cells(beside_mixes(found, mixed, max, at_rest))[:-1]]
    heads = ["its rating there (1 to 7)", "that of the best mix of fixed levels", "difference"]
    return markdown([WORK[part], COMPARED, *heads], [line])


def of_rivals(part: str, folder: Path, rivals: Sequence[Path]) -> str:
    """Return the avoidable discomfort of an entry less that of the best mix of rivals and an idle arm as productive.

    There is a line a level. Numbers are over training seeds; rivals with training seeds are paired by them. A seed
    that does more work than every rival rests for a part of the time, so that it does as much as the best of them.

    Raises:
      ConfigError: an entry is damaged, lacks the part, a level or the discomfort, or rivals have no training seed in
        common.
    """
    own, beside = of_seeds(folder), [of_each_seed(rival) for rival in rivals]
    seeds = [seed for seed in sorted(own) if all(seed in each or None in each for each in beside)]
    if not seeds:
        raise ConfigError(f"{folder} has no training seed in common with its rivals")
    mine = {seed: points(own[seed], part, Y) for seed in seeds}
    theirs = {seed: [points(each.get(seed) or each[None], part, Y) for each in beside] for seed in seeds}
    lines = []
    for level in mine[seeds[0]]:
        mixed = [[IDLE, *(at_level(each, level, folder) for each in theirs[seed])] for seed in seeds]
        found = [at_level(mine[seed], level, folder) for seed in seeds]
        lines.append([str(level), _work(found), *cells(beside_mixes(found, mixed, min))])
    heads = ["its avoidable discomfort there, s a minute", "that of the best mix", "difference", "difference, %"]
    return markdown(["level", WORK[part], COMPARED, *heads], lines)


def _work(found: Points) -> str:
    """Return the cell of the throughput of n seeds."""
    return cell(Clusters.of_runs(len(found)).estimate(np.array([each for each, _ in found])), digits=2)


def resting(point: tuple[float, float], most: float, at_rest: float = 0.0) -> tuple[float, float]:
    """Return the throughput and another quantity of a policy that rests until it does no more work than `most`.

    The quantity of an arm that rests is `at_rest`.
    """
    share = min(1.0, most / point[0]) if point[0] else 1.0
    return (min(point[0], most), share * point[1] + (1 - share) * at_rest)


def of_each_seed(folder: Path) -> dict[str | None, Entry]:
    """Return the entries in a folder by training seed; under None the one of a policy that was not trained."""
    if (folder / FILE).is_file():
        return {None: read_json(folder / FILE, Entry)}
    return dict(of_seeds(folder).items())


def points(entry: Entry, part: str, quantity: str) -> dict[int | None, tuple[float, float]]:
    """Return throughput and another quantity of an entry by level; raise ConfigError if it lacks the part or either."""
    rows: list[Any] = levels_in(entry, part)
    if not all(row.get(quantity) for row in rows):
        raise ConfigError(f"the entry of {entry['policy']!r} has no {quantity}; measure it again")
    return {row["level"]: (row[X]["mean"], row[quantity]["mean"]) for row in rows}


def at_level(found: Mapping[int | None, tuple[float, float]], level: int | None, folder: Path) -> tuple[float, float]:
    """Return the point at a level of those `found`; raise ConfigError if it was not measured there."""
    if level not in found:
        there = ", ".join("of the person" if each is None else str(each) for each in found)
        missing = "the person's own level" if level is None else f"level {level}"
        raise ConfigError(f"{folder} and what it is compared with: {missing} was not measured, but {there}")
    return found[level]


def beside_mixes(
    own: Points, others: Sequence[Points], best: Callable[[Iterable[float]], float], at_rest: float = 0.0
) -> NDArray[np.float64]:
    """Return the throughput, the quantity, and that of the best mix of `others` as productive, of n seeds (n, 3).

    A seed that does more work than all of its others, one of which is an idle arm, rests until it does as much.
    """
    rows = []
    for point, points in zip(own, others, strict=True):
        x, y = resting(point, max(most for most, _ in points), at_rest)
        mixed = best_mix(points, x, best)
        assert mixed is not None
        rows.append((x, y, mixed))
    return np.array(rows)


def cells(rows: NDArray[np.float64]) -> list[str]:
    """Return the cells of a line: means (n, 3) of `beside_mixes` over seeds, and the difference, also in %."""
    runs, (_, own, mix) = Clusters.of_runs(len(rows)), rows.T
    share = cell(runs.estimate(own / mix - 1), 100) if (mix > 0).all() else "–"
    return [*(cell(runs.estimate(each), digits=2) for each in (*rows.T, own - mix)), share]
