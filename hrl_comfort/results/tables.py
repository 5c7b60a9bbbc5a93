"""Tables of committed results, as Markdown. Names of files are in runs/reference."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pandas as pd

from hrl_comfort.analysis.episodes import success
from hrl_comfort.analysis.tables import cell, levels, markdown
from hrl_comfort.benchmarks import entries, env, tops, train, update
from hrl_comfort.files.tables import read_table
from hrl_comfort.results.manifest import REFERENCE

CONTACTS = (*entries.HEADLINE, "contacts_per_h", "other_collisions_per_h")
"""Quantities of the table of policies without the shield."""
COLUMNS = (
    "evaluation", "seeds", "episodes", "success, % [95 %]", "seen spawns, %", "unseen spawns, %", "steps",
    "contact, %", "unsafe contact, %", "other collision, %",
)  # fmt: skip


def evaluations(names: str) -> str:
    """Return a table with a line for each pattern of folders of evaluations; their training seeds are pooled."""
    return markdown(COLUMNS, (line(name) for name in names.split()))


def line(name: str) -> list[str]:
    """Return the cells of the evaluations that match a pattern.

    With several training seeds the interval is Student's t over them, else a bootstrap over spawn points.
    """
    found = sorted(REFERENCE.glob(f"{name}/episodes.parquet"))
    if not found:
        raise FileNotFoundError(f"runs/reference/{name}/episodes.parquet does not exist")
    rows = pd.concat([read_table(path.with_suffix(".csv")) for path in found], ignore_index=True)
    spawns = [rows["success"][rows["seen"].eq(seen).fillna(False)] for seen in (True, False)]
    won = rows[rows["success"]]
    collision = rows["other_collision"] != "none"
    hits = (rows[name].mean() if name in rows else None for name in ("contact", "unsafe_contact"))
    return [
        "/".join(part for part in name.split("/") if "*" not in part and part not in ("eval", "test")),
        f"{rows['train_seed'].nunique()}",
        f"{len(rows):,}",
        cell(success(rows), 100),
        *(f"{100 * each.mean():.1f}" if len(each) else "–" for each in spawns),
        f"{won['steps'].mean():.0f}" if len(won) else "–",
        *(cell(share, 100) for share in (*hits, float(collision.mean()))),
    ]


def of_json(table: Callable[[dict[str, Any]], str]) -> Callable[[str], str]:
    """Return what makes a table of the JSON file that it is given the name of."""
    return lambda name: table(json.loads((REFERENCE / name).read_text(encoding="utf-8")))


def of_rows(table: Callable[[pd.DataFrame], str]) -> Callable[[str], str]:
    """Return what makes a table of the CSV file that it is given the name of."""

    def make(name: str) -> str:
        rows = read_table(REFERENCE / name)
        if rows is None:
            raise FileNotFoundError(f"runs/reference/{name} does not exist")
        return table(rows)

    return make


def as_it_is(rows: pd.DataFrame) -> str:
    """Return the rows of a CSV as a table."""
    return markdown(list(rows), (["–" if pd.isna(each) else str(each) for each in row] for row in rows.to_numpy()))


def attacks(rows: pd.DataFrame) -> str:
    """Return what `tests.safety.persistent` counted, of all policies together."""
    columns = {
        "control_steps": ("control steps", "sum", "{:,.0f}"),
        "contacts": ("contacts", "sum", "{:,.0f}"),
        "unsafe_contacts": ("unsafe", "sum", "{:,.0f}"),
        "fastest_m_s": ("fastest, m/s", "max", "{:.2f}"),
        "excess_rad": ("following error less its bound, rad", "max", "{:.3f}"),
        "human_beyond_bound": ("people beyond the bound, steps", "sum", "{:,.0f}"),
    }
    how = {name: each for name, (_, each, _) in columns.items()}
    found = rows.groupby(["task", "human", "bound"], sort=False).agg(how)
    lines = (
        [*(f"`{name}`" for name in key), *(form.format(row[name]) for name, (*_, form) in columns.items())]
        for key, row in found.iterrows()
    )
    return markdown(["task", "people", "bound", *(head for head, *_ in columns.values())], lines)


def of_names(names: str) -> list[entries.Entry]:
    """Return the entries of the benchmark, `all` or those named, in the order of the names."""
    found = entries.committed(entries.ENTRIES)
    asked = list(found) if names == "all" else names.split()
    if absent := set(asked) - set(found):
        raise FileNotFoundError(f"{entries.ENTRIES} has no entry {', '.join(sorted(absent))}")
    return [found[name] for name in asked]


def by_shield(name: str) -> str:
    """Return what the shield changes of an entry with several training seeds: with it less without it."""
    return entries.differences(entries.ENTRIES / name, REFERENCE / "unshielded" / name, CONTACTS)


def of_entries(table: Callable[..., str]) -> Callable[[str], str]:
    """Return what makes a table of the two entries that it is given the names of."""
    return lambda names: table(*(entries.ENTRIES / name for name in names.split()))


KINDS: dict[str, Callable[[str], str]] = {
    "evaluations": evaluations,
    "levels": of_json(levels),
    "entries": lambda names: entries.table(of_names(names)),
    "entries in brief": lambda names: entries.table(of_names(names), entries.HEADLINE),
    "without shield": lambda name: entries.table([entries.read_entry(REFERENCE / "unshielded" / name)], CONTACTS),
    "with less without shield": by_shield,
    "responses": of_entries(entries.responses),
    "closed loop": of_entries(entries.at_same_throughput),
    "bench env": of_rows(env.table),
    "bench update": of_rows(update.table),
    "bench train": of_rows(train.table),
    "attacks": of_rows(attacks),
    "tops": of_rows(tops.table),
    "csv": of_rows(as_it_is),
}
"""Makers of tables by the name that a page marks them with."""
