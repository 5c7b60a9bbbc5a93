"""The race of the learners of skills: equal minutes, every seed once, and a table that says what the rows say."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from hrl_comfort.agents.sac import TrainingDiverged
from hrl_comfort.benchmarks import learners
from hrl_comfort.benchmarks.learners import Pace
from hrl_comfort.benchmarks.measure import as_command
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, HierarchyTrainConfig, TrainConfig
from hrl_comfort.training.trainer import Training

SMALL = (
    *learners.WORDS, "agent.hidden=[8,8]", "agent.batch_size=8", "agent.buffer_size=2000",
    "agent.learning_starts=16", "engine.num_envs=4", "agent.demonstrator=null", "agent.demonstrator_envs=0",
    "agent.demonstrator_takeover=1",
)  # fmt: skip


def test_each_trains_for_the_steps_of_its_own_pace_and_no_seed_twice(tmp_path: Path, monkeypatch) -> None:
    runs: list[tuple[str, str, int, int]] = []

    def trained(config: TrainConfig) -> tuple[float, float]:
        agent = config.agent
        runs.append((config.task.name, agent.name, config.train_seed, agent.policy_steps))
        return 4.0, 0.5 + config.train_seed / 10

    monkeypatch.setattr(learners, "trained", trained)
    monkeypatch.setattr(learners, "paces", lambda of: {name: Pace(20.0, 100, 10.0 * len(name)) for name in of})
    path = tmp_path / "learners.csv"
    first = learners.measure(path, 2, 1)
    assert len(first) == len(runs) == len(learners.TASKS) * len(learners.LEARNERS)
    assert ("pick", "redq", 0, 100 + 100 * 40) in runs and ("place", "sac", 0, 100 + 100 * 30) in runs
    monkeypatch.setattr(learners, "paces", lambda of: pytest.fail("measured again"))
    rows = learners.measure(path, 2, 2)
    assert len(rows) == len(runs) == 2 * len(first) and {seed for *_, seed, _ in runs[len(first) :]} == {1}
    assert ("pick", "redq", 1, 4100) in runs, "as many as the first, though it took twice the time"
    lines = learners.table(pd.read_csv(path)).splitlines()
    assert lines[2].startswith("| `sac` | 2 | 4.00 / 4.00 / 4.00 | 3,100 / 3,100 / 3,100 | 55.0 [")
    with pytest.raises(ConfigError, match=r"not of 3 minutes; choose another file$"):
        learners.measure(path, 3, 2)
    with pytest.raises(ConfigError, match=r"^0 minutes and 2 seeds: both must be above 0$"):
        learners.measure(path, 0, 2)


def test_a_learner_that_does_not_begin_in_the_minutes_is_named(monkeypatch) -> None:
    monkeypatch.setattr(learners, "paces", lambda of: dict.fromkeys(of, Pace(120.0, 1640, 1.0)))
    with pytest.raises(ConfigError, match=r"^2 minutes: sac begins to learn pick after 2\.00; give more$"):
        learners.steps_of("pick", 2, [])


def test_all_learn_from_the_demonstrations_of_the_experiment_without_people_and_redq_with_its_many_updates() -> None:
    made = {name: learners.config_of("pick", name, 3, 500) for name in learners.LEARNERS}
    like = compose("train_hierarchy", ["experiment=grasp", "cell=grasp", "output=unused"])
    assert isinstance(like, HierarchyTrainConfig)
    updates = {"sac": 0.25, "tqc": 0.25, "crossq": 0.25, "redq": 1}
    for name, config in made.items():
        own = {"name": name, "own": config.agent.own, "policy_steps": 500, "log_every": config.agent.log_every}
        assert config.agent == replace(like.agent, **own, updates_per_policy_step=updates[name])
        assert (config.human.motion, config.safety.kind) == ("none", "none") and config.reward == like.reward
        assert (config.train_seed, config.episode_seed) == (3, 3)


def test_a_training_that_diverges_has_no_success(monkeypatch, capsys) -> None:
    def diverges(config: TrainConfig) -> Path:
        raise TrainingDiverged("training diverged at update 7: critic_loss is nan")

    monkeypatch.setattr(learners, "train", diverges)
    minutes, share = learners.trained(learners.config_of("pick", "tqc", 3, 500))
    assert math.isnan(minutes) and share == 0.0
    assert "pick, tqc, train_seed=3: training diverged at update 7" in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["table.csv", "two", "1"], ["table.csv", "2"]])
def test_a_mistaken_command_ends_with_what_to_give(words: list[str], monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["learners", *words])
    said = " ".join(words) or "nothing"
    with pytest.raises(SystemExit, match=rf"^hrl-comfort: {said} is given; give FILE\.csv MINUTES SEEDS$"):
        as_command(learners.main)


def test_a_pace_is_taken_while_a_learner_learns(monkeypatch) -> None:
    monkeypatch.setattr(learners, "PACE_STEPS", 16)
    monkeypatch.setattr(learners, "WORDS", SMALL)
    updates: list[int] = []
    learn = Training.learn

    def counted(training: Training) -> None:
        learn(training)
        updates.append(training.updates)

    monkeypatch.setattr(Training, "learn", counted)
    now = iter(range(100))
    found = learners.paces(
        {name: learners.config_of("pick", name, 0) for name in ("sac", "redq")}, lambda: float(next(now))
    )
    assert found == {"sac": (1.0, 32, 16.0), "redq": (1.0, 32, 16.0)} and max(updates) > 16


def test_a_policy_is_evaluated_on_validation_after_the_minutes_that_it_took(monkeypatch) -> None:
    assert "split=validation" in learners.EPISODES
    monkeypatch.setattr(learners, "EPISODES", ("split=validation", "episodes=2", "task.max_episode_steps=20"))
    monkeypatch.setattr(learners, "WORDS", SMALL)
    minutes, share = learners.trained(learners.config_of("pick", "sac", 0, 32))
    assert 0 < minutes < 10 and share in (0.0, 0.5, 1.0)
