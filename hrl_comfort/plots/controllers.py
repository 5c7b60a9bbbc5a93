"""What controllers of `sort` earn, in its parts, and by how much the first earns more than the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hrl_comfort.analysis.clusters import Clusters
from hrl_comfort.analysis.intervals import Floats, column
from hrl_comfort.analysis.tables import cell
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.plots import compare as panels
from hrl_comfort.plots.compare import Quantity

PARTS = {
    "success": Quantity("every ball sorted, %", 100, 1),
    "return": Quantity("return"),
    "placed": Quantity("balls placed"),
    "time": Quantity("cost of time"),
    "discomfort": Quantity("cost of discomfort"),
}
"""What is told of an episode. Return is what placed balls pay, less what time and discomfort cost."""
PAID = ("place", "step")
"""Weights of the reward that may differ from zero; the rest of the return is discomfort."""
SAME = ("robot", "cell", "human", "comfort", "task", "reward", "disturbance")
"""Sections of the configuration in which evaluations must agree to be compared."""


def earnings(runs: Sequence[Run]) -> tuple[NDArray[Any], Floats]:
    """Return which episodes (n, 3), by training seed, episode and spawn point, and their PARTS (n, 5).

    Raises:
      ConfigError: an evaluation is of several levels, does not say how many balls were placed, or is paid for
        something else.
    """
    found, who = [], []
    for run in runs:
        if (wrong := _unfit(run)) is not None:
            raise ConfigError(
                f"{run.folder}: {wrong}; kind=controllers takes evaluations with reward=sort of one level"
            )
        rows, reward = run.episodes or [], run.config["reward"]
        paid = reward["place"] * column(rows, "balls_placed")
        earned, time = column(rows, "return"), -reward["step"] * column(rows, "steps")
        success = column(rows, "success")
        found.append(np.stack([success, earned, paid, time, paid - time - earned], axis=-1))
        who += [(row["train_seed"] or "", row["episode"], row["spawn_id"]) for row in rows]
    return np.array(who), np.concatenate(found)


def _unfit(run: Run) -> str | None:
    """Return why the parts of an evaluation's return cannot be told, None where they can."""
    reward = run.config.get("reward")
    if not reward:
        return "no reward in its config.yaml"
    for name, weight in reward.items():
        if weight and name not in (*PAID, "k1", "k2", "k3"):
            return f"reward.{name}={weight}"
    if run.config.get("levels"):
        return "several comfort levels"
    if any(not row.get("balls_placed") for row in run.episodes or []):
        return "no balls_placed in its episodes.csv"
    return None


def compare(groups: Mapping[str, Sequence[Run]]) -> dict[str, Any]:
    """Return the means of every controller's PARTS, and the first one's differences from the others.

    Intervals are the bootstrap over training seeds and, within them, spawn points. Differences are of the
    same episodes with the same skills; in per cent of the other's return where that is surely positive.

    Raises:
      ConfigError: as `earnings`, or the controllers did not run the same episodes in the same way.
    """
    all_of = {label: earnings(runs) for label, runs in groups.items()}
    (first, (who, own)), *rest = all_of.items()
    panels.check_alike(groups, SAME)
    numbers: dict[str, Any] = {"controllers": {}, "differences": {}}
    for label, (names, values) in all_of.items():
        clusters = Clusters.nested(names[:, 0], names[:, 2])
        means = panels.described(clusters, values, list(PARTS))
        numbers["controllers"][label] = {"episodes": len(values), **means}
    for label, (names, values) in rest:
        panels.check_paired((first, label), who, names)
        for mine, other in zip(groups[first], groups[label], strict=False):
            if _skills(mine) != _skills(other):
                raise ConfigError(f"{mine.folder} and {other.folder} differ in policies; compare like with like")
        clusters = Clusters.nested(who[:, 0], who[:, 2])
        found = panels.described(clusters, own - values, list(PARTS))
        k = list(PARTS).index("return")
        both, draws = clusters.means(np.stack([own[:, k] - values[:, k], values[:, k]], axis=-1))
        if (draws[:, 1] > 0).all():
            found["return_percent"] = {
                "mean": float(100 * both[0] / both[1]),
                "ci95": clusters.interval(100 * draws[:, 0] / draws[:, 1]),
            }
        numbers["differences"][f"{first} - {label}"] = found
    return numbers


def _skills(run: Run) -> dict[str, str]:
    return {name: policy for name, policy in (run.config.get("policies") or {}).items() if name != "meta_controller"}


def draw(numbers: Mapping[str, Any]) -> Figure:
    """Draw what `compare` found: a panel a part, a line a controller, 95 % intervals."""
    return panels.draw(numbers["controllers"], PARTS)


def table(numbers: Mapping[str, Any]) -> str:
    """Return what `compare` found as a Markdown table: the controllers, then the differences."""
    lines = [
        [label, *panels.cells(each, PARTS), cell(each.get("return_percent"), "mean", 1, 1)]
        for section in ("controllers", "differences")
        for label, each in numbers[section].items()
    ]
    return panels.markdown(["", *(part.label for part in PARTS.values()), "return, %"], lines)
