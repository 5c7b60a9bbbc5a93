"""Benchmarks measure every contestant in every round; tables give medians and ratios. No time is asserted."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_comfort.__main__ import main
from hrl_comfort.compose import compose
from hrl_comfort.experiments import bench, bench_update
from hrl_comfort.experiments.statistics import read_rows


def test_every_loop_of_the_environment_is_measured_in_every_round(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench, "ROWS", (1, 4))
    monkeypatch.setattr(bench, "DECISIONS", 8)
    assert main(["bench", "env", f"output={tmp_path}"]) == 0
    rows = read_rows(tmp_path / "env.csv")
    loops = [(row["rows"], row["loop"]) for row in rows if row["round"] == "0"]
    assert [name for n, name in loops if n == "1"] == ["engine", "bare mujoco.rollout", "dm_control front"]
    assert [name for n, name in loops if n == "4"] == ["engine", "bare mujoco.rollout"]
    assert len(rows) == bench.REPEATS * len(loops) and all(float(row["decisions_per_s"]) > 0 for row in rows)


def test_ratios_are_the_medians_of_those_of_each_round() -> None:
    rates = {"engine": (8, 30, 10), "bare mujoco.rollout": (10, 10, 20)}
    rows = [
        {"rows": "4", "loop": name, "round": str(k), "decisions_per_s": str(rate)}
        for name, each in rates.items()
        for k, rate in enumerate(each)
    ]
    lines = bench.table(rows).splitlines()
    assert lines[2:] == [
        "| 4 | engine | 10 (8 to 30) | 0.80 (0.50 to 3.00) |",
        "| 4 | bare mujoco.rollout | 10 (10 to 20) |  |",
    ]


@pytest.mark.parametrize("name", ["hrl-comfort", "TorchRL SACLoss"])
def test_every_learner_learns(name: str) -> None:
    agent = compose("train", ["agent.hidden=[16,16]"]).agent
    update = bench_update.LEARNERS[name](agent, 9, 8)
    update()


def test_the_peer_from_stable_baselines_learns() -> None:
    pytest.importorskip("stable_baselines3", reason="in the extra bench")
    agent = compose("train", ["agent.hidden=[16,16]"]).agent
    bench_update.LEARNERS["Stable-Baselines3"](agent, 9, 8)()


def test_without_the_peer_one_line_says_what_to_install(monkeypatch, capsys) -> None:
    monkeypatch.setattr(bench_update, "find_spec", lambda _: None)
    assert main(["bench", "update"]) == 1
    assert "pip install 'hrl-comfort[bench]'" in capsys.readouterr().err
