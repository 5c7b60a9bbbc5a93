"""What comfort levels change as a Markdown table, for the docs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hrl_comfort.analysis.comfort import DISTANCE, STEPS

TABLE: tuple[tuple[str, str, str, float, int], ...] = (
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
"""Columns of the table: heading, where the number is, its name, a factor, digits."""


def markdown(summary: Mapping[str, Any], spawns: str = "all") -> str:
    """Return a summary's levels as a Markdown table.

    Below the levels comes the change from first to last; where there are several training seeds, once more
    with the interval that lets a spawn point do the same to all of them (`Clusters.two_way`).
    """
    found = summary["spawns"][spawns]
    lines = [["level", *(heading for heading, *_ in TABLE)], ["---"] * (1 + len(TABLE))]
    for at in found["levels"]:
        cells = (cell(at[part].get(name), "mean", scale, digits) for _, part, name, scale, digits in TABLE)
        lines.append([str(at["level"]), *cells])
    if (whole := found["first_to_last"]) is not None:
        changes = [whole.get(part, {}).get(name) for _, part, name, *_ in TABLE]
        what = f"{whole['from']} to {whole['to']}, change in %"
        lines.append([what, *(cell(each, "percent", 1, 1) for each in changes)])
        stricter = [each and {**each, "ci95": each["ci95_two_way"]} for each in changes]
        if any(each and each["ci95"] != each["ci95_two_way"] for each in changes):
            lines.append(["likewise, stricter interval", *(cell(each, "percent", 1, 1) for each in stricter)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cell(value: Mapping[str, Any] | None, key: str, scale: float, digits: int) -> str:
    """Return `value[key]`, scaled, with its interval if it has one; a dash where there is no value."""
    if value is None:
        return "–"
    text = f"{scale * value[key]:.{digits}f}"
    if value["ci95"] is not None:
        text += " [{:.{d}f}, {:.{d}f}]".format(*(scale * bound for bound in value["ci95"]), d=digits)
    return text


SERIES: tuple[tuple[str, str, int], ...] = (("distance, m", DISTANCE, 3), ("steps", STEPS, 1))
"""What the table of series says of the first and the last level and of the change: heading, name, digits."""


def series(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Return several series of levels, by their labels, as a Markdown table of a line each.

    Least success of any level, then distance and steps over all episodes: first level, last, change in %.
    """
    heads = ["", "least success, %"]
    for what, *_ in SERIES:
        heads += [f"{what}: first level", "last", "change, %"]
    lines = [heads, ["---"] * len(heads)]
    for label, summary in summaries.items():
        found = summary["spawns"]["all"]
        least = min(found["levels"], key=lambda at: at["rates"]["success"]["mean"])
        cells = [f"{100 * least['rates']['success']['mean']:.1f} (level {least['level']})"]
        for _, name, digits in SERIES:
            change = found["first_to_last"]["all"][name]
            cells += [f"{change[end]:.{digits}f}" for end in ("from", "to")]
            cells.append(cell(change, "percent", 1, 1))
        lines.append([label, *cells])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
