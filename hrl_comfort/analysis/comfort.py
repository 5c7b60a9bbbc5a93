"""What the comfort level changes: from rows of episodes.csv, means at each level and paired changes.

Every level runs the same entries of the evaluation set, so episodes pair across levels: same spawn point,
same walk, same colour. Over `pairs` a number is a mean over the entries that succeed at every level compared;
over `all` over all of them, a failure's steps counted at the time limit, everything else as measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.analysis.clusters import Clusters
from hrl_comfort.analysis.intervals import RESAMPLES, Floats, Row, column, wilson_interval
from hrl_comfort.config import ConfigError

DISTANCE, STEPS, SPEED = "human_distance_mean_m", "steps", "joint_increment_mean_deg"
MEASURED = (DISTANCE, STEPS, "human_distance_by_path_m", "tool_path_m", "waiting_share", SPEED)
RATES = ("success", "moving_collision", "human_collision", "other_collision")
"""Shares of all episodes: success; the moving robot hit the person; any collision with the person; with cell
or itself."""
OVER = ("pairs", "all")
SAME = ("task", "precision_m")
"""Columns that everything compared must agree in."""
SAME_ENTRY = ("spawn_id", "motion_id", "colour")
"""Columns that an entry of the evaluation set must have alike at every level."""
Limit = Callable[[int], int]
"""An episode's time limit in control steps, by its level."""


@dataclass(frozen=True)
class Paired:
    """Episodes of L levels side by side: n entries, each a training seed's run of one evaluation entry."""

    levels: tuple[int, ...]
    entry: NDArray[np.str_]
    """(n,) entry of the evaluation set: the same for every training seed that ran it."""
    seed: NDArray[np.str_]
    """(n,) training seed; empty where nothing was trained."""
    spawn: NDArray[np.str_]
    """(n,) spawn point."""
    seen: Floats
    """(n,) whether training may use the spawn point."""
    values: dict[str, Floats]
    """MEASURED and RATES to (n, L): NaN where the entry was not run at the level, or lacks the value."""

    @cached_property
    def clusters(self) -> Clusters:
        """Return which entries share a training seed and, within it, a spawn point."""
        return Clusters.nested(self.seed, self.spawn)

    @cached_property
    def two_way(self) -> Clusters:
        """Return the same for the stricter interval, which lets spawn points do the same to all seeds."""
        return Clusters.two_way(self.seed, self.spawn)

    def entries(self, kept: NDArray[np.bool_]) -> Paired:
        """Return the entries that are kept (n,)."""
        values = {name: value[kept] for name, value in self.values.items()}
        return replace(
            self,
            entry=self.entry[kept],
            seed=self.seed[kept],
            spawn=self.spawn[kept],
            seen=self.seen[kept],
            values=values,
        )

    @property
    def mastered(self) -> set[str]:
        """Entries that succeed at every level, for every training seed that ran them."""
        failed = ~(self.values["success"] == 1).all(axis=1)
        return set(self.entry.tolist()) - set(self.entry[failed].tolist())

    def over(self, name: str, over: str, columns: Sequence[int] | None = None) -> Floats:
        """Return a measure (n, C) at some levels (default: every one), NaN for entries that do not count.

        Levels are compared over the same entries: one that lacks the value at any of them counts at none.
        Only the plain means over all episodes of each level take what there is.
        """
        which = list(range(len(self.levels)) if columns is None else columns)
        values = self.values[name][:, which]
        if over == "all" and columns is None:
            return values
        counts = np.isfinite(values).all(axis=1, keepdims=True)
        if over == "pairs":
            counts = counts & (self.values["success"][:, which] == 1).all(axis=1, keepdims=True)
        return np.where(counts, values, np.nan)


def paired(tables: Sequence[tuple[Sequence[Row], Limit]]) -> Paired:
    """Return the episodes of several episodes.csv, each with its time limit, side by side.

    Raises:
      ConfigError: an episode has no level, is there twice, or is of another task, precision or entry.
    """
    _agree([row for rows, _ in tables for row in rows], SAME)
    found: dict[tuple[str, ...], dict[int, tuple[Row, int]]] = {}
    for rows, limit in tables:
        for row in rows:
            text = row.get("comfort_level") or ""
            if not text.isdecimal():
                raise ConfigError(f"comfort_level={text!r}: evaluate at given levels, such as levels=[1,10]")
            key = tuple(row.get(name) or "" for name in ("train_seed", "human", "episode_seed", "episode"))
            if int(text) in found.setdefault(key, {}):
                raise ConfigError(f"train_seed={key[0]!r} has episode {key[3]} of level {text} twice")
            found[key][int(text)] = row, limit(int(text))
    if not found:
        raise ConfigError("there is no episode to compare")
    for entry in found.values():
        _agree([row for row, _ in entry.values()], SAME_ENTRY)
    levels = tuple(sorted({level for runs in found.values() for level in runs}))
    values = {name: np.full((len(found), len(levels)), np.nan) for name in (*MEASURED, *RATES)}
    for j, level in enumerate(levels):
        which = [i for i, runs in enumerate(found.values()) if level in runs]
        runs = [each[level] for each in found.values() if level in each]
        for name, cells in _measures([row for row, _ in runs], [limit for _, limit in runs]).items():
            values[name][which, j] = cells
    first = [next(iter(runs.values()))[0] for runs in found.values()]
    return Paired(
        levels=levels,
        entry=np.array(["/".join(key[1:]) for key in found]),
        seed=np.array([row.get("train_seed") or "" for row in first]),
        spawn=np.array([row["spawn_id"] or f"episode {row['episode']}" for row in first]),
        seen=column(first, "seen"),
        values=values,
    )


def _agree(rows: Sequence[Row], columns: Sequence[str]) -> None:
    for name in columns:
        values = sorted({row.get(name) or "" for row in rows})
        if len(values) > 1:
            raise ConfigError(f"{name} is {' and '.join(map(repr, values))}: only like can be compared")


def common(groups: Mapping[str, Paired]) -> dict[str, Paired]:
    """Return the series over the entries of the evaluation set that all of them succeed at, at every level.

    Raises:
      ConfigError: there is no such entry.
    """
    shared = sorted(set.intersection(*(data.mastered for data in groups.values())))
    if not shared:
        raise ConfigError(f"no episode succeeds at every level of all of {', '.join(groups)}: over=all")
    return {label: data.entries(np.isin(data.entry, shared)) for label, data in groups.items()}


def _measures(rows: Sequence[Row], limits: Sequence[int]) -> dict[str, Floats]:
    """Return MEASURED and RATES (n,) of rows whose episodes may take `limits` control steps."""
    values = {name: column(rows, name) for name in (*MEASURED, "success", "human_collision")}
    if np.isnan(values["success"]).any():
        raise ConfigError("success='' in episodes.csv: every episode must say 0 or 1")
    values[STEPS] = np.where(values["success"] > 0, values[STEPS], np.array(limits, dtype=np.float64))
    # The cell is empty where nobody was touched, which is no collision of a moving robot either.
    moving = column(rows, "robot_moving_at_collision")
    values["moving_collision"] = np.where(values["human_collision"] == 0, 0.0, moving)
    other = [(row.get("other_collision") or "none") != "none" for row in rows]
    return {**values, "other_collision": np.array(other, dtype=np.float64)}


def mean_at_levels(data: Paired, name: str, over: str) -> list[dict[str, Any] | None]:
    """Return mean, ci95 and number of episodes of a measure at each level; None where it has no value."""
    values = data.over(name, over)
    means, draws = data.clusters.means(values)
    found: list[dict[str, Any] | None] = []
    for j, mean in enumerate(means):
        kept = values[np.isfinite(values[:, j]), j]
        if len(kept) == 0:
            found.append(None)
            continue
        interval = data.clusters.interval(draws[:, j])
        if name in RATES and kept.min() == kept.max():  # no resample differs, yet it is not certain
            interval = list(wilson_interval(int(kept.sum()), len(kept)))
        found.append({"mean": float(mean), "ci95": interval, "episodes": len(kept)})
    return found


def mean_by_seed(data: Paired, name: str, over: str) -> dict[str, Floats]:
    """Return a measure's means (L,) of each training seed alone, NaN where it has no value."""
    values = data.over(name, over)
    found = {}
    for seed in np.unique(data.seed):
        own = values[data.seed == seed]
        count = np.isfinite(own).sum(axis=0)
        found[str(seed)] = np.where(count > 0, np.nansum(own, axis=0) / np.maximum(count, 1), np.nan)
    return found


def change(data: Paired, name: str, over: str, start: int, end: int) -> dict[str, Any] | None:
    """Return the change of a measure from one level to another, in percent of its mean at the first."""
    columns = [data.levels.index(start), data.levels.index(end)]
    values = data.over(name, over, columns)
    found: dict[str, Any] = {"episodes": int(np.isfinite(values).all(axis=1).sum())}
    for key, clusters in {"ci95": data.clusters, "ci95_two_way": data.two_way}.items():
        means, draws = clusters.means(values)
        if not np.isfinite(means).all() or means[0] == 0:
            return None
        found |= {"from": float(means[0]), "to": float(means[1])}
        found["percent"] = 100 * (found["to"] / found["from"] - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            changes = 100 * (draws[:, 1] / draws[:, 0] - 1)
        # Of so little at the first level that some resamples have none, no interval can be told.
        found[key] = clusters.interval(changes) if np.isfinite(changes).all() else None
    return found


def verdict(found: Mapping[str, Any] | None) -> str | None:
    """Return what distance does up a level: it `falls`, stays `within` the interval, or `rises`."""
    if found is None:
        return None
    if found["percent"] < 0:
        return "falls"
    return "within" if found["ci95"] is not None and found["ci95"][0] <= 0 else "rises"


def compare(data: Paired, start: int, end: int) -> dict[str, Any]:
    """Return the changes of every measure from one level to another, over pairs and over all."""
    found: dict[str, Any] = {"from": start, "to": end}
    for over in OVER:
        changes = {name: change(data, name, over, start, end) for name in MEASURED}
        found[over] = {name: value for name, value in changes.items() if value is not None}
        found[over]["distance"] = verdict(changes[DISTANCE])
    return found


def of_spawns(data: Paired) -> dict[str, Any]:
    """Return means at each level and changes of some entries; a measure without a value is absent."""
    means = {over: {name: mean_at_levels(data, name, over) for name in MEASURED} for over in OVER}
    means["rates"] = {name: mean_at_levels(data, name, "all") for name in RATES}
    levels: list[dict[str, Any]] = [{"level": level} for level in data.levels]
    for j, at in enumerate(levels):
        for part, found in means.items():
            at[part] = {name: values[j] for name, values in found.items() if values[j] is not None}
    steps = [compare(data, start, end) for start, end in pairwise(data.levels)]
    return {
        "entries": len(data.seed),
        "levels": levels,
        "first_to_last": compare(data, data.levels[0], data.levels[-1]) if steps else None,
        "neighbours": steps,
        "monotone": {
            over: all(step[over]["distance"] in ("falls", "within") for step in steps) for over in OVER if steps
        },
    }


def summarise(data: Paired) -> dict[str, Any]:
    """Return every number about the levels, for all spawn points, seen and unseen ones; JSON holds it."""
    spawns = {"all": np.ones(len(data.seen), dtype=bool), "seen": data.seen == 1, "unseen": data.seen == 0}
    return {
        "levels": list(data.levels),
        "train_seeds": sorted(set(data.seed.tolist())),
        "interval": f"95 %, {RESAMPLES} resamples of training seeds and, within them, of spawn points",
        "spawns": {name: of_spawns(data.entries(kept)) for name, kept in spawns.items() if kept.any()},
    }
