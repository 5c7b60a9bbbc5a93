"""Every contestant runs in every round, races end by their rules, and tables say what the rows say."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from mujoco import rollout
from pandas import DataFrame

from hrl_comfort.benchmarks import env as bench_env
from hrl_comfort.benchmarks import measure
from hrl_comfort.benchmarks import safety as bench_safety
from hrl_comfort.benchmarks import train as bench_train
from hrl_comfort.benchmarks import update as bench_update
from hrl_comfort.benchmarks.peers import TorchRLSAC
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import TrainConfig
from hrl_comfort.files.run_config import environment

LOOPS = ("engine", "bare mujoco.rollout", "mujoco.rollout of the engine's states")
SMALL = ("agent.hidden=[16,16]", "agent.batch_size=16")


def test_contestants_take_turns_in_every_round(tmp_path: Path, monkeypatch) -> None:
    calls: list[tuple[int, str]] = []

    def make(size: int) -> dict[str, measure.Rate]:
        return {name: lambda name=name: calls.append((size, name)) or size * 10.0 for name in "ab"}

    monkeypatch.setattr(measure, "ROUNDS", 2)
    frame = measure.interleaved(tmp_path / "x.csv", ("size", "who", "round", "rate"), (1, 2), make)
    assert calls == [(size, name) for size in (1, 2) for _ in range(2) for name in "ab"]
    assert frame["rate"].tolist() == [10.0] * 4 + [20.0] * 4
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "x.csv"), frame)


def test_ratios_are_the_medians_of_those_of_each_round() -> None:
    rates = {"engine": (8, 30, 10), "bare mujoco.rollout": (10, 10, 20)}
    worlds = {"pick": 1, "shift": 2}
    rows = [
        (world, 4, name, turn, rate * factor ** (name == "engine"))
        for world, factor in worlds.items()
        for name, each in rates.items()
        for turn, rate in enumerate(each)
    ]
    frame = DataFrame(rows, columns=list(bench_env.COLUMNS))
    assert bench_env.table(frame).splitlines() == [
        "| world | num_envs | loop | policy_steps/s | of bare rollout |",
        "| --- | --- | --- | --- | --- |",
        "| pick | 4 | engine | 10 (8 to 30) | 0.80 (0.50 to 3.00) |",
        "| pick | 4 | bare mujoco.rollout | 10 (10 to 20) |  |",
        "| shift | 4 | engine | 20 (16 to 60) | 1.60 (1.00 to 6.00) |",
        "| shift | 4 | bare mujoco.rollout | 10 (10 to 20) |  |",
    ]
    frame = frame[frame["world"] == "pick"].drop(columns="world")
    frame.columns = list(bench_update.COLUMNS)
    frame["learner"] = frame["learner"].replace({"bare mujoco.rollout": "hrl-comfort"})
    line = bench_update.table(frame).splitlines()[2]
    assert line == "| 4 | engine | 10 (8 to 30) | 1.25 (0.33 to 2.00) |", "ours / theirs"


def test_every_loop_makes_the_policy_steps_that_its_rate_counts(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench_env, "NUM_ENVS", (1, 4))
    monkeypatch.setattr(bench_env, "SIZES", {"grasp": (4,)})
    monkeypatch.setattr(measure, "SECONDS", 0.0)
    monkeypatch.setattr(bench_env, "WARM_UP", 1)
    monkeypatch.setattr(bench_env, "DECISIONS", 2)
    made: dict[int, int] = {}
    step = bench_env.Engine.step

    def counted(engine, action):
        made[len(action)] = made.get(len(action), 0) + 1
        return step(engine, action)

    monkeypatch.setattr(bench_env.Engine, "step", counted)
    assert main(["bench", "env", f"output={tmp_path}"]) == 0
    frame = pd.read_csv(tmp_path / "env.csv")
    worlds = ["pick", "shielded", "shift"]
    expected = [(world, cells, name) for world in worlds for cells in (1, 4) for name in LOOPS]
    expected.insert(3, ("pick", 1, "dm_control front"))
    expected += [("grasp", 4, name) for name in LOOPS]
    for turn in range(measure.ROUNDS):
        rows = frame[frame["round"] == turn]
        assert [*zip(rows["world"], rows["num_envs"], rows["loop"], strict=True)] == expected
    recorded = bench_env.WARM_UP + bench_env.DECISIONS
    turns = 2 * measure.ROUNDS  # one to warm up, one in no time
    assert made == {1: len(worlds) * (recorded + turns), 4: (1 + len(worlds)) * (recorded + turns)}


def test_decisions_of_the_engine_roll_out_to_its_states(monkeypatch) -> None:
    monkeypatch.setattr(bench_env, "WARM_UP", 1)
    monkeypatch.setattr(bench_env, "DECISIONS", 2)
    rolled = []

    def kept(model, data, state, control, **options):
        rolled.append((state, rollout.rollout(model, data, state, control, **options)[0][:, -1]))

    step = bench_env.replay_loop(compose_environment("train", bench_env.WORLDS["shielded"]), 2)
    monkeypatch.setattr(bench_env, "rollout", SimpleNamespace(rollout=kept))
    for _ in range(3):
        step()
    (first, then), (second, _), (third, _) = rolled
    assert (then == second).all() and (third == first).all()


def test_the_engine_is_measured_in_several_processes_beside_one(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bench_env, "NUM_ENVS", (1, 4))
    monkeypatch.setattr(bench_env, "WORLDS", {})
    monkeypatch.setattr(measure, "SECONDS", 0.0)
    assert main(["bench", "env", "engine.processes=2", f"output={tmp_path}"]) == 0
    loops = pd.read_csv(tmp_path / "env.csv").groupby("num_envs")["loop"].unique()
    assert {size: [*names] for size, names in loops.items()} == {
        1: [*LOOPS, "dm_control front"],
        4: [*LOOPS, "engine, 2 processes"],
    }


def test_the_loops_of_the_benchmark_run_with_a_gripper():
    config = compose_environment("train", ["cell=grasp", "human=none", "task=pick"])
    for loop in (bench_env.engine_loop(config, 2), bench_env.bare_loop(config, 2), bench_env.dm_loop(config)):
        loop()


@pytest.mark.parametrize("name", list(bench_update.LEARNERS))
def test_an_update_of_every_learner_changes_its_networks(name: str, monkeypatch) -> None:
    if "Stable" in name:
        pytest.importorskip("stable_baselines3", reason="in the extra bench")
    monkeypatch.setattr(bench_update, "STORED", 40)
    stepped: list[str] = []
    adam = torch.optim.Adam.step

    def step(optimiser: torch.optim.Adam, *rest: object) -> object:
        stepped.append(torch.get_float32_matmul_precision())
        return adam(optimiser, *rest)

    monkeypatch.setattr(torch.optim.Adam, "step", step)
    make, precision = bench_update.LEARNERS[name]
    bench_update.at_precision(make(compose("train", list(SMALL)).agent, (9, 6)), precision or "medium")()
    optimisers = 3 if "Stable" in name else 1  # Stable-Baselines3 has one for each loss
    assert stepped == [precision or "medium"] * optimisers


def test_torchrls_sac_learns_towards_the_reward() -> None:
    agent = compose("train", [*SMALL, "agent.learning_rate=3e-3", "agent.buffer_size=64"]).agent
    learner = TorchRLSAC(agent, 9, 6, gamma=0.9)
    learner.remember(bench_update.transitions((9, 6))[:64])
    before = [p.detach().clone() for p in learner.loss.target_qvalue_network_params.values(True, True)]
    for _ in range(3):
        learner.update()
    after = list(learner.loss.target_qvalue_network_params.values(True, True))
    assert all(not torch.equal(p, q) for p, q in zip(before, after, strict=True))


@pytest.mark.parametrize("what", ["update", "train"])
def test_without_the_peer_one_line_says_what_to_install(what: str, monkeypatch, capsys) -> None:
    monkeypatch.setattr(measure, "find_spec", lambda _: None)
    assert main(["bench", what]) == 1
    assert "pip install 'hrl-comfort[bench]'" in capsys.readouterr().err


def race_config(folder: Path, policy_steps: int = 120) -> TrainConfig:
    """Return a training whose first update comes at once and that ends soon."""
    overrides = ["task=reach", "curriculum=off", "agent.learning_starts=20", f"agent.policy_steps={policy_steps}"]
    return compose("train", [*overrides, *SMALL, "engine.num_envs=4", f"output={folder}"])


def over_after(shares: list[float]) -> tuple[int, bool]:
    """Return the policy steps at which a race with these checks is over, and whether it was won."""
    checks: Iterator[float] = iter(shares)
    clock = bench_train.Clock(lambda act: next(checks), first=10, limit=20)
    clock.start()
    return next(steps for steps in range(1, 100) if clock.done(np.asarray, steps)), clock.reached


def test_a_race_is_won_by_two_checks_in_a_row_and_lost_at_the_limit() -> None:
    assert over_after([0.95, 0.95]) == (12, True)
    assert over_after([0.95, 0.94, 1.0, 0.96]) == (14, True)
    assert over_after([0.95, 0.9] * 10) == (20, False)
    assert over_after([0.0] * 8 + [0.95, 0.95]) == (20, True)


def test_checks_are_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    def passing(seconds: float) -> float:
        nonlocal now
        now += seconds
        return 1.0

    monkeypatch.setattr(bench_train, "time", SimpleNamespace(perf_counter=lambda: now))
    clock = bench_train.Clock(lambda act: passing(7.0), first=1, limit=99)
    clock.start()
    for steps, done in ((2, False), (4, True)):
        passing(0.5)
        assert clock.done(np.asarray, steps) == done
    assert clock.seconds == 1.0


@pytest.mark.parametrize("name", list(bench_train.RACES))
def test_every_learner_races_to_the_limit_on_the_task_it_is_checked_on(name: str, tmp_path: Path, monkeypatch) -> None:
    if "Stable" in name:
        pytest.importorskip("stable_baselines3", reason="in the extra bench")
    monkeypatch.setattr(bench_train, "CHECK_GROWTH", 2.0)
    monkeypatch.setattr(bench_train, "CHECK_EPISODES", 2)
    config = race_config(tmp_path, 64)
    shares: list[float] = []
    width = bench_update.observed_and_acted(config)[0]

    def check(act: bench_train.Act) -> float:
        actions = act(np.zeros((3, width), dtype=np.float32))
        assert actions.shape == (3, 6) and np.abs(actions).max() <= 1.0
        assert np.array_equal(actions, act(np.zeros((3, width), dtype=np.float32))), "no exploration"
        shares.append(bench_train.success(environment(config), act))
        return shares[-1]

    clock = bench_train.Clock(check, config.agent.learning_starts, config.agent.policy_steps)
    assert bench_train.RACES[name](config, clock) == 64
    assert len(shares) == 2 and clock.reached == (min(shares) >= bench_train.GOAL)


def test_every_learner_races_with_every_seed_once_and_a_stopped_benchmark_goes_on(tmp_path: Path, monkeypatch) -> None:
    raced: list[tuple[str, int]] = []
    stop = 3

    def race(config: TrainConfig, clock: bench_train.Clock, name: str) -> int:
        if len(raced) == stop:
            raise KeyboardInterrupt
        assert config.curriculum.kind == "off" and config.agent.learning_rate_end is None
        assert torch.get_float32_matmul_precision() == config.agent.matmul_precision
        raced.append((name, config.train_seed))
        return 100

    races = {name: partial(race, name=name) for name in ("hrl-comfort", "other")}
    monkeypatch.setattr(bench_train, "RACES", races)
    monkeypatch.setattr(bench_train, "SEEDS", range(2))
    monkeypatch.setattr(bench_train, "need_peers", lambda: None)
    words = ["bench", "train", "task=reach", "agent.learning_rate_end=1e-4", f"output={tmp_path}"]
    assert main(words) == 130
    stop = 99
    assert main(words) == 0
    assert raced == [(name, seed) for seed in range(2) for name in races]
    frame = pd.read_csv(tmp_path / "train.csv")
    assert [*zip(frame["learner"], frame["seed"], strict=True)] == raced and set(frame["task"]) == {"reach"}


def test_in_the_race_an_experiment_helps_nobody(tmp_path: Path, monkeypatch) -> None:
    raced: list[TrainConfig] = []
    monkeypatch.setattr(bench_train, "_races", lambda config, *_: raced.append(config) or [])
    monkeypatch.setattr(bench_train, "need_peers", lambda: None)
    monkeypatch.setattr(bench_train, "table", lambda _: "")
    config = compose("train", ["experiment=comfort", "agent.other_level=0.5", f"output='{tmp_path}'"])
    assert isinstance(config, TrainConfig) and config.curriculum.stages
    bench_train.bench_train(config)
    assert raced[0].curriculum.stages == [] and raced[0].agent.other_level == 0 and raced[0].agent.demonstrator is None


def test_the_race_is_told_in_times_ours_with_an_interval_and_lower_bounds() -> None:
    seconds = {"hrl-comfort": (1, 2, 3), "other": (4, 8, 6), "late": (50, 60, 70)}
    rows = [
        {
            "task": "pick",
            "learner": name,
            "seed": seed,
            "reached": name != "late",
            "policy_steps": 100,
            "seconds": value,
        }
        for name, each in seconds.items()
        for seed, value in enumerate(each)
    ]
    frame = DataFrame(rows)
    lines = bench_train.table(frame).splitlines()[2:]
    assert lines[0] == "| pick | hrl-comfort | 3 of 3 | 100 (100 to 100) | 2.0 (1.0 to 3.0) |  |"
    assert lines[1] == "| pick | other | 3 of 3 | 100 (100 to 100) | 6.0 (4.0 to 8.0) | 3.00 [1.33, 8.00] |"
    assert lines[2].startswith("| pick | late | 0 of 3 | ≥ 100 (100 to 100) | ≥ 60.0 (50.0 to 70.0) | ≥ 30.00 [")
    frame["reached"] = frame["learner"] != "hrl-comfort"
    assert bench_train.table(frame).splitlines()[3].endswith("| 6.0 (4.0 to 8.0) | - |"), "nor a ratio"


def test_peers_are_compared_with_each_setting_of_ours() -> None:
    seconds = {"hrl-comfort, few": 1.0, "hrl-comfort, many": 2.0, "other": 6.0}
    rows = [("pick", name, 0, True, 100, value) for name, value in seconds.items()]
    head, _, few, _, other = bench_train.table(DataFrame(rows, columns=list(bench_train.COLUMNS))).splitlines()
    assert head.endswith("| times ours, few [95 %] | times ours, many [95 %] |")
    assert few.endswith("|  |  |") and other.endswith("| 6.00 | 3.00 |")
    rows += [("reach", name, 0, True, 100, seconds[name]) for name in ("hrl-comfort, many", "other")]
    last = bench_train.table(DataFrame(rows, columns=list(bench_train.COLUMNS))).splitlines()[-1]
    assert last.endswith("| - | 3.00 |"), "no ratio to a setting that did not race"


@pytest.mark.parametrize(("name", "updates"), [("4 updates", 0.25), ("1 update", 0.0625)])
def test_ours_races_with_the_updates_that_its_name_says(name: str, updates: float, tmp_path: Path, monkeypatch) -> None:
    raced: list[TrainConfig] = []

    def training(config: TrainConfig, *_: object) -> None:
        raced.append(config)
        raise KeyboardInterrupt

    monkeypatch.setattr(bench_train, "Training", training)
    config = race_config(tmp_path, 64)
    with pytest.raises(KeyboardInterrupt):
        bench_train.RACES[f"hrl-comfort, 16 cells, {name} in 16 steps"](config, bench_train.Clock(len, 1, 1))
    assert [(each.engine.num_envs, each.agent.updates_per_policy_step) for each in raced] == [(16, updates)]


def test_rating_and_shield_are_measured_beside_the_papers_arm(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(bench_safety, "NUM_ENVS", (1, 2))
    monkeypatch.setattr(measure, "SECONDS", 0.0)
    monkeypatch.setattr(measure, "ROUNDS", 1)
    assert main(["bench", "safety", f"output={tmp_path}"]) == 0
    frame = pd.read_csv(tmp_path / "safety.csv")
    assert [*zip(frame["num_envs"], frame["loop"], strict=True)] == [
        (n, w) for n in (1, 2) for w in bench_safety.WORLDS
    ]
    assert "shield, worst" in capsys.readouterr().out.splitlines()[-2]


def test_what_the_shield_adds_to_a_control_step_is_told_in_ms() -> None:
    rates = dict(zip(bench_safety.WORLDS, (1000.0, 500.0, 250.0, 200.0), strict=True))
    frame = DataFrame([(1, name, 0, rate) for name, rate in rates.items()], columns=list(bench_safety.COLUMNS))
    line = bench_safety.cost(frame, 5)
    assert "rated arm 0.20 (" in line and "shield, observed 0.40 (" in line and "shield, worst 0.60 (" in line
