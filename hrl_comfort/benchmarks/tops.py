"""Does the choice of the next job matter? Returns of rules, fixed orders and the oracle in equal shifts of `kitting`.

In some shifts the oracle judges the choices of all but an idle arm and fixed orders that are not the best.

`python -m hrl_comfort.benchmarks.tops FILE.csv SHIFTS [learned=PATTERN…] WORDS…` measures them, and the learned tops
and flat policies whose run folders match the patterns; the words, those of `hrl-comfort evaluate`, come after WORDS.
Tops that are in the file are not measured again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.analysis.intervals import Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.benchmarks.measure import as_command, given
from hrl_comfort.benchmarks.suite import check_steps
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CellConfig, ConfigError, EvaluateConfig, MetaControllerTrainConfig, TrainConfig
from hrl_comfort.config.checks import import_object
from hrl_comfort.config.hierarchy import LOOKAHEAD, ORACLE
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.files.run_config import environment, load_config
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Choose, Decision, Top
from hrl_comfort.hierarchy.executor import OptionExecutor, execute
from hrl_comfort.hierarchy.look_ahead import FUTURES, Judged, LookAhead
from hrl_comfort.hierarchy.options import OptionTable
from hrl_comfort.hierarchy.tops import TOPS
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.tasks.kitting import KITTING

WORDS = (
    "task=kitting", "human=fetcher", "reward=kitting", "comfort=kitting", "safety=ssm", "robot.rating=collaborative",
    "task.terminate_on=unsafe_contact", "meta_controller=nearest", "policies.pick=direct", "policies.place=direct",
    "policies.return=direct", "meta_controller.level_override=[]", "split=validation",
)  # fmt: skip
"""The world that is measured, and scripted skills behind the shield at its one level, in words of `evaluate`."""
IDLE = "idle"
RULES = ("random", "nearest", "free", "patient", "due", "greedy")
LOOKING = {ORACLE: 0, LOOKAHEAD: FUTURES}
"""Tops that look ahead, and the number of futures that they draw."""
JUDGED = 12
"""Number of shifts, the first, in which the oracle judges every choice, for which it tries every option."""
RULE = "due"
"""The rule that others are compared with, beside the oracle."""
FIXED, LEARNED, FLAT = "fixed", "learned", "flat"
"""Kinds of tops, and a policy without a top; a learned top is shown by the name of its learner."""
TOLD = "top.json"
"""File of the folder of a top that another library trained: its `learner`, `train_seed`, and as `chooser` a
`package.module:name`, a function that makes the top from the folder and the configuration."""
TERMS = {
    "return": "return",
    "place": "orders filled",
    "missed": "orders missed, weighted",
    "comfort": "discomfort, weighted",
    "regret": "regret",
}
"""Columns of the CSV and their heads in the table; all but the first and the last are reward terms with their weights.
The regret is the sum of that of each choice (`hierarchy.look_ahead`), empty where nobody judged."""
COLUMNS = ("top", "seed", "shift", *TERMS)


def measure(
    config: EvaluateConfig, shifts: int, learned: Sequence[Path] = (), done: DataFrame | None = None
) -> Iterator[DataFrame]:
    """Yield a row for each top and shift so far, of a learned one by its learner and with its training seed.

    Fixed orders, and then all others that are shown, work side by side. `lookahead` works alone, and so does each flat
    policy, which takes the objects as they are numbered. Tops of rows that are `done` already do not work again, but
    for one, for comparison.

    Raises:
      ConfigError: what is `done` is of other shifts, or of another world, or `lookahead` would know ahead what happens.
    """
    config.check_ahead(LOOKAHEAD)
    names = {f"{LEARNED} {folder}": told for folder, told in learners_and_seeds(learned).items()}
    flat = [name for name, (learner, _) in names.items() if learner.startswith(f"{FLAT} ")]
    for name in flat:
        check_steps(config, LEARNED, name.removeprefix(f"{LEARNED} "))
    look = open_split(replace(config, episodes=shifts), further=[str(folder) for folder in learned])
    if done is None:
        done = _beside(config, look.entries)
    else:
        again = RULE if RULE in set(done["top"]) else IDLE  # the rules were not done when the measurement was stopped
        _check_same(done, _side_by_side(config, look.entries, [again]))
    ready = set(zip(done["top"], done["seed"], strict=True))
    for name in [name for name, told in names.items() if told in ready]:
        learner, seed = names.pop(name)
        print(f"{name.removeprefix(f'{LEARNED} ')} is not measured: {learner} of train_seed={seed} is in the file")
    rules = [name for name in RULES if name not in set(done["top"])]
    tops = rules + [name for name in names if name not in flat]
    told = {**{name: (name, pd.NA) for name in (*rules, LOOKAHEAD)}, **names}

    def with_told(rows: DataFrame) -> DataFrame:
        learners, seeds = zip(*(told[name] for name in rows["top"]), strict=True)
        whole = pd.concat([done, rows.assign(top=learners, seed=seeds)], ignore_index=True)
        return whole.astype({"seed": "Int64"})[list(COLUMNS)]

    yield done
    if tops:
        yield (done := with_told(_judged(config, look.entries, tops)))
    if LOOKAHEAD not in set(done["top"]):
        yield (done := with_told(_judged(config, look.entries, [LOOKAHEAD])))
    for name in [name for name in names if name in flat]:
        yield (done := with_told(_alone(config, look.entries, name)))
    look.completed()


def _beside(config: EvaluateConfig, entries: EvaluationSet) -> DataFrame:
    """Return the rows of an idle arm, of fixed orders and of the oracle."""
    tried = _side_by_side(config, entries, [f"{FIXED} {' '.join(order)}" for order in orders(config.cell)])
    best = str(tried.groupby("top")["return"].mean().idxmax())
    idle = _side_by_side(config, entries, [IDLE])
    oracle = _side_by_side(config, entries, [ORACLE]).assign(regret=0.0)
    every = [idle, _judged(config, entries, [best]), tried[tried["top"] != best], oracle]
    rows = pd.concat(every, ignore_index=True).assign(seed=pd.NA)
    return rows.astype({"seed": "Int64"})[list(COLUMNS)]


def _judged(config: EvaluateConfig, entries: EvaluationSet, names: list[str]) -> DataFrame:
    """Return the rows of tops, with the regret in the first JUDGED shifts."""
    shown = _side_by_side(config, entries, names).drop(columns="regret")
    first = entries.at(np.arange(min(len(entries.episode), JUDGED)))
    judged = _side_by_side(config, first, names, judged=True)
    return shown.merge(judged[["top", "shift", "regret"]], how="left")


def _check_same(done: DataFrame, again: DataFrame) -> None:
    """Raise ConfigError if a top that works `again` does not earn what it did."""
    name = str(again["top"].iloc[0])
    before = done[done["top"] == name].sort_values("shift")
    if len(before) != len(again):
        raise ConfigError(f"the file is there already, of {len(before)} shifts; choose another file")
    if not np.allclose(before["return"], again["return"], rtol=0, atol=1e-5):
        raise ConfigError(f"the file is there already, and {name} earned other returns there; choose another file")


def _side_by_side(config: EvaluateConfig, entries: EvaluationSet, names: list[str], judged: bool = False) -> DataFrame:
    """Return a row for each of the tops `names` and each shift of `entries`."""
    shifts = len(entries.episode)
    every = entries.at(np.tile(np.arange(shifts), len(names)))
    engine = make_engine(environment(config), len(every.episode), 0, every)
    executor, _ = make_executor(config, None, engine, 0)
    tops = [
        LookAhead(engine, executor, LOOKING[name]) if name in LOOKING else top_of(name, config, executor.table)
        for name in names
    ]

    def choose(decision: Decision) -> torch.Tensor:
        every = torch.stack([top(decision) for top in tops])
        return every[torch.arange(len(tops)).repeat_interleave(shifts), torch.arange(shifts * len(tops))]

    top = Top("all", choose, together=not LOOKING.keys().isdisjoint(names))
    judge = Judged(top, LookAhead(engine, executor)) if judged else top
    rows = worked(engine, executor, judge, np.repeat(names, shifts))
    return DataFrame(rows).assign(shift=np.tile(np.arange(shifts), len(names)))


def _alone(config: EvaluateConfig, entries: EvaluationSet, name: str) -> DataFrame:
    """Return a row for each shift of `entries` of the flat policy `name`, which has no regret: it does not choose."""
    top, folder, shifts = config.meta_controller.alone(), name.removeprefix(f"{LEARNED} "), len(entries.episode)
    flat = replace(config, meta_controller=top, policies={}, policy=folder)
    engine = make_engine(environment(flat), shifts, 0, entries)
    rows = worked(engine, *make_executor(flat, None, engine, 0), np.repeat(name, shifts))
    return DataFrame(rows).assign(shift=np.arange(shifts))


def worked(engine: Engine, executor: OptionExecutor, top: Top, names: NDArray[np.str_]) -> list[dict[str, str | float]]:
    """Return a row for each cell of `engine`, of which `names` (N,) says who chooses there."""
    engine.reset()
    paid = torch.zeros(engine.num_envs, len(engine.episodes.reward_names), dtype=torch.float64)
    regret = torch.full((engine.num_envs,), 0.0 if isinstance(top, Judged) else torch.nan, dtype=torch.float64)
    for step in execute(engine, executor, top):
        paid += step.result.reward_terms * step.active[:, None]
        if isinstance(top, Judged):
            for run in step.runs:
                regret[run.row] += top.regret(run)
    engine.close()
    terms = [dict(zip(engine.episodes.reward_names, row, strict=True)) for row in paid.tolist()]
    values = [
        {**row, "return": sum(row.values()), "regret": lost} for row, lost in zip(terms, regret.tolist(), strict=True)
    ]
    return [
        {"top": str(name), **{term: round(row[term], 6) for term in TERMS}}
        for name, row in zip(names, values, strict=True)
    ]


def orders(cell: CellConfig) -> list[list[str]]:
    """Return the fixed orders of areas that are tried: round the robot either way, from each of them on."""
    areas = list(cell.places)
    return [list(np.roll(way, -first)) for way in (areas, areas[::-1]) for first in range(len(areas))]


def top_of(name: str, config: EvaluateConfig, table: OptionTable) -> Choose:
    """Return a top by its name; that of a fixed order is followed by the areas, `learned` by a run folder."""
    if name.startswith(f"{LEARNED} "):
        folder = name.removeprefix(f"{LEARNED} ")
        if (elsewhere := trained_elsewhere(Path(folder))) is not None:
            made: Choose = import_object("chooser", elsewhere["chooser"])(Path(folder), config)
            return made
        under, parts = replace(config.meta_controller, name=LEARNED), {**config.policies, "meta_controller": folder}
        return TOPS[LEARNED](replace(config, meta_controller=under, policies=parts), table, 0)
    kind, *areas = name.split()
    picks = [
        f"pick_{index}"
        for area in areas
        for index, each in enumerate(config.cell.objects.values(), start=1)
        if each.arrives_at == area
    ]
    own = replace(config.meta_controller, name=kind, order=picks)
    return TOPS[kind](replace(config, meta_controller=own), table, 0)


def table(rows: DataFrame) -> str:
    """Return the means of the rows of each top with intervals, and how far its return is above those of some others.

    Intervals are over the shifts, of learned tops over their training seeds. Of the fixed orders the best is shown, in
    hindsight.
    """
    of = {str(name): group.sort_values(["seed", "shift"]) for name, group in rows.groupby("top", sort=False)}
    best = max((name for name in of if name.startswith(FIXED)), key=lambda name: float(of[name]["return"].mean()))
    places = {name: place for place, name in enumerate([IDLE, *RULES, best, LOOKAHEAD])}
    places[ORACLE] = len(places) + len(of)
    shown = [name for name in of if name == best or not name.startswith(FIXED)]
    shown.sort(key=lambda name: (places.get(name, len(places)), name))
    beside = {name: of[name].set_index("shift")["return"] for name in (RULE, ORACLE)}
    lines = []
    for name in shown:
        mine, shift = of[name]["return"].to_numpy(), of[name]["shift"]
        runs = Clusters.of_runs(len(mine)) if of[name]["seed"].isna().all() else Clusters.of(clustered(of[name]))
        values = [runs.estimate(of[name][term].to_numpy()) for term in TERMS]
        above = [None if name == each else runs.estimate(mine - beside[each][shift].to_numpy()) for each in beside]
        lines.append([f"`{name}`", *(cell(value, digits=2) for value in (*values, *above))])
    return markdown(["choice", *TERMS.values(), *(f"above `{each}`" for each in beside)], lines)


def learners_and_seeds(folders: Sequence[Path]) -> dict[Path, tuple[str, int]]:
    """Return the learner of the top or flat policy in each run folder, by its name, and the seed of the training.

    Raises:
      ConfigError: a folder is no training of either, or two have the same learner and seed.
    """
    told: dict[Path, tuple[str, int]] = {}
    for folder in folders:
        learner, seed = told_by(folder)
        if (learner, seed) in told.values():
            raise ConfigError(
                f"learned={folder}: another folder has a {learner} of train_seed={seed}; give one of them"
            )
        told[folder] = learner, seed
    return told


def told_by(folder: Path) -> tuple[str, int]:
    """Return the learner and the seed of the training in a folder; raise ConfigError if it is none."""
    if (elsewhere := trained_elsewhere(folder)) is not None:
        return elsewhere["learner"], elsewhere["train_seed"]
    config = load_config(folder)
    if isinstance(config, MetaControllerTrainConfig):
        return config.meta_controller_agent.name, config.train_seed
    if isinstance(config, TrainConfig) and config.task.name == KITTING.name:
        return f"{FLAT} {config.agent.name}", config.train_seed
    raise ConfigError(f"learned={folder} is no training of a top or of task=kitting; give folders of hrl-comfort train")


def trained_elsewhere(folder: Path) -> dict[str, Any] | None:
    """Return what TOLD in a folder says; None if it is not there."""
    if not (folder / TOLD).is_file():
        return None
    said: dict[str, Any] = json.loads((folder / TOLD).read_text(encoding="utf-8"))
    return said


def found(pattern: str) -> list[Path]:
    """Return the folders that match a pattern, in order; raise ConfigError if none does."""
    folders = sorted(map(Path, glob(pattern)))
    if not folders:
        raise ConfigError(f"learned={pattern} matches no folder; give run folders of hrl-comfort train")
    return folders


def read_rows(path: Path) -> DataFrame | None:
    """Return the rows of a file of this command; None if it is not there.

    Raises:
      ConfigError: the file is not of this command.
    """
    rows = read_table(path)
    if rows is not None and set(rows) != set(COLUMNS):
        raise ConfigError(f"{path} is there already, and has other columns; choose another file")
    return rows


def clustered(rows: DataFrame) -> DataFrame:
    """Return the rows of a learned top with the columns that say what they share."""
    return rows.rename(columns={"seed": "train_seed", "shift": "spawn_id"})


def main(words: Sequence[str]) -> None:
    """Measure, and write the CSV."""
    torch.set_num_threads(1)
    path, shifts = given(words, "FILE.csv SHIFTS [learned=PATTERN…] WORDS…", Path, int)
    asked = words[2:]
    patterns = [word.removeprefix("learned=") for word in asked if word.startswith("learned=")]
    learned = [folder for pattern in patterns for folder in found(pattern)]
    config = compose("evaluate", [*WORDS, *(word for word in asked if not word.startswith("learned="))])
    assert isinstance(config, EvaluateConfig)
    path.parent.mkdir(parents=True, exist_ok=True)
    for rows in measure(config, shifts, learned, read_rows(path)):
        filled = rows.astype(object).where(rows.notna(), None)
        write_table(path, COLUMNS, filled.itertuples(index=False, name=None))
    print(table(rows))


if __name__ == "__main__":
    as_command(main)
