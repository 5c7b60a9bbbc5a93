"""Success of the learners of skills after equal minutes of a core, with a hand that holds.

`python -m hrl_comfort.benchmarks.learners FILE.csv MINUTES SEEDS` measures it. Trainings that are in the file are not
run again.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Hashable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import torch
from pandas import DataFrame, Series

from hrl_comfort.agents.sac import TrainingDiverged
from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.benchmarks.measure import as_command, given
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.output import held_folder
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.training.collector import make_collector
from hrl_comfort.training.trainer import Training, train

WORDS = (
    "agent=demonstrated", "cell=grasp", "human=none", "randomise=objects", "curriculum=grasp",
    "task.observation=sight", "task.object_jitter_m=0.07", "task.precision.grasp_tolerance_m=0.05",
    "task.precision.place_tolerance_m=0.05", "task.max_episode_steps=600", "task.max_step_deg=1",
    "engine.num_envs=64", "agent.learning_starts=1000", "agent.buffer_size=200000", "agent.target_entropy=-7",
    "agent.demonstrator=expert", "agent.demonstrator_envs=16", "agent.demonstrator_takeover=0.1",
)  # fmt: skip
"""The demonstrations of the experiment `grasp`, on its table without people, in words of `train`."""
TASKS = ("pick", "place", "return")
LEARNERS = {"sac": [], "tqc": [], "crossq": [], "redq": ["agent.updates_per_policy_step=1"]}
"""Learners, and what sets one apart beside its name and the defaults of its own keys."""
EPISODES = ("split=validation", "episodes=200", "task.max_episode_steps=1000")
"""The evaluation of a skill, in words of `evaluate`."""
COLUMNS = ("asked_min", "task", "learner", "seed", "policy_steps", "minutes", "success")
"""`minutes` are those that a training took of a core: near to those asked for, if not the same. They are NaN, and
`success` is 0, if it diverged."""
SPENT = {"minutes": 2, "policy_steps": 0}
"""Columns that tell the cost of a training, and the digits that the table gives."""
PACE_STEPS, PACE_ROUNDS = 640, 3
"""Policy steps in which the pace of a learner is measured, and how often: the learners take turns."""


def measure(path: Path, minutes: float, seeds: int) -> DataFrame:
    """Write and return a row for each task, learner and seed.

    Schedules need their ends before they begin, so a training has a number of policy steps, the same for every seed:
    what `minutes` are worth at a pace that is measured before the first one.

    Raises:
      ConfigError: the file is not of this command, or of other minutes, or there is nothing to measure, or a learner
        does not begin to learn in `minutes`.
    """
    if not (minutes > 0 and seeds > 0):
        raise ConfigError(f"{minutes:g} minutes and {seeds} seeds: both must be above 0")
    rows: list[dict[Hashable, Any]] = []
    with held_folder(path.parent):
        if (done := read_table(path)) is not None:
            if tuple(done) != COLUMNS or set(done["asked_min"]) != {minutes}:
                raise ConfigError(f"{path} is there already, and not of {minutes:g} minutes; choose another file")
            rows = done.to_dict("records")
        for seed, task in product(range(seeds), TASKS):
            steps = steps_of(task, minutes, [row for row in rows if row["task"] == task])
            ready = {row["learner"] for row in rows if (row["task"], row["seed"]) == (task, seed)}
            for name in [name for name in LEARNERS if name not in ready]:
                took, share = trained(config_of(task, name, seed, steps[name]))
                rows.append(dict(zip(COLUMNS, (minutes, task, name, seed, steps[name], took, share), strict=True)))
                write_table(path, COLUMNS, (row.values() for row in rows))
    return DataFrame(rows, columns=list(COLUMNS))


def steps_of(task: str, minutes: float, rows: list[dict[Hashable, Any]]) -> dict[str, int]:
    """Return the policy steps of each learner in `minutes` of a core: those of its `rows`, or else by `paces`.

    Raises:
      ConfigError: a learner does not begin to learn in `minutes`.
    """
    steps = {str(row["learner"]): int(row["policy_steps"]) for row in rows}
    new = {name: config_of(task, name, 0) for name in LEARNERS if name not in steps}
    for name, pace in (paces(new) if new else {}).items():
        learns_s = 60 * minutes - pace.begins_s
        if learns_s <= 0:
            raise ConfigError(
                f"{minutes:g} minutes: {name} begins to learn {task} after {pace.begins_s / 60:.2f}; give more"
            )
        steps[name] = round(pace.begins_steps + learns_s * pace.steps_per_s)
    return steps


class Pace(NamedTuple):
    """Speed of a training on a core."""

    begins_s: float
    """s until it has learned from PACE_STEPS steps."""
    begins_steps: int
    """Policy steps until then."""
    steps_per_s: float
    """Policy steps a second from then on."""


def config_of(task: str, learner: str, seed: int, policy_steps: int | None = None) -> TrainConfig:
    """Return the training of a learner in a task."""
    own = [f"task={task}", f"agent.name={learner}", *LEARNERS[learner], f"train_seed={seed}", f"episode_seed={seed}"]
    steps = [] if policy_steps is None else [f"agent.policy_steps={policy_steps}"]
    config = compose("train", [*WORDS, *own, *steps, "output=unused"])
    assert isinstance(config, TrainConfig)
    return config


def paces(configs: dict[str, TrainConfig], clock: Callable[[], float] = time.process_time) -> dict[str, Pace]:
    """Return the paces of trainings; that of learning is the median of rounds, in which they take turns."""
    begins: dict[str, tuple[float, int]] = {}
    seconds: dict[str, list[float]] = {name: [] for name in configs}
    with ExitStack() as stack:
        trainings = {}
        for name, config in configs.items():
            began = clock()
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            trainings[name] = Training(config, make_collector, Path(folder))
            stack.callback(trainings[name].collector.close)
            steps = _step(trainings[name], config.agent.learning_starts + PACE_STEPS)
            begins[name] = clock() - began, steps
        for name, training in [*trainings.items()] * PACE_ROUNDS:
            began = clock()
            steps = _step(training, PACE_STEPS)
            seconds[name].append((clock() - began) / steps)
    return {name: Pace(*begins[name], 1 / float(Series(each).median())) for name, each in seconds.items()}


def _step(training: Training, policy_steps: int) -> int:
    """Make so many policy steps or just more, and return their number."""
    began = training.steps
    while training.steps < began + policy_steps:
        training.step()
    return training.steps - began


def trained(config: TrainConfig) -> tuple[float, float]:
    """Return the minutes of a core that a training takes, and the success share of its policy in EPISODES.

    The share of one that diverges is 0, and its minutes are NaN.
    """
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        try:
            run = train(replace(config, output=str(Path(folder) / "run")))
        except TrainingDiverged as error:
            print(f"{config.task.name}, {config.agent.name}, train_seed={config.train_seed}: {error}")
            return math.nan, 0.0
        minutes = (time.process_time() - began) / 60
        asked = compose("evaluate", [f"policy={run}", *EPISODES, f"output={folder}/unused"])
        assert isinstance(asked, EvaluateConfig)
        return round(minutes, 3), float(rollout(asked).table["success"].mean())


def table(rows: DataFrame) -> str:
    """Return the success of each learner in each task as Markdown, with intervals over seeds."""
    tasks, lines = rows["task"].unique(), []
    for name, mine in rows.groupby("learner", sort=False):
        of = [mine[mine["task"] == task] for task in tasks]
        shares = (Clusters.of_runs(len(each)).estimate(each["success"].to_numpy(float), bounds=SHARE) for each in of)
        spent = (" / ".join(f"{each[key].mean():,.{digits}f}" for each in of) for key, digits in SPENT.items())
        lines.append([f"`{name}`", str(mine["seed"].nunique()), *spent, *(cell(share, 100) for share in shares)])
    spent_on = " / ".join(tasks)
    heads = [
        f"minutes of a core ({spent_on})",
        f"policy steps ({spent_on})",
        *(f"{task}: success, %" for task in tasks),
    ]
    return markdown(["learner", "seeds", *heads], lines)


def main(words: Sequence[str]) -> None:
    """Measure, and print the table."""
    torch.set_num_threads(1)
    path, minutes, seeds = given(words, "FILE.csv MINUTES SEEDS", Path, float, int)
    print(table(measure(path, minutes, seeds)))


if __name__ == "__main__":
    as_command(main)
