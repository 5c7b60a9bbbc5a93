"""Numbers and their intervals as text, and Markdown tables of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hrl_comfort.analysis.comfort import DISTANCE, STEPS


@dataclass(frozen=True)
class Quantity:
    """A quantity in a table or figure: its label with the unit, a factor, and the digits a table gives."""

    label: str
    scale: float = 1.0
    digits: int = 3


LEVELS: tuple[tuple[str, str, str, float, int], ...] = (
    ("success, %", "rates", "success", 100, 1),
    ("moving robot hit person, %", "rates", "moving_collision", 100, 1),
    ("person touched, %", "rates", "human_collision", 100, 1),
    ("distance, m (pairs)", "pairs", DISTANCE, 1, 3),
    ("steps (pairs)", "pairs", STEPS, 1, 1),
    ("distance, m (all)", "all", DISTANCE, 1, 3),
    ("steps (all)", "all", STEPS, 1, 1),
    ("waiting, % of steps", "pairs", "waiting_share", 100, 1),
    ("joint increment, ° (pairs)", "pairs", "joint_increment_mean_deg", 1, 2),
)
"""Columns of the table of levels: heading, where the number is, its name, a factor, digits."""
SERIES: tuple[tuple[str, str, int], ...] = (("distance, m", DISTANCE, 3), ("steps", STEPS, 1))
"""Measures of the table of series: heading, name, digits."""


def cell(value: Mapping[str, Any] | None, scale: float = 1, digits: int = 1, key: str = "mean") -> str:
    """Return `mean [low, high]`, scaled; without an interval `mean`, without a value a dash."""
    if value is None:
        return "–"
    text = f"{scale * value[key]:.{digits}f}"
    if value["ci95"] is not None:
        low, high = (scale * bound for bound in value["ci95"])
        text += f" [{low:.{digits}f}, {high:.{digits}f}]"
    return text


def cells(means: Mapping[str, Any], quantities: Mapping[str, Quantity]) -> list[str]:
    """Return the cells of a table's line: the mean of each quantity with its interval."""
    return [cell(means.get(name), each.scale, each.digits) for name, each in quantities.items()]


def markdown(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in [heads, ["---"] * len(heads), *lines])


def levels(summary: Mapping[str, Any], spawns: str = "all") -> str:
    """Return the levels of a summary as a Markdown table, below them the change from first to last."""
    found = summary["spawns"][spawns]
    lines = [
        [str(at["level"]), *(cell(at[part].get(name), scale, digits) for _, part, name, scale, digits in LEVELS)]
        for at in found["levels"]
    ]
    if (whole := found["first_to_last"]) is not None:
        changes = (whole.get(part, {}).get(name) for _, part, name, *_ in LEVELS)
        label = f"{whole['from']} to {whole['to']}, change in %"
        lines.append([label, *(cell(each, key="percent") for each in changes)])
    return markdown(["level", *(heading for heading, *_ in LEVELS)], lines)


def series(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return several series of levels, by their labels, as a Markdown table of a line each.

    Least success of any level, then distance and steps over all episodes: first level, last, change in %.
    """
    heads = ["", "least success, %"]
    for heading, *_ in SERIES:
        heads += [f"{heading}: first level", "last", "change, %"]
    lines = []
    for label, summary in summaries.items():
        found = summary["spawns"]["all"]
        least = min(found["levels"], key=lambda at: at["rates"]["success"]["mean"])
        cells = [f"{100 * least['rates']['success']['mean']:.1f} (level {least['level']})"]
        for _, name, digits in SERIES:
            change = found["first_to_last"]["all"][name]
            cells += [f"{change[end]:.{digits}f}" for end in ("from", "to")]
            cells.append(cell(change, key="percent"))
        lines.append([label, *cells])
    return markdown(heads, lines)
