"""The return of controllers of `sort`, in its parts, and the differences of the first from the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from pandas import DataFrame

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.tables import Quantity, cell, cells, markdown
from hrl_comfort.config import ConfigError
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import column
from hrl_comfort.plots import compare as panels

PARTS = {
    "success": Quantity("every ball sorted, %", 100, 1),
    "return": Quantity("return"),
    "placed": Quantity("balls placed"),
    "time": Quantity("cost of time"),
    "discomfort": Quantity("cost of discomfort"),
}
"""Parts of an episode's return: placed balls, less the costs of time and discomfort."""
PAID = ("place", "step")
"""Weights of the reward that may differ from zero; the rest of the return is discomfort."""
SAME = ("robot", "cell", "human", "comfort", "task", "reward", "disturbance")
"""Sections of the configuration in which evaluations must agree to be compared."""


def earnings(runs: Sequence[Run]) -> DataFrame:
    """Return the episodes of evaluations and, in the columns PARTS, the parts of their return.

    Raises:
      ConfigError: an evaluation is of several levels, lacks the number of balls placed, or has another reward.
    """
    for run in runs:
        if (wrong := _unfit(run)) is not None:
            raise ConfigError(
                f"{run.folder}: {wrong}; kind=controllers takes evaluations with reward=sort of one level"
            )
    frame, reward = panels.pooled(runs), runs[0].config["reward"]
    for name in ("success", "return", "steps"):
        frame[name] = column(frame, name)
    frame["placed"] = reward["place"] * column(frame, "balls_placed")
    frame["time"] = -reward["step"] * frame["steps"]
    frame["discomfort"] = frame["placed"] - frame["time"] - frame["return"]
    return frame


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
    if run.episodes is None or "balls_placed" not in run.episodes or run.episodes["balls_placed"].isna().any():
        return "no balls_placed in its episodes.csv"
    return None


def compare(groups: Mapping[str, Sequence[Run]]) -> dict[str, Any]:
    """Return the means of every controller's PARTS, and the first one's differences from the others.

    Differences are of the same episodes with the same skills; in per cent of the other's return where the
    interval of that is positive.

    Raises:
      ConfigError: as `earnings`, or the controllers did not run the same episodes in the same way.
    """
    panels.check_alike(groups, SAME)
    (first, own), *rest = ((label, earnings(runs)) for label, runs in groups.items())
    numbers: dict[str, Any] = {"controllers": {}, "differences": {}}
    for label, frame in ((first, own), *rest):
        means = panels.described(frame, frame, list(PARTS), shares=("success",))
        numbers["controllers"][label] = {"episodes": len(frame), **means}
    for label, frame in rest:
        panels.check_paired((first, label), own, frame)
        for mine, other in zip(groups[first], groups[label], strict=False):
            if _skills(mine) != _skills(other):
                raise ConfigError(f"{mine.folder} and {other.folder} differ in policies; compare like with like")
        difference = own[list(PARTS)] - frame[list(PARTS)]
        found = panels.described(own, difference, list(PARTS))
        whole = numbers["controllers"][label].get("return")
        if whole and (whole["ci95"] or [whole["mean"]])[0] > 0:
            of_return = column(difference, "return"), column(frame, "return")
            found["return_percent"] = Clusters.of(own).estimate(*of_return, statistic=lambda a, b: 100 * a / b)
        numbers["differences"][f"{first} - {label}"] = found
    return numbers


def _skills(run: Run) -> dict[str, str]:
    return {name: policy for name, policy in (run.config.get("policies") or {}).items() if name != "meta_controller"}


def draw(numbers: Mapping[str, Any]) -> Figure:
    """Draw the result of `compare`: a panel a part, a line a controller, 95 % intervals."""
    return panels.draw(numbers["controllers"], PARTS)


def table(numbers: Mapping[str, Any]) -> str:
    """Return the result of `compare` as a Markdown table: the controllers, then the differences."""
    lines = [
        [label, *cells(each, PARTS), cell(each.get("return_percent"))]
        for section in ("controllers", "differences")
        for label, each in numbers[section].items()
    ]
    return markdown(["", *(part.label for part in PARTS.values()), "return, %"], lines)
