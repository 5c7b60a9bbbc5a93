"""Divisions of a task side by side: what one, two or three policies come to, and what they took to train."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hrl_comfort.analysis.clusters import Clusters
from hrl_comfort.analysis.intervals import Floats, column
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.compose import load_config, run_folder
from hrl_comfort.files.run_folder import Run, read_run
from hrl_comfort.plots import compare as panels
from hrl_comfort.plots.compare import Quantity

QUANTITIES = {
    "success": Quantity("success, %", 100, 1),
    "moving": Quantity("moving robot hit person, %", 100, 1),
    "steps": Quantity("steps", 1, 1),
    "distance": Quantity("distance, m", 1, 3),
}
"""What is told of an episode; steps and mean distance to the person of those that succeed."""
SAME = ("robot", "cell", "human", "comfort", "task", "reward")
"""Sections of the configuration in which evaluations must agree to be compared."""


def episodes(runs: Sequence[Run]) -> tuple[NDArray[Any], Floats]:
    """Return which episodes (n, 3), by training seed, episode and spawn point, and QUANTITIES (n, 4)."""
    found, who = [], []
    for run in runs:
        rows = run.episodes or []
        success = column(rows, "success")
        won = np.where(success > 0, 1.0, np.nan)
        hit = column(rows, "human_collision")
        moving = np.where(hit > 0, column(rows, "robot_moving_at_collision"), hit)
        of_wins = [won * column(rows, name) for name in ("steps", "human_distance_mean_m")]
        found.append(np.stack([success, moving, *of_wins], axis=-1))
        who += [(row["train_seed"] or "", row["episode"], row["spawn_id"]) for row in rows]
    return np.array(who), np.concatenate(found)


def trained(run: Run) -> dict[str, float]:
    """Return how many policies an evaluation chains and what they took to train: decisions and minutes.

    A policy that another was begun from (`initial_policy`) counts too, once.

    Raises:
      ConfigError: a policy was not trained to its end, or its folder is not there.
    """
    names = list((run.config.get("policies") or {}).values()) or [run.config.get("policy")]
    cost: dict[Path, tuple[int, float]] = {}
    for name in names:
        if name is None:
            raise ConfigError(f"{run.folder}/config.yaml names no policy")
        _training(name, cost)
    policy_steps, minutes = (sum(each) for each in zip(*cost.values(), strict=True))
    return {"networks": len(names), "policy_steps": policy_steps, "minutes": minutes}


def _training(policy: str, cost: dict[Path, tuple[int, float]]) -> None:
    """Add what a policy took, and what those took that it was begun from, to `cost` by folder."""
    folder = run_folder(policy)
    if folder is None:
        raise ConfigError(f"policy={policy!r} is not a run folder, so what its training took is not known")
    config, provenance = load_config(folder), read_run(folder).provenance
    if provenance is None or not isinstance(config, TrainConfig):
        raise ConfigError(f"{folder} is not that of a training")
    if not provenance["finished"]:
        raise ConfigError(f"{folder} is not finished, so what its training took is not known")
    cost[folder.resolve()] = int(provenance["policy_steps"]), float(provenance["wall_seconds"]) / 60
    if config.initial_policy is not None:
        _training(config.initial_policy, cost)


def compare(groups: Mapping[str, Sequence[Run]]) -> dict[str, Any]:
    """Return every division's means of QUANTITIES, what it took, and how the first differs from the others.

    Intervals are the bootstrap over training seeds and, within them, spawn points. Differences are of the
    same episodes; of steps and distance where both succeed. What it took is the mean over training seeds.

    Raises:
      ConfigError: as `trained`, or the divisions did not run the same episodes in the same way.
    """
    all_of = {label: episodes(runs) for label, runs in groups.items()}
    (first, (who, own)), *rest = all_of.items()
    panels.check_alike(groups, SAME)
    numbers: dict[str, Any] = {"divisions": {}, "differences": {}}
    for label, (names, values) in all_of.items():
        means = panels.described(Clusters.nested(names[:, 0], names[:, 2]), values, list(QUANTITIES))
        took = [trained(run) for run in groups[label]]
        cost = {name: float(np.mean([each[name] for each in took])) for name in took[0]}
        numbers["divisions"][label] = {"episodes": len(values), **cost, **means}
    for label, (names, values) in rest:
        panels.check_paired((first, label), who, names)
        clusters = Clusters.nested(who[:, 0], who[:, 2])
        means = panels.described(clusters, own - values, list(QUANTITIES))
        numbers["differences"][f"{first} - {label}"] = means
    return numbers


def draw(numbers: Mapping[str, Any]) -> Figure:
    """Draw what `compare` found: a panel a quantity, a line a division, 95 % intervals."""
    return panels.draw(numbers["divisions"], QUANTITIES)


def table(numbers: Mapping[str, Any]) -> str:
    """Return what `compare` found as a Markdown table: the divisions, then the differences."""
    lines = []
    for label, each in numbers["divisions"].items():
        cost = [f"{each['networks']:.0f}", f"{each['policy_steps']:,.0f}", f"{each['minutes']:.0f}"]
        lines.append([label, *cost, *panels.cells(each, QUANTITIES)])
    for label, each in numbers["differences"].items():
        lines.append([label, "", "", "", *panels.cells(each, QUANTITIES)])
    heads = ["", "networks", "policy_steps", "training, min", *(each.label for each in QUANTITIES.values())]
    return panels.markdown(heads, lines)
