"""The benchmark: what its entry says, and what it lets a policy change."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from hrl_comfort.benchmarks import suite
from hrl_comfort.cli.first_checks import completed
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.compose import compose, save_config

SHORT = ("split=validation", "episodes=2", "levels=[1,10]", "task.max_episode_steps=150")


def asked(*overrides: str) -> EvaluateConfig:
    config = compose("benchmark", completed("benchmark", list(overrides)))
    assert isinstance(config, EvaluateConfig)
    return config


def test_one_policy_stands_for_every_skill_and_a_folder_for_those_in_it(tmp_path: Path) -> None:
    assert asked("policy=expert").policies == dict.fromkeys(("pick", "place", "return"), "expert")
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.pt").touch()
    config = asked(str(tmp_path))
    assert config.policies == {name: os.path.join(tmp_path, name) for name in ("pick", "place", "return")}
    assert suite.name_of(config) == str(tmp_path)
    assert suite.name_of(asked("policy=random")) == "random"


def test_the_suite_is_on_the_test_split_and_says_what_was_changed() -> None:
    config = asked("policy=expert", "output=elsewhere")
    assert (config.split, config.safety.kind, config.task.max_episode_steps) == ("test", "ssm", 15_000)
    assert suite.changed(config) == {}
    other = asked("policy=expert", "split=validation", "human=still", "safety=none")
    assert {"split", "human.motion", "safety.kind"} <= set(suite.changed(other))
    assert suite.changed(replace(config, episodes=3)) == {"episodes": 3}


def test_another_task_than_the_suites_is_refused_before_it_runs(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"task=cycle: the benchmark's figures are of task=shift alone"):
        suite.benchmark(asked("policy=expert", "task=cycle", f"output='{tmp_path / 'entry'}'"))
    assert not (tmp_path / "entry").exists()


def test_a_policy_trained_with_other_steps_is_refused(tmp_path: Path) -> None:
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
        save_config(compose("train", [f"task={name}"]), tmp_path / name / "config.yaml")
        (tmp_path / name / "policy.pt").touch()
    with pytest.raises(ConfigError, match=r"task\.max_step_deg=1\.4, but policies\.pick=.* was trained with 2"):
        suite.benchmark(asked(str(tmp_path), f"output='{tmp_path / 'entry'}'"))
    assert not (tmp_path / "entry").exists()


def test_an_entry_has_its_levels_a_table_and_a_figure_with_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suite, "ENTRIES", tmp_path / "entries")
    first = suite.benchmark(asked("policy=random", *SHORT, f"output='{tmp_path / 'first'}'"))
    entry = json.loads(first.read_text(encoding="utf-8"))
    assert [(at["level"], at["shifts"]) for at in entry["levels"]] == [(1, 2), (10, 2)]
    assert entry["levels"][0]["discomfort_per_min"]["mean"] > entry["levels"][1]["discomfort_per_min"]["mean"]
    assert entry["changed"]["split"] == "validation" and entry["policies"]["pick"] == "random"
    (tmp_path / "entries").mkdir()
    first.rename(tmp_path / "entries" / "random.json")
    second = suite.benchmark(asked("policy=potential_field", *SHORT, f"output='{tmp_path / 'second'}'"))
    lines = second.with_suffix(".md").read_text(encoding="utf-8").splitlines()
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| random*"] * 2 + ["| potential_field*"] * 2
    assert second.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
