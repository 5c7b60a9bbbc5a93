"""Benchmarks measure every contestant in every round; tables give medians and ratios. No time is asserted."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter, sleep

import pytest

from hrl_comfort.__main__ import main
from hrl_comfort.compose import compose, environment
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments import bench, bench_cores, bench_start, bench_together, bench_train, bench_update
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


@pytest.mark.parametrize("name", [name for name in bench_update.LEARNERS if "Stable" not in name])
def test_every_learner_learns(name: str) -> None:
    agent = compose("train", ["agent.hidden=[16,16]"]).agent
    make, precision = bench_update.LEARNERS[name]
    bench_update.at(precision or "medium", make(agent, 9, 8))()


def test_the_peer_from_stable_baselines_learns() -> None:
    pytest.importorskip("stable_baselines3", reason="in the extra bench")
    agent = compose("train", ["agent.hidden=[16,16]"]).agent
    bench_update.LEARNERS["Stable-Baselines3"][0](agent, 9, 8)()


def test_policies_together_are_measured_beside_one_by_one(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench_together, "BATCHES", (4,))
    monkeypatch.setattr(bench_together, "POLICIES", (2,))
    monkeypatch.setattr(bench_update, "SECONDS", 0.01)
    words = ["agent.hidden=[8]", "agent.guide=field", "agent.guided_rows=2", "task=pick_place"]
    assert main(["bench", "together", *words, f"output={tmp_path}"]) == 0
    rows = read_rows(tmp_path / "together.csv")
    assert [row["loop"] for row in rows if row["round"] == "0"] == ["together", "one by one"]
    assert len(rows) == 2 * bench_together.ROUNDS and all(float(row["updates_per_s"]) > 0 for row in rows)


def test_without_the_peer_one_line_says_what_to_install(monkeypatch, capsys) -> None:
    monkeypatch.setattr(bench_update, "find_spec", lambda _: None)
    assert main(["bench", "update"]) == 1
    assert "pip install 'hrl-comfort[bench]'" in capsys.readouterr().err


def race_config(folder: Path) -> TrainConfig:
    """Return a training whose first update comes at once; nobody wins or loses by it."""
    overrides = ["task=reach", "curriculum=off", "agent.warmup_decisions=20", "agent.batch_size=16"]
    return compose("train", [*overrides, "agent.hidden=[16,16]", "engine.rows=4", f"output={folder}"])


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
        {"learner": name, "seed": str(seed), "reached": str(reached), "decisions": "100", "seconds": seconds}
        for name, seconds, reached in (
            ("hrl-comfort", "2", True),
            ("other", "6", True),
            ("late", "50", False),
        )
        for seed in range(2)
    ]
    lines = bench_train.table(rows).splitlines()
    late_ours = [{**row, "reached": str(row["learner"] != "hrl-comfort")} for row in rows]
    assert bench_train.table(late_ours).splitlines()[3].endswith("| 6.0 (6.0 to 6.0) | - |")  # nor a ratio
    assert lines[3] == "| other | 2 of 2 | 100 (100 to 100) | 6.0 (6.0 to 6.0) | 3.00 (3.00 to 3.00) |"
    assert lines[4] == "| late | 0 of 2 | - | - | - |"


def test_two_processes_are_held_to_what_two_loops_of_products_gain() -> None:
    rates = {
        ("training", "1"): 10,
        ("training", "2"): 18,
        ("training, cells apart", "1"): 14,
        ("training, cells apart", "2"): 17,
        ("matrix products", "1"): 5,
        ("matrix products", "2"): 10,
    }
    rows = [
        {"loop": loop, "processes": n, "round": "0", "rounds_per_s": str(rate)}
        for (loop, n), rate in rates.items()
    ]
    *_, apart, share = bench_cores.table(rows).splitlines()
    assert apart.endswith("| 1.40 (1.40 to 1.40) | 0.94 (0.94 to 0.94) |  |")
    assert share.endswith("| 0.90 (0.90 to 0.90) |")


def test_a_training_and_products_have_a_rate(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench_cores, "SECONDS", 0.05)
    for loop in (bench_cores.training, bench_cores.multiplying):
        assert loop(race_config(tmp_path)) > 0


def test_the_start_of_every_command_is_measured_in_every_round(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(bench_start, "REPEATS", 1)
    assert main(["bench", "start", "engine.rows=2", "agent.hidden=[8]", f"output={tmp_path}"]) == 0
    rows = read_rows(tmp_path / "start.csv")
    measured = [(row["command"], row["round"]) for row in rows]
    assert measured == [(bench_start.HELP, "0"), (bench_start.STEP, "0")]
    assert all(float(row["seconds"]) > 0 for row in rows)
    assert capsys.readouterr().out == bench_start.table(rows)


def test_a_training_that_makes_no_step_is_no_measurement() -> None:
    config = compose("train")
    assert isinstance(config, TrainConfig)
    with pytest.raises(ConfigError, match=r"made no step: hrl-comfort: agent\.tau=7\.0 is"):
        bench_start.step_s(config, ["agent.tau=7"])


def test_seconds_are_told_as_medians_with_their_range() -> None:
    rows = [{"command": "a", "round": str(k), "seconds": str(s)} for k, s in enumerate((3, 1, 2.5))]
    assert bench_start.table(rows).splitlines()[2:] == ["| a | 2.50 (1.00 to 3.00) |"]
