"""Fill the marked tables of README.md and of pages in docs/: `python docs/tables.py`; draw docs/images/benchmark.png.

A table stands between `<!-- KIND: NAME ... -->` and `<!-- end -->`. Names are in runs/reference. For the kind
`evaluations` they are folders of evaluations, one line each; a name with a `*` pools the episodes of all folders that
match. For `ledger` it is the start of a policy's name. For `entries`, `entries in brief`, `responses` and `closed loop`
they are in docs/tables/benchmark, for `without shield` in docs/tables/unshielded; the first two and the last take `all`
too. For `with less without shield` they are in both. For the other kinds it is the file that `hrl-comfort figure` or
`hrl-comfort bench` wrote.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from hrl_comfort.analysis import comparison, handover
from hrl_comfort.analysis.episodes import success
from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import cell, levels, markdown, series
from hrl_comfort.benchmarks import entries, env, train, update
from hrl_comfort.files.tables import read_table
from hrl_comfort.plots.benchmark import front
from hrl_comfort.plots.style import save_png

ROOT = Path(__file__).resolve().parent.parent
PAGES = (
    ROOT / "README.md",
    *(ROOT / "docs" / f"{name}.md" for name in ("results", "safety")),
)
REFERENCE = ROOT / "runs" / "reference"
UNSHIELDED = ROOT / "docs" / "tables" / "unshielded"
CONTACTS = (*entries.HEADLINE, "contacts_per_h", "other_collisions_per_h")
"""Quantities of the table of policies without the shield."""
COLUMNS = (
    "evaluation", "episodes", "success, % [95 %]", "on seen spawns", "on unseen spawns", "steps",
    "human distance, m", "human hit, %", "cell or self hit, %",
)  # fmt: skip


def evaluations(names: str) -> str:
    """Return the table of evaluations, one line each."""
    return markdown(COLUMNS, (line(name) for name in names.split()))


def line(name: str) -> list[str]:
    """Return the cells of one evaluation, or of the pooled episodes of those that match."""
    found = sorted(REFERENCE.glob(f"{name}/episodes.parquet"))
    if not found:
        raise FileNotFoundError(f"runs/reference/{name}/episodes.parquet does not exist")
    rows = pd.concat([read_table(path.with_suffix(".csv")) for path in found], ignore_index=True)
    shares = [rows["success"][rows["seen"] == seen].mean() for seen in (True, False)]
    won = rows[rows["success"]]
    hits = rows["contact"].mean(), (rows["other_collision"] != "none").mean()
    return [
        name.removesuffix("/eval"),
        f"{len(rows)}",
        cell(success(rows), 100),
        *(f"{100 * share:.1f}" for share in shares),
        f"{won['steps'].mean():.0f}" if len(won) else "–",
        f"{won['human_distance_mean_m'].mean():.3f}" if len(won) else "–",
        *(f"{100 * share:.1f}" for share in hits),
    ]


def of_json(table: Callable[[dict[str, Any]], str]) -> Callable[[str], str]:
    """Return what makes a table of the JSON file that it is given the name of."""
    return lambda name: table(json.loads((REFERENCE / name).read_text(encoding="utf-8")))


def of_rows(table: Callable[[pd.DataFrame], str]) -> Callable[[str], str]:
    """Return what makes a table of the CSV file that it is given the name of."""
    return lambda name: table(read_table(REFERENCE / name))


def on_test(policies: str) -> str:
    """Return the table of the ledger's evaluations of policies in a folder, one policy or chain a training seed."""
    ledger = read_table(ROOT / "docs" / "tables" / "test_ledger.csv")
    lines = []
    for (task, human), runs in ledger[ledger["policy"].str.startswith(policies)].groupby(["task", "human"], sort=False):
        seeds = Clusters.of_runs(len(runs))
        won = seeds.estimate(runs["success"].to_numpy(), bounds=SHARE)
        hits = (f"{100 * runs[name].mean():.1f}" for name in ("contact", "unsafe_contact"))
        lines.append([str(task), str(human), f"{len(runs)}", f"{runs['episodes'].iloc[0]}", cell(won, 100), *hits])
    head = ("task", "people", "seeds", "episodes a seed", "success, % [95 %]", "contacts, %", "unsafe, %")
    return markdown(head, lines)


def entered(names: str) -> str:
    """Return the table of the benchmark's entries, `all` or those named."""
    return entries.table(of_names(names))


def in_brief(names: str) -> str:
    """Return the short table of the benchmark's entries, `all` or those named."""
    return entries.table(of_names(names), entries.HEADLINE)


def without_shield(names: str) -> str:
    """Return the table of policies in the benchmark without the shield, `all` or those named."""
    return entries.table(of_names(names, UNSHIELDED), CONTACTS)


def by_shield(name: str) -> str:
    """Return what the shield changes of an entry with several training seeds: with it less without it."""
    return entries.differences(entries.ENTRIES / name, UNSHIELDED / name, CONTACTS)


def of_names(names: str, folder: Path = entries.ENTRIES) -> list[entries.Entry]:
    """Return the entries of a folder, `all` or those named, in the order of the names."""
    found = entries.committed(folder)
    return [found[name] for name in (found if names == "all" else names.split())]


def of_entries(table: Callable[[Path, Path], str]) -> Callable[[str], str]:
    """Return what makes a table of the two folders of entries that it is given the names of."""
    return lambda names: table(*(entries.ENTRIES / name for name in names.split()))


KINDS: dict[str, Callable[[str], str]] = {
    "evaluations": evaluations,
    "levels": of_json(levels),
    "series": of_json(lambda found: series({label: each["each"] for label, each in found.items()})),
    "controllers": of_json(comparison.table),
    "divisions": of_json(comparison.table),
    "handover": of_json(handover.table),
    "ledger": on_test,
    "entries": entered,
    "entries in brief": in_brief,
    "without shield": without_shield,
    "with less without shield": by_shield,
    "responses": of_entries(entries.responses),
    "closed loop": of_entries(entries.at_same_throughput),
    "bench env": of_rows(env.table),
    "bench update": of_rows(update.table),
    "bench train": of_rows(train.table),
}
MARKED = re.compile(rf"(<!-- ({'|'.join(KINDS)}): ([^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)


def filled(page: str) -> str:
    """Return the page with every marked table made anew."""
    return MARKED.sub(lambda found: found[1] + KINDS[found[2]](found[3]) + found[4], page)


if __name__ == "__main__":
    save_png(front(of_names("all")), ROOT / "docs" / "images" / "benchmark.png")
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")
