"""From episodes to summary.json: means and 95 % intervals of groups of episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, Clusters, Estimate
from hrl_comfort.config import ConfigError
from hrl_comfort.files.tables import Floats, column

KEYS = ("task", "policy", "human", "comfort_level", "precision_m", "split")
"""Columns that always tell one group of episodes from another."""
LABELS = (*KEYS, "train_seed", "episode_seed", "episode", "object", "spawn_id", "motion_id", "person_id", "seen")
"""Columns that say which episode it was; every other numeric column is a metric."""
COLLISIONS = {"other_collision": ("table", "self"), "table_collision": ("table",), "self_collision": ("self",)}


def summarise(episodes: DataFrame, group_by: Sequence[str], max_episode_steps: int | Sequence[int]) -> dict[str, Any]:
    """Return the summary of episodes: one group a task, policy, human, level, precision and `group_by`.

    Steps and distances are over successful episodes; their `_all` twins over all, where a failed
    episode's steps count as `max_episode_steps` (control steps) and its distances as measured.

    Raises:
      ConfigError: `group_by` names no column.
    """
    unknown = [name for name in group_by if name not in episodes]
    if unknown:
        raise ConfigError(f"group_by={unknown[0]!r} is not a column; choose among {', '.join(episodes)}")
    names = [name for name in dict.fromkeys((*KEYS, *group_by)) if name in episodes or name != "split"]
    limits = pd.Series(np.broadcast_to(max_episode_steps, len(episodes)), index=episodes.index)
    groups = []
    whole = episodes.reindex(columns=list(dict.fromkeys((*episodes, *names))))
    for cells, group in whole.groupby(names, dropna=False, sort=False):
        labels = {name: _label(cell) for name, cell in zip(names, cells, strict=True)}
        metrics = _metrics(group.drop(columns=[*LABELS, *group_by], errors="ignore"), group, limits[group.index])
        groups.append({**labels, "episodes": len(group), "metrics": metrics})
    return {"groups": groups}


def with_totals(groups: Sequence[dict[str, Any]], episodes: DataFrame | None) -> list[dict[str, Any]]:
    """Return groups of a summary; those of seen and unseen spawns are followed by their total, of which `seen` is all.

    Args:
      groups: of a summary.json.
      episodes: those that were summarised; without them there are no totals.
    """
    if episodes is None or not groups or "seen" not in groups[0]:
        return list(groups)
    labels = [name for name in groups[0] if name not in ("episodes", "metrics", "seen", "policy")]
    found: list[dict[str, Any]] = []
    for total in summarise(episodes, [name for name in labels if name not in KEYS], 1)["groups"]:
        parts = [group for group in groups if all(group[name] == total.get(name, group[name]) for name in labels)]
        found += [*parts, {**parts[0], **total, "seen": "all"}] if len(parts) > 1 else parts
    return [*found, *(group for group in groups if group not in found)]


def _label(cell: Any) -> str | float | int | bool | None:
    """Return a group's label as JSON holds it."""
    return None if pd.isna(cell) else cell.item() if isinstance(cell, np.generic) else cell


def _metrics(measured: DataFrame, episodes: DataFrame, limits: pd.Series) -> dict[str, Estimate]:
    """Return the metrics of one group of episodes; a metric without a value is absent."""
    clusters, won = Clusters.of(episodes), column(episodes, "success") > 0
    metrics: dict[str, Floats] = {}
    shares = []
    for name in measured.select_dtypes(["number", "bool", "boolean"]):
        values = column(measured, name)
        if name not in ("steps", "policy_steps") and "distance" not in name:
            metrics[name] = values
            shares += [name] if measured[name].dtype in ("bool", "boolean") else []
            continue
        metrics[name] = np.where(won, values, np.nan)
        if name == "steps":
            metrics["steps_all"] = np.where(won, values, limits)
        elif name != "policy_steps":
            metrics[f"{name}_all"] = values
    if "other_collision" in measured:
        for name, kinds in COLLISIONS.items():
            metrics[name] = measured["other_collision"].isin(kinds).to_numpy(dtype=float)
            shares.append(name)
    return clusters.estimates(DataFrame(metrics), dict.fromkeys(shares, SHARE))
