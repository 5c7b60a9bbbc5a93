"""Does the choice of the next job matter? Returns of rules, fixed orders and the oracle in equal shifts of `kitting`.

`python -m hrl_comfort.benchmarks.tops FILE.csv SHIFTS WORDS…` measures them on `split=validation`; the words, those of
`hrl-comfort evaluate`, come after WORDS.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CellConfig, EvaluateConfig
from hrl_comfort.config.hierarchy import ORACLE
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.files.run_config import environment
from hrl_comfort.files.tables import write_table
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Choose, Decision, Top
from hrl_comfort.hierarchy.executor import OptionExecutor, execute
from hrl_comfort.hierarchy.options import OptionTable
from hrl_comfort.hierarchy.tops import TOPS
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.processes.engine import make_engine

WORDS = (
    "task=kitting", "human=fetcher", "reward=kitting", "comfort=kitting", "safety=ssm", "robot.rating=collaborative",
    "task.terminate_on=unsafe_contact", "meta_controller=nearest", "policies.pick=direct", "policies.place=direct",
    "policies.return=direct",
)  # fmt: skip
"""The world and skills that are measured, in words of `hrl-comfort evaluate`: scripted skills behind the shield."""
RULES = ("random", "nearest", "free", "patient", "due")
FIXED = "fixed"
TERMS = {
    "return": "return",
    "place": "orders filled",
    "missed": "orders missed, weighted",
    "comfort": "discomfort, weighted",
}
"""Columns of the CSV and their heads in the table; all but the first are reward terms with their weights."""


def measure(config: EvaluateConfig, shifts: int) -> DataFrame:
    """Return a row for each top and shift; the tops but the oracle work side by side."""
    entries = open_split(replace(config, split="validation", episodes=shifts)).entries
    env = environment(config)
    names = [*RULES, *(f"{FIXED} {' '.join(order)}" for order in orders(config.cell))]
    engine = make_engine(env, shifts * len(names), 0, entries.at(np.tile(np.arange(shifts), len(names))))
    executor, _ = make_executor(config, None, engine, 0)
    tops = [top_of(name, config, executor.table) for name in names]

    def choose(decision: Decision) -> torch.Tensor:
        every = torch.stack([top(decision) for top in tops])
        return every[torch.arange(len(tops)).repeat_interleave(shifts), torch.arange(shifts * len(tops))]

    rows = [*worked(engine, executor, Top("all", choose), np.repeat(names, shifts))]
    oracle = replace(config, meta_controller=replace(config.meta_controller, name=ORACLE))
    engine = make_engine(env, shifts, 0, entries)
    rows += worked(engine, *make_executor(oracle, None, engine, 0), np.repeat([ORACLE], shifts))
    return DataFrame(rows).assign(shift=np.tile(np.arange(shifts), len(names) + 1))


def worked(engine: Engine, executor: OptionExecutor, top: Top, names: NDArray[np.str_]) -> list[dict[str, str | float]]:
    """Return a row for each cell of `engine`, of which `names` (N,) says who chooses there."""
    engine.reset()
    paid = torch.zeros(engine.num_envs, len(engine.episodes.reward_names), dtype=torch.float64)
    for step in execute(engine, executor, top):
        paid += step.result.reward_terms * step.active[:, None]
    engine.close()
    terms = [dict(zip(engine.episodes.reward_names, row, strict=True)) for row in paid.tolist()]
    return [
        {"top": str(name), **{term: round(sum(row.values()) if term == "return" else row[term], 6) for term in TERMS}}
        for name, row in zip(names, terms, strict=True)
    ]


def orders(cell: CellConfig) -> list[list[str]]:
    """Return the fixed orders of areas that are tried: round the robot either way, from each of them on."""
    areas = list(cell.places)
    return [list(np.roll(way, -first)) for way in (areas, areas[::-1]) for first in range(len(areas))]


def top_of(name: str, config: EvaluateConfig, table: OptionTable) -> Choose:
    """Return a top by its name; that of a fixed order is followed by the areas."""
    kind, *areas = name.split()
    picks = [
        f"pick_{index}"
        for area in areas
        for index, each in enumerate(config.cell.objects.values(), start=1)
        if each.arrives_at == area
    ]
    return TOPS[kind](replace(config, meta_controller=replace(config.meta_controller, order=picks)), table, 0)


def table(rows: DataFrame) -> str:
    """Return the means of the rows of each top with intervals over shifts, and the oracle less the top in %.

    Of the fixed orders the best is shown, in hindsight.
    """
    of = {str(name): group.sort_values("shift") for name, group in rows.groupby("top", sort=False)}
    best = max((name for name in of if name.startswith(FIXED)), key=lambda name: float(of[name]["return"].mean()))
    shown = [name for name in of if name == best or not name.startswith(FIXED)]
    runs = Clusters.of_runs(int(rows["shift"].nunique()))
    lines = []
    for name in shown:
        mine, oracle = (of[each]["return"].to_numpy() for each in (name, ORACLE))
        more = None if name == ORACLE else runs.estimate(oracle - mine)
        values = (runs.estimate(of[name][term].to_numpy()) for term in TERMS)
        share = "–" if more is None or mine.mean() <= 0 else f"{100 * more['mean'] / mine.mean():.0f}"
        lines.append([f"`{name}`", *(cell(value, digits=2) for value in values), cell(more, digits=2), share])
    return markdown(["choice", *TERMS.values(), "oracle above it", "the same, %"], lines)


def main(words: Sequence[str]) -> None:
    """Measure, and write the CSV."""
    torch.set_num_threads(1)
    path, shifts, *asked = words
    config = compose("evaluate", [*WORDS, *asked])
    assert isinstance(config, EvaluateConfig)
    rows = measure(config, int(shifts))
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_table(Path(path), list(rows), rows.itertuples(index=False, name=None))
    print(table(pd.read_csv(path)))


if __name__ == "__main__":
    main(sys.argv[1:])
