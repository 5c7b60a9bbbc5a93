"""The effect of the comfort level: means at each level and paired changes between levels.

Every level runs the same entries of the evaluation set, so episodes pair across levels: same spawn point,
same walk, same kind of object. Over `pairs` a number is a mean over the entries that succeed at every level compared;
over `all` over all of them, a failure's steps counted at the time limit, everything else as measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.analysis.intervals import RESAMPLES, SHARE, Clusters
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import Floats, column

DISTANCE, STEPS, SPEED = "human_distance_mean_m", "steps", "joint_increment_mean_deg"
MEASURED = (DISTANCE, STEPS, "human_distance_by_path_m", "tool_path_m", "waiting_share", SPEED)
RATES = ("success", "unsafe_contact", "contact", "other_collision")
"""Shares of all episodes: success; an unsafe contact with the person; any contact; a collision with cell or robot."""
BOUNDS = dict.fromkeys((*RATES, "waiting_share"), SHARE)
OVER = ("pairs", "all")
SAME = ["task", "precision_m"]
"""Columns that everything compared must agree in."""
ENTRY = ["train_seed", "human", "episode_seed", "episode"]
"""Columns that tell an entry: one training seed's run of one entry of the evaluation set."""
SAME_ENTRY = ["spawn_id", "motion_id", "object"]
"""Columns that an entry must have alike at every level."""


@dataclass(frozen=True)
class Paired:
    """Episodes of L levels side by side: n entries, each a training seed's run of one evaluation entry."""

    levels: tuple[int, ...]
    entries: DataFrame
    """(n) rows of the columns ENTRY, `spawn_id` and `seen`."""
    values: dict[str, Floats]
    """MEASURED and RATES to (n, L): NaN where the entry was not run at the level, or lacks the value."""

    @cached_property
    def clusters(self) -> Clusters:
        """Training seed and spawn point of each entry."""
        return Clusters.of(self.entries)

    @property
    def seeds(self) -> list[int]:
        """Training seeds; empty where nothing was trained."""
        return sorted(self.entries["train_seed"].dropna().unique().tolist())

    @property
    def entry(self) -> pd.Series:
        """(n,) entry of the evaluation set: the same for every training seed that ran it."""
        return self.entries[ENTRY[1:]].astype("str").agg("/".join, axis=1)

    def where(self, kept: NDArray[np.bool_]) -> Paired:
        """Return the entries that are kept (n,)."""
        values = {name: value[kept] for name, value in self.values.items()}
        return replace(self, entries=self.entries[kept].reset_index(drop=True), values=values)

    def over(self, name: str, over: str, levels: Sequence[int] = ()) -> Floats:
        """Return a measure (n, C) at some levels (default: every one), NaN for entries that do not count.

        Levels are compared over the same entries: one that lacks the value at any of them counts at none.
        Only the plain means over all episodes of each level take what there is.
        """
        which = [self.levels.index(level) for level in levels or self.levels]
        values = self.values[name][:, which]
        if over == "all" and not levels:
            return values
        counts = np.isfinite(values).all(axis=1, keepdims=True)
        if over == "pairs":
            counts = counts & (self.values["success"][:, which] == 1).all(axis=1, keepdims=True)
        return np.where(counts, values, np.nan)


def paired(runs: Sequence[Run]) -> Paired:
    """Return the episodes of several evaluations side by side.

    Raises:
      ConfigError: an episode has no level, is there twice, or is of another task, precision or entry.
    """
    frame = pd.concat([_measures(run, run.episodes) for run in runs if run.episodes is not None], ignore_index=True)
    groups = frame.groupby(ENTRY, dropna=False, sort=False)
    for name in SAME:
        _check_alike(name, frame[name])
    for name in SAME_ENTRY:
        _check_alike(name, frame.loc[groups[name].transform("nunique") > 1, name])
    for _, row in frame[frame.duplicated([*ENTRY, "comfort_level"])].iterrows():
        raise ConfigError(
            f"train_seed={row['train_seed']} has episode {row['episode']} of level {row['comfort_level']} twice"
        )
    frame["entry"] = groups.ngroup()
    wide = frame.pivot(index="entry", columns="comfort_level", values=[*MEASURED, *RATES])
    entries = frame.drop_duplicates("entry")[[*ENTRY, "spawn_id", "seen"]].reset_index(drop=True)
    levels = tuple(sorted(frame["comfort_level"].unique().tolist()))
    return Paired(levels, entries, {name: wide[name].to_numpy(float) for name in (*MEASURED, *RATES)})


def _check_alike(name: str, values: pd.Series) -> None:
    """Raise ConfigError unless all values of the column `name` are the same."""
    found = sorted("" if pd.isna(value) else str(value) for value in values.unique())
    if len(found) > 1:
        raise ConfigError(f"{name} is {' and '.join(map(repr, found))}: only like can be compared")


def _measures(run: Run, episodes: DataFrame) -> DataFrame:
    """Return a run's episodes with MEASURED and RATES, a failure's steps counted at the time limit of its level."""
    frame = episodes.reindex(columns=[*SAME, *ENTRY, *SAME_ENTRY, "seen", "comfort_level"])
    if frame["comfort_level"].isna().any():
        raise ConfigError("comfort_level='': evaluate at given levels, such as levels=[1,10]")
    for name in (*MEASURED, "success", "contact", "unsafe_contact"):
        frame[name] = column(episodes, name)
    frame[STEPS] = frame[STEPS].where(frame["success"] > 0, time_limit(run, column(frame, "comfort_level")))
    frame["other_collision"] = (episodes["other_collision"].fillna("none") != "none").astype(float)
    return frame


def time_limit(run: Run, levels: Floats) -> Floats:
    """Return the time limit (n,), control steps, at levels (n,): as `comfort.adapt.max_episode_steps`.

    It comes from the plain YAML, so that evaluations of other versions can be drawn too.
    """
    steps = run.config.get("task", {}).get("max_episode_steps")
    if steps is None:
        raise ConfigError(f"{run.folder}/config.yaml lacks task.max_episode_steps, at which failures count")
    comfort = run.config.get("comfort", {})
    return np.ceil(steps * comfort["levels"] / levels) if comfort.get("beta") else np.full(len(levels), float(steps))


def common(groups: Mapping[str, Paired]) -> dict[str, Paired]:
    """Return the series over the entries of the evaluation set that all of them succeed at, at every level.

    Raises:
      ConfigError: there is no such entry.
    """
    shared: set[str] = set.intersection(*(set(data.entry) for data in groups.values()))
    for data in groups.values():
        shared -= set(data.entry[~(data.values["success"] == 1).all(axis=1)])
    if not shared:
        raise ConfigError(f"no episode succeeds at every level of all of {', '.join(groups)}: over=all")
    return {label: data.where(data.entry.isin(shared).to_numpy()) for label, data in groups.items()}


def change(data: Paired, name: str, over: str, start: int, end: int) -> dict[str, Any] | None:
    """Return the change of a measure from one level to another, in percent of its mean at the first."""
    at = data.over(name, over, [start, end])
    before, after = (data.clusters.estimate(values) for values in at.T)
    percent = data.clusters.estimate(*at.T, statistic=lambda a, b: 100 * (b / a - 1))
    if before is None or after is None or percent is None:
        return None
    episodes = int(np.isfinite(at).all(axis=1).sum())
    means = {"from": before["mean"], "to": after["mean"], "percent": percent["mean"]}
    return {**means, "ci95": percent["ci95"], "episodes": episodes}


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
    levels: list[dict[str, Any]] = [{"level": level} for level in data.levels]
    for part, names in {"pairs": MEASURED, "all": MEASURED, "rates": RATES}.items():
        columns = {name: data.over(name, "pairs" if part == "pairs" else "all").T for name in names}
        for number, at in enumerate(levels):
            values = DataFrame({name: each[number] for name, each in columns.items()})
            estimates, episodes = data.clusters.estimates(values, BOUNDS), np.isfinite(values).sum()
            at[part] = {name: {**each, "episodes": int(episodes[name])} for name, each in estimates.items()}
    steps = [compare(data, start, end) for start, end in pairwise(data.levels)]
    return {
        "entries": len(data.entries),
        "levels": levels,
        "first_to_last": compare(data, data.levels[0], data.levels[-1]) if steps else None,
        "neighbours": steps,
        "monotone": {
            over: all(step[over]["distance"] in ("falls", "within") for step in steps) for over in OVER if steps
        },
    }


def summarise(data: Paired) -> dict[str, Any]:
    """Return every number about the levels, for all spawn points, seen and unseen ones; JSON holds it."""
    seen = column(data.entries, "seen")  # NaN where spawns were drawn
    spawns = {"all": np.ones(len(seen), dtype=bool), "seen": seen == 1, "unseen": seen == 0}
    bootstrap = f"95 %, percentile bootstrap over spawn points, {RESAMPLES} resamples"
    return {
        "levels": list(data.levels),
        "train_seeds": data.seeds,
        "interval": "95 %, Student's t over training seeds" if len(data.seeds) > 1 else bootstrap,
        "spawns": {name: of_spawns(data.where(kept)) for name, kept in spawns.items() if kept.any()},
    }
