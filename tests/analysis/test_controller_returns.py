"""Returns of controllers and their differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import sem, t

from hrl_comfort.analysis.comparison import controllers, table
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, FigureConfig
from hrl_comfort.files.run_folder import Run
from hrl_comfort.files.tables import records_of
from hrl_comfort.plots.figure import figure

REWARD = {"place": 1.0, "step": -0.001, "progress": 0.0, "k1": 1.0}


def evaluation(returns: list[float], placed: int = 2, seed: str = "0", skills: str = "p", **reward: float) -> Run:
    episodes = [
        {
            "train_seed": seed, "episode": str(i), "spawn_id": str(i % 2), "success": "True",
            "return": str(earned), "steps": "200", "objects_placed": str(placed),
        }
        for i, earned in enumerate(returns)
    ]  # fmt: skip
    config = {"reward": {**REWARD, **reward}, "policies": {"pick": skills, "meta_controller": seed}}
    return Run("run", Path("run"), config=config, episodes=records_of(episodes, "episodes"))


def test_a_return_parts_into_objects_time_and_discomfort() -> None:
    found = controllers({"one": [evaluation([1.5, 1.7])]})["controllers"]["one"]
    means = {part: value["mean"] for part, value in found.items() if part != "episodes"}
    assert means == pytest.approx({"success": 1, "return": 1.6, "placed": 2, "time": 0.2, "discomfort": 0.2})


def test_differences_are_of_the_same_episodes() -> None:
    better, worse = [1.5, 1.7, 1.1, 1.9], [1.4, 1.6, 1.0, 1.8]
    groups = {"a": [evaluation(better), evaluation(better, seed="1")]}
    found = controllers({**groups, "b": [evaluation(worse), evaluation(worse, seed="1")]})["differences"]["a - b"]
    assert found["return"]["mean"] == pytest.approx(0.1)
    assert found["return"]["ci95"] is None, "all differ by the same, though the episodes differ by far more"
    with pytest.raises(ConfigError, match="must have run the same episodes"):
        controllers({**groups, "b": [evaluation(worse[:3]), evaluation(worse[:3], seed="1")]})


def test_several_trained_controllers_are_compared_with_one_that_has_the_same_skills() -> None:
    returns = {"p": ([2.0, 1.0], [2.2, 1.2]), "q": ([2.0, 1.0], [3.0, 1.0])}
    trained = [
        evaluation(own, seed=f"{k}", skills=skills) for skills, each in returns.items() for k, own in enumerate(each)
    ]
    others = [evaluation([1.0, 0.0], skills="q"), evaluation([0.0, 0.0], skills="p")]
    found = controllers({"trained": trained, "other": others})
    difference = found["differences"]["trained - other"]["return"]
    of_sets = np.array([(1.5 + 1.7) / 2, (1.0 + 1.5) / 2])
    assert difference["mean"] == pytest.approx(of_sets.mean())
    assert difference["ci95"] == pytest.approx(of_sets.mean() + np.array([-1, 1]) * t.ppf(0.975, 1) * sem(of_sets)), (
        "two controllers above the same skills are not independent"
    )
    assert found["controllers"]["other"]["episodes"] == 4
    for wrong, count in ((others[:1], 0), ([*others, others[0]], 2)):
        with pytest.raises(ConfigError, match=f"{count} evaluations of other have the skills of run; give one"):
            controllers({"trained": trained, "other": wrong})


def test_controllers_above_one_set_of_skills_are_told_apart_by_their_training_seed() -> None:
    trained = [evaluation([2.0 + seed], seed=f"{seed}") for seed in range(3)]
    found = controllers({"trained": trained, "other": [evaluation([1.0], seed="7")]})["differences"]["trained - other"]
    assert found["return"]["mean"] == pytest.approx(2.0)
    assert found["return"]["ci95"] == pytest.approx(2.0 + np.array([-1, 1]) * t.ppf(0.975, 2) / 3**0.5)
    with pytest.raises(ConfigError, match="run and run both have train_seed=0 and the same skills; give one of each"):
        controllers({"trained": [trained[0], trained[0]], "other": [evaluation([1.0])]})


def test_what_a_policy_observes_does_not_keep_evaluations_from_being_compared() -> None:
    one, other = evaluation([1.5]), evaluation([1.4])
    one.config["task"], other.config["task"] = ({"objects": 2, "observation": name} for name in ("default", "sight"))
    assert "a - b" in controllers({"a": [one], "b": [other]})["differences"]
    other.config["task"] = {"objects": 3, "observation": "default"}
    with pytest.raises(ConfigError, match="differ in task; compare like with like"):
        controllers({"a": [one], "b": [other]})


@pytest.mark.parametrize("name", ["train_seed", "spawn_id"])
def test_an_evaluation_that_lacks_a_column_is_refused_in_one_line(name: str) -> None:
    run = evaluation([1.0])
    assert run.episodes is not None
    with pytest.raises(ConfigError, match=f"no {name} in its episodes"):
        controllers({"one": [replace(run, episodes=run.episodes.drop(columns=name))]})
    with pytest.raises(ConfigError, match="no objects_placed in its episodes"):
        controllers({"one": [replace(run, episodes=run.episodes[:0])]})


@pytest.mark.parametrize(
    ("section", "values"),
    [
        ("safety", ({"kind": "none"}, {"kind": "ssm"})),
        ("randomise", ({"servo_lag_s": [0, 0]}, {"servo_lag_s": [0, 0.2]})),
    ],
)
def test_evaluations_with_other_shields_or_other_randomisation_are_not_compared(section: str, values: Any) -> None:
    one, other = evaluation([1.5]), evaluation([1.4])
    one.config[section], other.config[section] = values
    with pytest.raises(ConfigError, match=f"differ in {section}; compare like with like"):
        controllers({"a": [one], "b": [other]})


def test_a_return_of_other_parts_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"reward\.progress=3\.0; kind=controllers takes one level with reward=sort"):
        controllers({"one": [evaluation([1.0], progress=3.0)]})


def test_controllers_that_are_paid_otherwise_are_not_compared() -> None:
    with pytest.raises(ConfigError, match="differ in reward; compare like with like"):
        controllers({"a": [evaluation([1.5])], "b": [evaluation([1.5], step=-0.002)]})


def test_an_evaluation_of_several_levels_is_refused() -> None:
    run = evaluation([1.0])
    run.config["levels"] = [1, 4]
    with pytest.raises(ConfigError, match="several comfort levels; kind=controllers takes"):
        controllers({"one": [run]})


def test_the_table_has_a_line_a_controller_and_a_difference() -> None:
    text = table(controllers({"a": [evaluation([1.5, 1.7])], "b": [evaluation([1.4, 1.6])]}))
    assert [line.split(" | ")[0] for line in text.splitlines()] == ["| ", "| ---", "| a", "| b", "| a - b"]


def test_the_figure_of_controllers_is_drawn_from_evaluations(tmp_path: Path) -> None:
    words = ["task=sort", "task.objects=2", "comfort=sort", "reward=sort", "human=none", "episodes=2"]
    words += [
        "task.max_episode_steps=60",
        *(f"policies.{name}=random" for name in ("pick", "place", "return")),
    ]
    for name in ("nearest", "random"):
        assert main(["evaluate", *words, f"meta_controller={name}", f"output={tmp_path / name}"]) == 0
    evaluations = f"evaluations=[{tmp_path / 'nearest'},{tmp_path / 'random'}]"
    output = tmp_path / "returns.png"
    config = compose("figure", ["kind=controllers", evaluations, "labels=[nearest,random]", f"output={output}"])
    assert isinstance(config, FigureConfig)
    figure(config)
    assert output.is_file() and output.with_suffix(".json").is_file()
