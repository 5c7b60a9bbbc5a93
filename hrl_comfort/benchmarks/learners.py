"""Which learner of skills learns most in the same time of a core? Success after equal minutes, with a hand that holds.

`python -m hrl_comfort.benchmarks.learners FILE.csv MINUTES SEEDS WORDS…` measures it; the words are those of
`hrl-comfort train`. Trainings that are in the file already are not run again.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import torch
from pandas import DataFrame, Series

from hrl_comfort.analysis.intervals import SHARE, Clusters
from hrl_comfort.analysis.tables import cell, markdown
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.output import held_folder
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.training.collector import make_collector
from hrl_comfort.training.trainer import Training, train

WORDS = (
    "agent=demonstrated", "cell=grasp", "human=mixture", "safety=ssm", "robot.rating=collaborative",
    "randomise=objects", "curriculum=grasp", "task.observation=sight", "task.terminate_on=unsafe_contact",
    "task.object_jitter_m=0.07", "task.precision.grasp_tolerance_m=0.05", "task.precision.place_tolerance_m=0.05",
    "task.max_episode_steps=600", "task.max_step_deg=1", "engine.num_envs=64", "agent.learning_starts=1000",
    "agent.buffer_size=200000", "agent.target_entropy=-7", "agent.demonstrator=expert",
    "agent.demonstrator_envs=16", "agent.demonstrator_takeover=0.1",
)  # fmt: skip
"""The world and the demonstrations of the experiment `grasp`, on its table, in words of `train`."""
TASKS = ("pick", "place", "return")
LEARNERS = {"sac": (), "tqc": (), "crossq": (), "redq": ("agent.updates_per_policy_step=1",)}
"""Learners, and what sets one apart beside its name and the defaults of its own keys."""
EPISODES = ("split=validation", "episodes=200", "task.max_episode_steps=1000")
"""The evaluation of a skill, in words of `evaluate`."""
COLUMNS = ("minutes", "task", "learner", "seed", "policy_steps", "success")
PACE_STEPS, PACE_ROUNDS = 2560, 3
"""Policy steps in which the pace of a learner is measured, and how often: the learners take turns."""


def measure(path: Path, minutes: float, seeds: int, words: Sequence[str] = ()) -> DataFrame:
    """Write and return a row for each task, learner and seed: its policy steps in `minutes`, and its success.

    The policy steps are those of a task and learner at the pace measured before its first seed, so that schedules know
    their ends.

    Raises:
      ConfigError: the file is not of this command, or of other minutes.
    """
    done = read_table(path)
    if done is not None and (tuple(done) != COLUMNS or set(done["minutes"]) != {minutes}):
        raise ConfigError(f"{path} is there already, and not of this command with {minutes:g} minutes; choose another")
    rows = [] if done is None else done.to_dict("records")
    with held_folder(path.parent):
        for seed in range(seeds):
            for task in TASKS:
                there = {row["learner"]: row for row in rows if row["task"] == task}
                steps = {name: int(row["policy_steps"]) for name, row in there.items()}
                if new := [name for name in LEARNERS if name not in steps]:
                    found = paces({name: config_of(task, name, seed, words) for name in new})
                    steps |= {name: round(60 * minutes * pace) for name, pace in found.items()}
                for name in LEARNERS:
                    if any(row["seed"] == seed for row in rows if (row["task"], row["learner"]) == (task, name)):
                        continue
                    share = success_of(config_of(task, name, seed, [*words, f"agent.policy_steps={steps[name]}"]))
                    rows.append(dict(zip(COLUMNS, (minutes, task, name, seed, steps[name], share), strict=True)))
                    write_table(path, COLUMNS, (row.values() for row in rows))
    return DataFrame(rows, columns=list(COLUMNS))


def config_of(task: str, learner: str, seed: int, words: Sequence[str]) -> TrainConfig:
    """Return the training of a learner in a task."""
    own = (f"task={task}", f"agent.name={learner}", *LEARNERS[learner], f"train_seed={seed}", f"episode_seed={seed}")
    config = compose("train", [*WORDS, *own, "output=unused", *words])
    assert isinstance(config, TrainConfig)
    return config


def paces(configs: dict[str, TrainConfig], clock: Callable[[], float] = time.process_time) -> dict[str, float]:
    """Return the policy steps a second of a core of trainings, once they learn: the medians of rounds in turn."""
    seconds: dict[str, list[float]] = {name: [] for name in configs}
    with ExitStack() as stack:
        trainings = {}
        for name, config in configs.items():
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            trainings[name] = Training(config, make_collector, Path(folder))
            stack.callback(trainings[name].collector.close)
        for turn in range(-1, PACE_ROUNDS):  # the first begins to learn, and does not count
            for name, training in trainings.items():
                began = clock()
                _step(training, PACE_STEPS if turn >= 0 else training.config.agent.learning_starts + PACE_STEPS)
                if turn >= 0:
                    seconds[name].append(clock() - began)
    return {name: PACE_STEPS / float(Series(each).median()) for name, each in seconds.items()}


def _step(training: Training, policy_steps: int) -> None:
    end = training.steps + policy_steps
    while training.steps < end:
        training.step()


def success_of(config: TrainConfig) -> float:
    """Return the success share of a training's policy in EPISODES."""
    with tempfile.TemporaryDirectory() as folder:
        run = train(replace(config, output=str(Path(folder) / "run")))
        asked = compose("evaluate", [f"policy={run}", *EPISODES, f"output={folder}/unused"])
        assert isinstance(asked, EvaluateConfig)
        return float(rollout(asked).table["success"].mean())


def table(rows: DataFrame) -> str:
    """Return the success of each learner in each task as Markdown, with intervals over seeds."""
    lines = []
    for (minutes, name), mine in rows.groupby(["minutes", "learner"], sort=False):
        of = {task: mine[mine["task"] == task] for task in rows["task"].unique()}
        shares = (
            cell(Clusters.of_runs(len(each)).estimate(each["success"].to_numpy(float), bounds=SHARE), 100)
            for each in of.values()
        )
        steps = " / ".join(f"{each['policy_steps'].iloc[0]:,}" for each in of.values())
        lines.append([f"`{name}`", f"{minutes:g}", steps, str(mine["seed"].nunique()), *shares])
    heads = [f"{task}: success, %" for task in rows["task"].unique()]
    return markdown(["learner", "minutes", "policy steps", "seeds", *heads], lines)


def main(words: Sequence[str]) -> None:
    """Measure, and print the table."""
    torch.set_num_threads(1)
    path, minutes, seeds, *asked = words
    print(table(measure(Path(path), float(minutes), int(seeds), asked)))


if __name__ == "__main__":
    main(sys.argv[1:])
