"""Tables of committed results, as Markdown. Names of files are in runs/reference."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from hrl_comfort.analysis.episodes import success
from hrl_comfort.analysis.tables import cell, levels, markdown
from hrl_comfort.benchmarks import entries, env, learners, returns, throughput, tops, train, update
from hrl_comfort.files.tables import read_table
from hrl_comfort.results.manifest import REFERENCE

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


def grasps(rows: pd.DataFrame) -> str:
    """Return how many places of `tests.hand.campaign` were lifted, held and placed: an object a line, by arm and hand.

    The last line is the greatest speed of an object that was carried.
    """
    counted = rows.groupby(["cell", "object", "robot", "gripper"], sort=False)
    told = counted[["lifted", "held", "placed"]].sum()
    hands = [(robot, hand) for robot, hand in rows[["robot", "gripper"]].drop_duplicates().to_numpy()]
    lines = [
        [f"`{kind}` of `cell={place}`", *(" / ".join(map(str, told.loc[place, kind, *hand])) for hand in hands)]
        for place, kind in rows[["cell", "object"]].drop_duplicates().to_numpy()
    ]
    fastest = rows.groupby(["robot", "gripper"])["fastest_m_s"].max()
    lines.append(["fastest, m/s", *(f"{fastest[hand]:.2f}" for hand in hands)])
    return markdown(["object", *(f"`{robot}`, `{hand}`" for robot, hand in hands)], lines)


def hand_cycles(rows: pd.DataFrame) -> str:
    """Return what `tests.deploy.hand_campaign` counted."""
    whole, lost = rows[~rows["pulled"]], rows[rows["pulled"]]
    heads = ("cycles", "success", "grips lost by force", "noticed in time", "longest time, s")
    counts = len(whole), whole["success"].sum(), len(lost), lost["noticed"].eq(True).sum()
    return markdown(heads, [[*map(str, counts), f"{lost['noticed_s'].max():.2f}"]])


def folder_of(name: str) -> Path:
    """Return the folder of an entry; raise FileNotFoundError if it holds none."""
    folder = REFERENCE / "benchmark" / name
    if not [*folder.rglob(entries.FILE)]:
        raise FileNotFoundError(f"{folder} has no entry")
    return folder


def of_entries(asked: str) -> str:
    """Return the table of a part and entries: `kitting all`, or the part and their names."""
    part, *those = asked.split()
    if those == ["all"]:
        those = [name for name, each in entries.committed(entries.ENTRIES).items() if part in each["parts"]]
    found = [entries.read_entry(folder_of(name)) for name in those]
    if not found:
        raise FileNotFoundError(f"{entries.ENTRIES} has no entry of {part}")
    return entries.table(part, found)


def closed_loop(asked: str) -> str:
    """Return what a level from the person is worth: the part, the entries that are told, at fixed levels, and idle."""
    part, *names = asked.split()
    return throughput.of_a_told_robot(part, *map(folder_of, names))


def responses(asked: str) -> str:
    """Return what levels change in a part of an entry with training seeds: the part, and the entry."""
    part, name = asked.split()
    return entries.responses(part, folder_of(name))


def beside_rivals(asked: str) -> str:
    """Return what a part of an entry is worth at equal throughput: the part, the entry and its rivals."""
    part, name, *rivals = asked.split()
    return throughput.of_rivals(part, folder_of(name), [folder_of(rival) for rival in rivals])


def returns_beside_rivals(asked: str) -> str:
    """Return what an entry of kitting earns: the price of a second of discomfort, the entry and its rivals."""
    price, name, *rivals = asked.split()
    return returns.of_rivals(float(price), folder_of(name), [folder_of(rival) for rival in rivals])


KINDS: dict[str, Callable[[str], str]] = {
    "evaluations": evaluations,
    "levels": of_json(levels),
    "entries": of_entries,
    "responses": responses,
    "closed loop": closed_loop,
    "equal throughput": beside_rivals,
    "returns": returns_beside_rivals,
    "bench env": of_rows(env.table),
    "bench update": of_rows(update.table),
    "bench train": of_rows(train.table),
    "attacks": of_rows(attacks),
    "grasps": of_rows(grasps),
    "hand cycles": of_rows(hand_cycles),
    "tops": of_rows(tops.table),
    "learners": of_rows(learners.table),
    "csv": of_rows(as_it_is),
}
"""Makers of tables by the name that a page marks them with."""
