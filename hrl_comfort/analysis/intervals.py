"""From episodes.csv to summary.json: means, interquartile means and 95 % intervals.

Sources: Agarwal et al., Deep RL at the edge of the statistical precipice (2021), for the interquartile
mean, the bootstrap over training seeds and the probability of improvement; Wilson (1927) for the
interval of a share. An empty cell is a missing value and stays missing: it is never a zero.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_text

Row = dict[str, str]
Floats = NDArray[np.float64]
Limit = int | Sequence[int]
"""Time limit of an episode, control steps; the same for all, or each row's own."""

KEYS = ("task", "policy", "human", "comfort_level", "precision_m", "split")
"""What always tells one group of episodes from another."""
LABELS = (*KEYS, "train_seed", "episode_seed", "episode", "colour", "spawn_id", "motion_id", "seen")
"""Columns that say which episode it was; every other numeric column is a metric."""
SHARES = ("success", "human_collision", "robot_moving_at_collision", "truncated")
"""Metrics that are 0 or 1 in an episode, and so a share over episodes."""
RESAMPLES = 2000
SEED = 0

_TRUTH = {"true": 1.0, "false": 0.0}


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a CSV file with a header, every cell as text."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def number(cell: str | None, where: str = "cell") -> float:
    """Return a cell's value; NaN where it is missing (empty, absent or `nan`)."""
    text = (cell or "").strip().lower()
    if text in ("", "nan"):
        return math.nan
    if text in _TRUTH:
        return _TRUTH[text]
    try:
        value = float(text)
    except ValueError:
        raise ConfigError(f"{where}={cell!r} is not a number; leave a missing value empty") from None
    if math.isinf(value):
        raise ConfigError(f"{where}={cell!r} is not finite; leave a missing value empty")
    return value


def column(rows: Sequence[Row], name: str) -> Floats:
    """Return one column as floats (len(rows),), NaN where a value is missing."""
    return np.array([number(row.get(name), name) for row in rows], dtype=np.float64)


def interquartile_mean(values: Floats) -> float:
    """Return the mean of the middle half of `values` (n,), the 25 % trimmed mean."""
    return float(stats.trim_mean(values, 0.25))


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the Wilson 95 % interval of a share; it has a width even at 0 and at 1."""
    interval = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_interval(values: Floats, seeds: Sequence[str], resamples: int = RESAMPLES) -> tuple[float, float]:
    """Return the bootstrap percentile 95 % interval of the mean of `values` (n,).

    Two stages: training seeds `seeds` (n,) are drawn with replacement, then episodes within each drawn
    seed, for episodes of one trained policy are not independent evidence about the method. With one
    seed it is the plain bootstrap over episodes, and speaks of that policy only. The evaluation set's
    spawn points are fixed and the same for every policy, so they are not resampled.
    """
    rng = np.random.default_rng(SEED)
    labels = np.asarray(seeds)
    clusters = [values[labels == label] for label in dict.fromkeys(seeds)]
    means = np.empty(resamples)
    for i in range(resamples):
        drawn = [clusters[j] for j in rng.integers(len(clusters), size=len(clusters))]
        total = sum(float(cluster[rng.integers(len(cluster), size=len(cluster))].sum()) for cluster in drawn)
        means[i] = total / sum(len(cluster) for cluster in drawn)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(low), float(high)


def describe(values: Floats, seeds: Sequence[str], share: bool = False) -> dict[str, Any] | None:
    """Return mean, iqm and ci95 of the values (n,) that are there; None when none is.

    A share from one training seed, or one that is 0 or 1 throughout, gets the Wilson interval (a
    bootstrap of equal values has no width); everything else the bootstrap of `bootstrap_interval`.
    A single value has no interval: its `ci95` is None.
    """
    there = np.isfinite(values)
    kept = values[there]
    if kept.size == 0:
        return None
    kept_seeds = [seed for seed, is_there in zip(seeds, there, strict=True) if is_there]
    interval: tuple[float, float] | None = None
    if share and (len(set(kept_seeds)) == 1 or kept.min() == kept.max()):
        interval = wilson_interval(int(kept.sum()), kept.size)
    elif kept.size > 1:
        interval = bootstrap_interval(kept, kept_seeds)
    ci95 = None if interval is None else list(interval)
    return {"mean": float(kept.mean()), "iqm": interquartile_mean(kept), "ci95": ci95}


def seed_interval(values: Floats) -> tuple[float, float] | None:
    """Return Student's 95 % interval of the mean of `values` (n,), one a seed; None of fewer than two.

    With two to five seeds a bootstrap of them is far too narrow.
    """
    if len(values) < 2:
        return None
    half = float(stats.sem(values) * stats.t.ppf(0.975, len(values) - 1))
    return float(values.mean()) - half, float(values.mean()) + half


def probability_of_improvement(x: Floats, y: Floats, resamples: int = RESAMPLES) -> dict[str, Any]:
    """Return P(X > Y), ties counted half, of scores `x` (n,) and `y` (m,), with its bootstrap ci95.

    `x` and `y` are resampled each on its own (Agarwal et al. 2021, section 4.3): give one score a
    training seed to speak of methods, one score an episode to speak of two given policies.
    """
    if len(x) == 0 or len(y) == 0:
        raise ConfigError(f"probability_of_improvement of {len(x)} and {len(y)} scores: both need at least one")
    wins = np.greater.outer(x, y) + 0.5 * np.equal.outer(x, y)
    rng = np.random.default_rng(SEED)
    draws = np.empty(resamples)
    for i in range(resamples):
        drawn_x = np.bincount(rng.integers(len(x), size=len(x)), minlength=len(x))
        drawn_y = np.bincount(rng.integers(len(y), size=len(y)), minlength=len(y))
        draws[i] = drawn_x @ wins @ drawn_y / wins.size
    low, high = np.percentile(draws, (2.5, 97.5))
    return {"mean": float(wins.mean()), "ci95": [float(low), float(high)]}


def _of_success(name: str) -> bool:
    """Return whether a metric is taken over successful episodes, with an `_all` twin over all."""
    return name == "steps" or name == "policy_steps" or "distance" in name


def _is_text(rows: Sequence[Row], name: str) -> bool:
    """Return whether a column holds text, judged by its first value; a stray word later is an error."""
    first = next((row[name] for row in rows if row[name]), "0").strip().lower()
    try:
        float(_TRUTH.get(first, first))
    except ValueError:
        return True
    return False


def _metric_names(rows: Sequence[Row], labels: Sequence[str]) -> list[str]:
    return [name for name in rows[0] if name not in labels and not _is_text(rows, name)]


def group_metrics(rows: Sequence[Row], labels: Sequence[str], max_episode_steps: Floats) -> dict[str, Any]:
    """Return the metrics of one group of episodes; a metric without a value is absent."""
    seeds = [row.get("train_seed") or "" for row in rows]
    success = column(rows, "success")
    if np.isnan(success).any():
        raise ConfigError("success='' in episodes.csv: every episode must say 0 or 1")
    found: dict[str, dict[str, Any] | None] = {}
    for name in _metric_names(rows, labels):
        values = column(rows, name)
        booleans = any((row[name] or "").strip().lower() in _TRUTH for row in rows)
        if not _of_success(name):
            found[name] = describe(values, seeds, share=name in SHARES or booleans)
            continue
        found[name] = describe(np.where(success > 0, values, np.nan), seeds)
        if name == "steps":
            found["steps_all"] = describe(np.where(success > 0, values, max_episode_steps), seeds)
        elif name != "policy_steps":
            found[f"{name}_all"] = describe(values, seeds)
    if "other_collision" in rows[0]:
        for metric, kinds in {
            "other_collision": ("table", "self"),
            "table_collision": ("table",),
            "self_collision": ("self",),
        }.items():
            hits = np.array([float(row["other_collision"] in kinds) for row in rows])
            found[metric] = describe(hits, seeds, share=True)
    return {name: value for name, value in found.items() if value is not None}


def _label(name: str, cell: str | None) -> str | float | int | bool | None:
    """Return a group's label as JSON holds it: a number where it is one, None where it is missing."""
    if not cell:
        return None
    if name in ("task", "policy", "human", "colour", "split"):
        return cell
    if cell.lower() in _TRUTH:
        return cell.lower() == "true"
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell


def summarise(rows: Sequence[Row], group_by: Sequence[str], max_episode_steps: Limit) -> dict[str, Any]:
    """Return the summary of episodes: one group a task, policy, human, level, precision and `group_by`.

    Steps and distances are over successful episodes; their `_all` twins over all, where a failed
    episode's steps count as `max_episode_steps` (control steps) and its distances as measured.
    """
    if not rows:
        return {"groups": []}
    unknown = [name for name in group_by if name not in rows[0]]
    if unknown:
        raise ConfigError(f"group_by={unknown[0]!r} is not a column; choose among {', '.join(rows[0])}")
    names = [name for name in dict.fromkeys([*KEYS, *group_by]) if name in rows[0] or name != "split"]
    limits = np.broadcast_to(np.asarray(max_episode_steps, dtype=np.float64), len(rows))
    split: dict[tuple[str | None, ...], list[int]] = {}
    for index, row in enumerate(rows):
        split.setdefault(tuple(row.get(name) for name in names), []).append(index)
    groups = []
    for cells, which in split.items():
        labels = {name: _label(name, cell) for name, cell in zip(names, cells, strict=True)}
        metrics = group_metrics([rows[i] for i in which], (*LABELS, *group_by), limits[which])
        groups.append({**labels, "episodes": len(which), "metrics": metrics})
    return {"groups": groups}


def write_summary(folder: Path | str, group_by: Sequence[str], max_episode_steps: Limit) -> dict[str, Any]:
    """Summarise `folder`/episodes.csv into `folder`/summary.json, and return it."""
    folder = Path(folder)
    episodes = folder / "episodes.csv"
    if not episodes.is_file():
        raise ConfigError(f"output={str(folder)!r} holds no episodes.csv; evaluate writes one")
    summary = summarise(read_rows(episodes), group_by, max_episode_steps)
    write_text(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary
