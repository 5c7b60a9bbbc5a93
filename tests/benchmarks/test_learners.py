"""The race of the learners of skills: equal minutes, every seed once, and a table that says what the rows say."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from hrl_comfort.benchmarks import learners
from hrl_comfort.config import ConfigError, TrainConfig

SMALL = (
    "human=none", "safety=none", "agent.hidden=[8,8]", "agent.batch_size=8", "agent.buffer_size=2000",
    "agent.learning_starts=16", "engine.num_envs=4", "agent.demonstrator=null", "agent.demonstrator_envs=0",
    "agent.demonstrator_takeover=1", "robot.rating=full", "task.terminate_on=contact",
)  # fmt: skip


def test_each_trains_for_the_steps_of_its_own_pace_and_no_seed_twice(tmp_path: Path, monkeypatch) -> None:
    trained: list[tuple[str, str, int, int]] = []

    def success_of(config: TrainConfig) -> float:
        agent = config.agent
        trained.append((config.task.name, agent.name, config.train_seed, agent.policy_steps))
        return 0.5 + config.train_seed / 10

    monkeypatch.setattr(learners, "success_of", success_of)
    monkeypatch.setattr(learners, "paces", lambda of: {name: 10.0 * len(name) for name in of})
    path = tmp_path / "learners.csv"
    first = learners.measure(path, 2, 1)
    assert len(first) == len(trained) == len(learners.TASKS) * len(learners.LEARNERS)
    assert ("pick", "redq", 0, 4800) in trained and ("place", "sac", 0, 3600) in trained
    monkeypatch.setattr(learners, "paces", lambda of: pytest.fail("measured again"))
    rows = learners.measure(path, 2, 2)
    assert len(rows) == len(trained) == 2 * len(first) and {seed for *_, seed, _ in trained[len(first) :]} == {1}
    assert rows.groupby(["task", "learner"])["policy_steps"].nunique().eq(1).all()
    lines = learners.table(pd.read_csv(path)).splitlines()
    assert lines[2].startswith("| `sac` | 2 | 3,600 / 3,600 / 3,600 | 2 | 55.0 [")
    with pytest.raises(ConfigError, match=r"not of this command with 3 minutes; choose another$"):
        learners.measure(path, 3, 2)


def test_all_have_the_demonstrations_of_the_experiment_and_redq_its_many_updates() -> None:
    made = {name: learners.config_of("pick", name, 3, ()) for name in learners.LEARNERS}
    assert {config.agent.demonstrator for config in made.values()} == {"expert"}
    assert {(config.train_seed, config.episode_seed) for config in made.values()} == {(3, 3)}
    updates = {name: config.agent.updates_per_policy_step for name, config in made.items()}
    assert updates == {"sac": 0.25, "tqc": 0.25, "crossq": 0.25, "redq": 1}


def test_a_pace_is_taken_while_a_learner_learns_and_a_policy_is_evaluated_on_validation(monkeypatch) -> None:
    monkeypatch.setattr(learners, "PACE_STEPS", 8)
    monkeypatch.setattr(learners, "EPISODES", ("split=validation", "episodes=2", "task.max_episode_steps=20"))
    configs = {name: learners.config_of("pick", name, 0, SMALL) for name in ("sac", "redq")}
    now = iter(range(100))
    assert learners.paces(configs, clock=lambda: float(next(now))) == {"sac": 8.0, "redq": 8.0}
    assert 0 <= learners.success_of(learners.config_of("pick", "sac", 0, (*SMALL, "agent.policy_steps=32"))) <= 1
