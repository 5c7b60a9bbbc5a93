"""Numbers and their intervals as text, and Markdown tables of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pandas import DataFrame
from rich.table import Table

from hrl_comfort.analysis.comfort import DISTANCE, SPEED, STEPS
from hrl_comfort.analysis.intervals import UNBOUNDED, Bounds


@dataclass(frozen=True)
class Quantity:
    """A quantity in a table or figure: its label with the unit, a factor, the digits that a table gives, its bounds."""

    label: str
    scale: float = 1.0
    digits: int = 3
    bounds: Bounds = UNBOUNDED


LEVELS = {
    ("rates", "success"): Quantity("success, %", 100, 1),
    ("rates", "unsafe_contact"): Quantity("unsafe contact, %", 100, 1),
    ("rates", "contact"): Quantity("contact, %", 100, 1),
    ("pairs", DISTANCE): Quantity("distance, m (pairs)"),
    ("pairs", STEPS): Quantity("steps (pairs)", digits=1),
    ("all", DISTANCE): Quantity("distance, m (all)"),
    ("all", STEPS): Quantity("steps (all)", digits=1),
    ("pairs", "waiting_share"): Quantity("waiting, % of steps", 100, 1),
    ("pairs", SPEED): Quantity("joint increment, ° (pairs)", digits=2),
}
"""Columns of the table of levels, by the part of the summary and the name in it."""
HEADLINE = {
    "success": Quantity("success (%)", 100, 1),
    "steps": Quantity("steps", digits=0),
    "human_distance_mean_m": Quantity("distance (m)", digits=2),
    "contact": Quantity("contact (%)", 100, 1),
    "unsafe_contact": Quantity("unsafe contact (%)", 100, 1),
    "other_collision": Quantity("other collisions (%)", 100, 1),
}
"""Metrics of a group of episodes that every table of evaluations shows."""
SPAWNS = {"True": "seen", "False": "unseen"}
"""Values of `seen` as text, in words; the third is all."""
SHOWN = {"comfort_level": "level", "seen": "spawns"}
"""Heads of the labels of groups that are not their names."""
ALWAYS = ("comfort_level", "split")


def cell(value: Mapping[str, Any] | float | None, scale: float = 1, digits: int = 1, key: str = "mean") -> str:
    """Return `mean [low, high]`, scaled; without an interval `mean`, without a value a dash."""
    if value is None:
        return "–"
    mean, interval = (value[key], value["ci95"]) if isinstance(value, Mapping) else (value, None)
    text = f"{scale * mean:,.{digits}f}"
    return text if interval is None else f"{text} [{', '.join(f'{scale * each:,.{digits}f}' for each in interval)}]"


def cells(means: Mapping[Any, Any], quantities: Mapping[Any, Quantity]) -> list[str]:
    """Return the cells of a table's line: the mean of each quantity with its interval."""
    return [cell(means.get(name), each.scale, each.digits) for name, each in quantities.items()]


def markdown(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in [heads, ["---"] * len(heads), *lines])


def of_means(rows: Mapping[str, Mapping[str, Any]], quantities: Mapping[str, Quantity]) -> str:
    """Return the means of each row, by its label, as a Markdown table; a quantity that no row has is left out."""
    there = {name: each for name, each in quantities.items() if any(name in row for row in rows.values())}
    heads = ["", *(each.label for each in there.values())]
    return markdown(heads, ([label, *cells(row, there)] for label, row in rows.items()))


def in_terminal(labels: Sequence[str], numbers: Sequence[str], lines: Iterable[Sequence[str]]) -> Table:
    """Return a narrow table: columns of labels, which fold, and of numbers, with a line a word of the head."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for head in labels:
        table.add_column(head, overflow="fold")
    for head in numbers:
        table.add_column(head.replace(" ", "\n"), justify="right", no_wrap=True)
    for line in lines:
        table.add_row(*line)
    return table


def of_groups(groups: Sequence[Mapping[str, Any]]) -> Table:
    """Return groups of episodes for a terminal of 80 columns: labels, number of episodes n, HEADLINE.

    A label is shown where the groups differ in it; the level and the split always. The success alone has an interval.
    """
    found = DataFrame(groups, dtype=object).drop(columns=["policy", "episodes", "metrics"])
    told = found.where(found.notna(), "-").astype(str).replace({"seen": SPAWNS})
    shown = [name for name in told if told[name].nunique() > 1 or (name in ALWAYS and told[name].iloc[0] != "-")]
    lines = []
    for group, line in zip(groups, told[shown].to_numpy(), strict=True):
        means = {
            name: each and (each if name == "success" else each["mean"]) for name, each in group["metrics"].items()
        }
        lines.append([*line, str(group["episodes"]), *cells(means, HEADLINE)])
    labels = [SHOWN.get(name, name.removesuffix("_m")) for name in shown]
    heads = " | ".join(each.label for each in HEADLINE.values())
    for word, short in ("collisions", "coll."), ("distance", "dist."), ("unsafe contact", "unsafe"):
        heads = heads.replace(word, short)
    return in_terminal(labels, ["n", *heads.split(" | ")], lines)


def levels(summary: Mapping[str, Any], spawns: str = "all") -> str:
    """Return the levels of a summary as a Markdown table, below them the change from first to last.

    A quantity that no level has is left out.
    """
    found = summary["spawns"][spawns]
    there = {at: each for at, each in LEVELS.items() if any(at[1] in level[at[0]] for level in found["levels"])}
    lines = [
        [str(at["level"]), *cells({(part, name): at[part].get(name) for part, name in there}, there)]
        for at in found["levels"]
    ]
    if (whole := found["first_to_last"]) is not None:
        changes = [cell(whole.get(part, {}).get(name), key="percent") for part, name in there]
        lines.append([f"{whole['from']} to {whole['to']}, change in %", *changes])
    return markdown(["level", *(each.label for each in there.values())], lines)
