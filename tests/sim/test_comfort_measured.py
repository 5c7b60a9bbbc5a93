"""Evaluations measure comfort: levels, failures, discomfort."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort.analysis.comfort import time_limit
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EvaluateConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_folder import read_run
from hrl_comfort.humans import load_evaluation_set


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def evaluated(output: Path, *overrides: str) -> list[dict[str, str]]:
    config = compose("evaluate", ["task=pick", "policy=random", "episodes=4", f"output='{output}'",
                                  "task.max_episode_steps=40", *overrides])  # fmt: skip
    assert isinstance(config, EvaluateConfig)
    return table(evaluate(config) / "episodes.csv")


def test_every_level_asked_for_gets_the_same_episodes_in_the_order_asked_for(tmp_path: Path) -> None:
    rows = evaluated(tmp_path, "levels=[10,1]", "record=true")
    assert [row["comfort_level"] for row in rows] == ["10"] * 4 + ["1"] * 4
    assert [row["comfort_level_mean"] for row in rows] == ["10.0"] * 4 + ["1.0"] * 4
    at = [
        [{k: v for k, v in row.items() if "level" not in k and "discomfort" not in k} for row in part]
        for part in (rows[:4], rows[4:])
    ]
    assert at[0] == at[1], "a policy that sees no level does the same at each"
    entries = load_evaluation_set().part(0, 4)
    assert [int(row["motion_id"]) for row in rows] == 2 * entries.motion_id.tolist()


def failures_counted(folder: Path) -> list[float]:
    """Return the mean of steps over all episodes of each group, in which none succeeds."""
    groups = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["groups"]
    assert all(group["metrics"]["success"]["mean"] == 0 for group in groups)
    return [group["metrics"]["steps_all"]["mean"] for group in groups]


def test_failures_count_at_the_time_limit_they_ran_under_and_a_figure_agrees(tmp_path: Path) -> None:
    evaluated(tmp_path, "comfort=off", "comfort.beta=1", "levels=[3,10]")
    limits = time_limit(read_run(tmp_path), np.array([3.0, 10.0]))
    assert failures_counted(tmp_path) == [134, 40] == limits.tolist()


def test_where_the_level_changes_a_failure_counts_at_the_limit_in_force_at_its_end(tmp_path: Path) -> None:
    rising = ("comfort.source=schedule", "comfort.schedule_s=[0,0.2]", "comfort.beta=1", "human=none")
    rows = evaluated(tmp_path / "down", *rising, "comfort.schedule_levels=[10,5]")
    assert {row["steps"] for row in rows if row["truncated"] == "True"} == {"80"}
    assert failures_counted(tmp_path / "down") == [80]
    # The limit at level 10 is over when that level comes: the episode ends a step later.
    rows = evaluated(tmp_path / "up", *rising, "comfort.schedule_s=[0,1]", "comfort.schedule_levels=[5,10]")
    assert {row["steps"] for row in rows} == {"51"}
    assert failures_counted(tmp_path / "up") == [51]


def test_comfort_is_measured_alike_whether_it_is_paid_or_not(tmp_path: Path) -> None:
    off = evaluated(tmp_path / "off")
    on = evaluated(tmp_path / "on", "comfort=conditioned", "comfort.source=fixed", "comfort.level=4")
    assert [row["comfort_level"] for row in off] == [""] * 4
    assert [row["comfort_level"] for row in on] == ["4"] * 4
    changed = {name for name in off[0] if any(a[name] != b[name] for a, b in zip(off, on, strict=True))}
    discomforts = {name for name in off[0] if "discomfort" in name}
    assert len(discomforts) == 3 and changed == {"comfort_level", "comfort_level_mean", "return"} | discomforts


def resting(observations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return actions (n, 6) of an arm that stays where it is."""
    return np.zeros((len(observations), 6))


def test_an_arm_that_rests_at_home_has_no_avoidable_discomfort(tmp_path: Path) -> None:
    words = ("human=mixture", "comfort=conditioned", "comfort.source=fixed", "comfort.level=1", "safety=ssm")
    words += ("robot.rating=collaborative",)
    for row in evaluated(tmp_path / "idle", "policy=tests.sim.test_comfort_measured:resting", *words):
        assert float(row["avoidable_discomfort_per_min"]) == pytest.approx(0.0, abs=1e-3)
        assert float(row["idle_discomfort_per_min"]) == pytest.approx(float(row["discomfort_per_min"]), abs=1e-3)
        assert float(row["excess_closeness_mean_m"]) == pytest.approx(0.0, abs=1e-3)
    for row in evaluated(tmp_path / "moving", *words):
        total, idle, avoidable = (float(row[f"{name}discomfort_per_min"]) for name in ("", "idle_", "avoidable_"))
        assert avoidable > 0 and total - idle - 1e-3 <= avoidable <= total


def test_the_mean_level_of_an_episode_is_over_its_control_steps(tmp_path: Path) -> None:
    rows = evaluated(tmp_path, "comfort.source=schedule", "comfort.schedule_s=[0,0.2]",
                     "comfort.schedule_levels=[10,1]", "human=none")  # fmt: skip
    for row in rows:
        steps = int(row["steps"])
        first = min(steps, 10)
        assert row["comfort_level"] == ""
        assert float(row["comfort_level_mean"]) == pytest.approx((10 * first + steps - first) / steps, abs=1e-6)
