"""Divisions of a task side by side: their results with one, two or three policies, and their training cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pandas import DataFrame

from hrl_comfort.analysis.tables import Quantity, cells, markdown
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.compose import load_config, run_folder
from hrl_comfort.files.provenance import read_provenance
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import column
from hrl_comfort.plots import compare as panels

QUANTITIES = {
    "success": Quantity("success, %", 100, 1),
    "moving": Quantity("moving robot hit person, %", 100, 1),
    "steps": Quantity("steps", 1, 1),
    "distance": Quantity("distance, m", 1, 3),
}
"""Quantities of an episode; steps and mean distance to the person of those that succeed."""
SAME = ("robot", "cell", "human", "comfort", "task", "reward")
"""Sections of the configuration in which evaluations must agree to be compared."""


def episodes(runs: Sequence[Run]) -> DataFrame:
    """Return the episodes of evaluations, with the columns QUANTITIES."""
    frame = panels.pooled(runs)
    hit = column(frame, "human_collision")
    moving = np.where(hit > 0, column(frame, "robot_moving_at_collision"), hit)
    success = column(frame, "success")
    of_wins = {"steps": column(frame, "steps"), "distance": column(frame, "human_distance_mean_m")}
    won = {name: np.where(success > 0, values, np.nan) for name, values in of_wins.items()}
    return frame.assign(success=success, moving=moving, **won)


def trained(run: Run) -> dict[str, float]:
    """Return how many policies an evaluation chains and what their training took: policy steps and minutes.

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
    """Add the cost of a policy, and of those that it was begun from, to `cost` by folder."""
    folder = run_folder(policy)
    if folder is None:
        raise ConfigError(f"policy={policy!r} is not a run folder, so the cost of its training is unknown")
    config, provenance = load_config(folder), read_provenance(folder)
    if not isinstance(config, TrainConfig):
        raise ConfigError(f"{folder} is not that of a training")
    if not provenance.finished:
        raise ConfigError(f"{folder} is not finished, so the cost of its training is unknown")
    cost[folder.resolve()] = provenance.policy_steps, provenance.wall_seconds / 60
    if config.initial_policy is not None:
        _training(config.initial_policy, cost)


def compare(groups: Mapping[str, Sequence[Run]]) -> dict[str, Any]:
    """Return every division's means of QUANTITIES, its cost, and how the first differs from the others.

    Differences are of the same episodes; of steps and distance where both succeed. The cost is the mean over
    training seeds.

    Raises:
      ConfigError: as `trained`, or the divisions did not run the same episodes in the same way.
    """
    panels.check_alike(groups, SAME)
    (first, own), *rest = ((label, episodes(runs)) for label, runs in groups.items())
    names = list(QUANTITIES)
    numbers: dict[str, Any] = {"divisions": {}, "differences": {}}
    for label, frame in ((first, own), *rest):
        cost = DataFrame([trained(run) for run in groups[label]]).mean().to_dict()
        means = panels.described(frame, frame, names, shares=("success", "moving"))
        numbers["divisions"][label] = {"episodes": len(frame), **cost, **means}
    for label, frame in rest:
        panels.check_paired((first, label), own, frame)
        difference = panels.described(own, own[names] - frame[names], names)
        numbers["differences"][f"{first} - {label}"] = difference
    return numbers


def draw(numbers: Mapping[str, Any]) -> Figure:
    """Draw the result of `compare`: a panel a quantity, a line a division, 95 % intervals."""
    return panels.draw(numbers["divisions"], QUANTITIES)


def table(numbers: Mapping[str, Any]) -> str:
    """Return the result of `compare` as a Markdown table: the divisions, then the differences."""
    lines = []
    for label, each in numbers["divisions"].items():
        cost = [f"{each['networks']:.0f}", f"{each['policy_steps']:,.0f}", f"{each['minutes']:.0f}"]
        lines.append([label, *cost, *cells(each, QUANTITIES)])
    for label, each in numbers["differences"].items():
        lines.append([label, "", "", "", *cells(each, QUANTITIES)])
    heads = ["", "networks", "policy steps", "training, min", *(each.label for each in QUANTITIES.values())]
    return markdown(heads, lines)
