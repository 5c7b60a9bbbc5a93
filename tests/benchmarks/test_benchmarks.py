"""Benchmarks measure every contestant in every round; tables give medians and ratios. No time is asserted."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter, sleep

import pytest
from pandas import DataFrame

from hrl_comfort.__main__ import main
from hrl_comfort.benchmarks import env as bench
from hrl_comfort.benchmarks import train as bench_train
from hrl_comfort.benchmarks import update as bench_update
from hrl_comfort.config import TrainConfig
from hrl_comfort.config.compose import compose, environment
from hrl_comfort.files.tables import read_table


def test_every_loop_of_the_environment_is_measured_in_every_round(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench, "ROWS", (1, 4))
    monkeypatch.setattr(bench, "DECISIONS", 8)
    assert main(["bench", "env", f"output={tmp_path}"]) == 0
    rows = read_table(tmp_path / "env.csv")
    loops = rows[rows["round"] == 0]
    assert list(loops["loop"][loops["rows"] == 1]) == ["engine", "bare mujoco.rollout", "dm_control front"]
    assert list(loops["loop"][loops["rows"] == 4]) == ["engine", "bare mujoco.rollout"]
    assert len(rows) == bench.REPEATS * len(loops) and (rows["policy_steps_per_s"] > 0).all()


def test_ratios_are_the_medians_of_those_of_each_round() -> None:
    rates = {"engine": (8, 30, 10), "bare mujoco.rollout": (10, 10, 20)}
    rows = [
        {"rows": 4, "loop": name, "round": k, "policy_steps_per_s": rate}
        for name, each in rates.items()
        for k, rate in enumerate(each)
    ]
    lines = bench.table(DataFrame(rows)).splitlines()
    assert lines[2:] == [
        "| 4 | engine | 10 (8 to 30) | 0.80 (0.50 to 3.00) |",
        "| 4 | bare mujoco.rollout | 10 (10 to 20) |  |",
    ]


@pytest.mark.parametrize("name", [name for name in bench_update.LEARNERS if "Stable" not in name])
def test_every_learner_learns(name: str) -> None:
    agent = compose("train", ["agent.hidden=[16,16]"]).agent
    make, precision = bench_update.LEARNERS[name]
    bench_update.at(precision or "medium", make(agent, 9, 8))()


def test_the_peer_from_stable_baselines_learns() -> None:
    pytest.importorskip("stable_baselines3", reason="in the extra bench")
    agent = compose("train", ["agent.hidden=[16,16]"]).agent
    bench_update.LEARNERS["Stable-Baselines3"][0](agent, 9, 8)()


def test_without_the_peer_one_line_says_what_to_install(monkeypatch, capsys) -> None:
    monkeypatch.setattr(bench_update, "find_spec", lambda _: None)
    assert main(["bench", "update"]) == 1
    assert "pip install 'hrl-comfort[bench]'" in capsys.readouterr().err


def race_config(folder: Path) -> TrainConfig:
    """Return a training whose first update comes at once; nobody wins or loses by it."""
    overrides = ["task=reach", "curriculum=off", "agent.learning_starts=20", "agent.batch_size=16"]
    return compose("train", [*overrides, "agent.hidden=[16,16]", "engine.num_envs=4", f"output={folder}"])


def test_a_race_ends_at_success_or_at_the_limit_and_checks_are_not_timed(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench_train, "LIMIT", 120)
    monkeypatch.setattr(bench_train, "CHECK_GROWTH", 2)  # checks are due past 40 decisions, then past 88
    checks = iter([False, True])
    clock = bench_train.Clock(lambda act: next(checks), warmup=20)
    assert bench_train.race(race_config(tmp_path), clock) == 92 and clock.reached
    late = bench_train.Clock(lambda act: False, warmup=20)
    assert bench_train.race(race_config(tmp_path), late) == 120 and not late.reached

    made: list[None] = []
    slow = bench_train.Clock(lambda act: made.append(sleep(0.2)) is not None, warmup=20)
    began = perf_counter()
    bench_train.race(race_config(tmp_path), slow)
    assert len(made) == 2 and slow.seconds < perf_counter() - began - 0.4


def test_the_peer_races_on_the_same_cells(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("stable_baselines3", reason="in the extra bench")
    monkeypatch.setattr(bench_train, "LIMIT", 60)
    monkeypatch.setattr(bench_train, "CHECK_GROWTH", 2)
    monkeypatch.setattr(bench_train, "CHECK_EPISODES", 2)
    config = race_config(tmp_path)
    env = environment(config)
    shares: list[float] = []

    def check(act: bench_train.Act) -> bool:
        shares.append(bench_train.success(env, act))
        return False

    made = bench_train.race_of_peer(config, env, 0, bench_train.Clock(check, 20), cells=2, updates=1)
    assert made == 60 and len(shares) == 1 and 0.0 <= shares[0] <= 1.0


def test_who_does_not_arrive_gets_no_time() -> None:
    rows = [
        {
            "learner": name,
            "seed": seed,
            "reached": reached,
            "policy_steps": 100,
            "seconds": float(seconds),
        }
        for name, seconds, reached in (
            ("hrl-comfort", "2", True),
            ("other", "6", True),
            ("late", "50", False),
        )
        for seed in range(2)
    ]
    lines = bench_train.table(DataFrame(rows)).splitlines()
    late_ours = [{**row, "reached": row["learner"] != "hrl-comfort"} for row in rows]
    assert bench_train.table(DataFrame(late_ours)).splitlines()[3].endswith("| 6.0 (6.0 to 6.0) | - |")  # nor a ratio
    assert lines[3] == "| other | 2 of 2 | 100 (100 to 100) | 6.0 (6.0 to 6.0) | 3.00 (3.00 to 3.00) |"
    assert lines[4] == "| late | 0 of 2 | - | - | - |"
