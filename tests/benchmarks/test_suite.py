"""The benchmark: what its entry says, and what it lets a policy change."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hrl_comfort.benchmarks import entries, suite
from hrl_comfort.cli.first_checks import completed
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.files.run_config import save_config

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
    assert suite.changed(asked("policy=expert", "task.observation=sight")) == {}
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
    with pytest.raises(ConfigError, match=r"policies\.pick=.*policy\.pt' was trained with 2"):
        suite.check_steps(asked("policy=expert"), "pick", str(tmp_path / "pick" / "policy.pt"))
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
    (tmp_path / "entries" / "random").mkdir(parents=True)
    first.rename(tmp_path / "entries" / "random" / entries.FILE)
    second = suite.benchmark(asked("policy=potential_field", *SHORT, f"output='{tmp_path / 'second'}'"))
    lines = second.with_suffix(".md").read_text(encoding="utf-8").splitlines()
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| random*"] * 2 + ["| potential_field*"] * 2
    assert second.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def write_seeds(folder: Path, rates: list[list[float]], mood: float = 0.0, changed: str = "") -> Path:
    """Write entries, one a training seed, of the objects a minute at each level; a person's level falls with them."""
    folder.mkdir(parents=True)
    for seed, each in enumerate(rates):
        levels = [
            {
                "level": 1 + 9 * number if len(each) > 1 else None,
                "shifts": 16,
                **{name: {"mean": count, "ci95": None} for name in (*entries.ANSWERS, *entries.HEADLINE)},
                "person_level_mean": {"mean": 10 - count / 2 + mood, "ci95": None},
            }
            for number, count in enumerate(each)
        ]
        entry = {
            "policy": str(seed),
            "policies": {"pick": f"run@{seed}"},
            "changed": {"human.motion": changed} if changed else {},
            "levels": levels,
        }
        (folder / str(seed)).mkdir()
        (folder / str(seed) / entries.FILE).write_text(json.dumps(entry), encoding="utf-8")
    return folder


def cells_of(table: str) -> list[list[str]]:
    return [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]


def test_a_folder_of_seeds_is_one_entry_with_intervals_over_seeds(tmp_path: Path) -> None:
    write_seeds(tmp_path / "ours", [[4.0, 10.0], [5.0, 12.0], [6.0, 14.0]])
    shutil.copytree(tmp_path / "ours" / "0", tmp_path / "alone")
    alone, ours = entries.committed(tmp_path).values()
    assert (alone["policy"], ours["policy"]) == ("alone", "ours, 3 seeds")
    low, high = ours["levels"]
    # Student's t with two degrees of freedom: 4.303 standard errors of 1 / sqrt(3).
    assert low["objects_per_min"] == {"mean": 5.0, "ci95": pytest.approx([5 - 2.484, 5 + 2.484], abs=1e-3)}
    assert (low["shifts"], high["level"], high["objects_per_min"]["mean"]) == (48, 10, 12.0)
    assert cells_of(entries.table([ours]))[1][:4] == ["ours, 3 seeds", "10", "48", "12.00 [7.03, 16.97]"]


def test_entries_of_a_folder_that_differ_in_the_suite_are_refused(tmp_path: Path) -> None:
    write_seeds(tmp_path / "ours", [[4.0, 10.0]], changed="still")
    write_seeds(tmp_path / "other", [[4.0, 10.0], [5.0, 12.0]])
    (tmp_path / "ours" / "0").rename(tmp_path / "other" / "2")
    with pytest.raises(ConfigError, match="must be of the same levels and the same suite"):
        entries.pooled(tmp_path / "other")


def test_an_interval_of_a_rate_is_not_below_zero(tmp_path: Path) -> None:
    write_seeds(tmp_path / "ours", [[0.0], [0.0], [6.0]])
    assert entries.pooled(tmp_path / "ours")["levels"][0]["objects_per_min"]["ci95"][0] == 0.0


def test_entries_are_compared_level_by_level_and_seed_by_seed(tmp_path: Path) -> None:
    ours = write_seeds(tmp_path / "ours", [[4.0, 10.0], [5.0, 12.5]])
    other = write_seeds(tmp_path / "other", [[3.0, 12.0], [4.0, 14.5], [99.0, 99.0]])
    first, last = cells_of(entries.differences(ours, other, ["objects_per_min"]))
    assert first[-1] == "1.00" and last[-1] == "-2.00"


def test_levels_are_compared_with_each_other_and_with_comfort_off_seed_by_seed(tmp_path: Path) -> None:
    ours = write_seeds(tmp_path / "ours", [[4.0, 10.0], [5.0, 12.5]])
    off = write_seeds(tmp_path / "off", [[8.0, 4.0], [10.0, 5.0], [99.0, 99.0]])
    *_, row = cells_of(entries.responses(ours, off))
    assert row == ["objects a minute", "4.50 [-1.85, 10.85]", "9.00 [-3.71, 21.71]", "-50.0",
                     "11.25 [-4.63, 27.13]", "4.50 [-1.85, 10.85]", "150.0", "150.0"]  # fmt: skip


def test_a_person_beside_a_robot_that_is_told_is_compared_at_the_same_throughput(tmp_path: Path) -> None:
    fixed = write_seeds(tmp_path / "fixed", [[4.0, 10.0], [5.0, 12.0]])
    told = write_seeds(tmp_path / "told", [[7.0], [9.0]], mood=0.25, changed="frightened")
    assert cells_of(entries.at_same_throughput(told, fixed))[0] == ["8.00 [-4.71, 20.71]", "6.25 [-0.10, 12.60]",
                                                                    "6.00 [-0.35, 12.35]", "0.25"]  # fmt: skip
    assert [line[:2] for line in cells_of(entries.table([*entries.committed(tmp_path).values()]))][-1] == [
        "told, 2 seeds*",
        "–",
    ]
    with pytest.raises(ConfigError, match=r"no mix of the levels in .*fixed gives 14 objects a minute"):
        entries.at_same_throughput(write_seeds(tmp_path / "fast", [[14.0]], changed="frightened"), fixed)


def test_the_best_mix_passes_over_a_level_that_two_others_beat() -> None:
    points = [(0.0, 10.0), (5.0, 4.0), (10.0, 6.0)]
    assert entries.best_mix(points, 5.0) == entries.best_mix(points[::2], 5.0) == 8.0
    assert entries.best_mix(points, 10.0) == 6.0 and entries.best_mix(points, 10.1) is None


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda entry: entry.pop("levels"), "levels"),
        (lambda entry: entry.update(levels=[]), "levels"),
        (lambda entry: entry["levels"][0].pop("discomfort_per_min"), "discomfort_per_min"),
        (lambda entry: entry["levels"][0]["objects_per_min"].update(mean=None), "mean"),
    ],
)
def test_a_damaged_entry_is_named_in_one_line_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: Callable[[dict[str, Any]], Any], reason: str
) -> None:
    file = write_seeds(tmp_path / "ours", [[4.0, 10.0]]) / "0" / entries.FILE
    entry = json.loads(file.read_text(encoding="utf-8"))
    damage(entry)
    file.write_text(json.dumps(entry), encoding="utf-8")
    monkeypatch.setattr(suite, "ENTRIES", tmp_path)
    with pytest.raises(ConfigError, match=rf"ours/0/benchmark\.json is damaged: .*{reason}"):
        suite.benchmark(asked("policy=random", *SHORT, f"output='{tmp_path / 'mine'}'"))
    assert not (tmp_path / "mine").exists()


def test_a_folder_without_an_entry_is_left_out_and_two_copies_of_a_seed_are_refused(tmp_path: Path) -> None:
    (tmp_path / "begun" / "0").mkdir(parents=True)
    assert entries.committed(tmp_path) == {}
    with pytest.raises(ConfigError, match="begun holds no entry"):
        entries.pooled(tmp_path / "begun")
    ours = write_seeds(tmp_path / "ours", [[4.0, 10.0]])
    shutil.copytree(ours / "0", ours / "1")
    with pytest.raises(ConfigError, match="two of its entries are of the same policies"):
        entries.pooled(ours)
    (write_seeds(tmp_path / "seven", [[1.0]]) / "0").rename(tmp_path / "seven" / "7")
    with pytest.raises(ConfigError, match="have no training seed in common"):
        entries.pairs(ours, tmp_path / "seven")


def test_a_benchmark_without_levels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"comfort\.source=none: the benchmark's discomfort is that of a level"):
        suite.benchmark(asked("policy=random", "comfort=off", "levels=[]", f"output='{tmp_path / 'entry'}'"))
