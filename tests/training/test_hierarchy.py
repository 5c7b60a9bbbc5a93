"""Hierarchies: one command trains every option and evaluates the cycle, and goes on wherever it was stopped."""

from __future__ import annotations

import html
import os
import re
import shlex
import shutil
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, HierarchyTrainConfig
from hrl_comfort.config.overrides import override
from hrl_comfort.evaluation.terminal_states import record_terminal_states
from hrl_comfort.files.provenance import RunState
from hrl_comfort.files.run_config import load_config
from hrl_comfort.files.tables import read_table
from hrl_comfort.sweeps.job import OtherRunError, state_of
from hrl_comfort.training import hierarchy_trainer as module
from hrl_comfort.training.controller_trainer import ControllerTraining
from hrl_comfort.training.hierarchy_trainer import evaluations, option_config, train_hierarchy
from hrl_comfort.training.preemption import Preempted
from hrl_comfort.training.trainer import Training
from tests.stopping import stopping

SMALL = (
    "division=two", "engine.num_envs=4", "agent.policy_steps=160", "agent.learning_starts=40", "agent.hidden=[8,8]",
    "agent.batch_size=8", "agent.log_every=40", "agent.checkpoint_every=60", "hierarchy.terminal_states_episodes=24",
    "hierarchy.episodes=2", "hierarchy.budget_fractions.pick_place=1", "hierarchy.budget_fractions.return=1",
    "task.max_episode_steps=40",
    "task.precision.grasp_tolerance_m=0.5", "task.precision.place_tolerance_m=0.5", "reward.arrival_speed=0",
    "hierarchy.refinement=[{name:again,policy_steps:80,set:{agent.learning_rate:1e-4}}]", "curriculum=off",
    "human=none",
)  # fmt: skip
PARTS = ("pick_place_first", "return_first", "return", "pick_place")


def small(folder: Path, *overrides: str) -> HierarchyTrainConfig:
    config = compose("train_hierarchy", [*SMALL, f"output='{folder}'", *overrides])
    assert isinstance(config, HierarchyTrainConfig)
    return config


@pytest.fixture(scope="module", autouse=True)
def _skilled() -> Iterator[None]:
    """Record the terminal states of the expert: policies of so few steps never succeed."""

    def record(config: EvaluateConfig) -> Path:
        hopeless = config.task.precision.grasp_tolerance_m < 0.5
        return record_terminal_states(config if hopeless else replace(config, policy="expert"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "record_terminal_states", record)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hierarchy that nothing stopped."""
    return train_hierarchy(small(tmp_path_factory.mktemp("runs") / "whole"))


def metrics(folder: Path) -> list[bytes]:
    return [(folder / part / "metrics.csv").read_bytes() for part in PARTS]


def test_options_that_begin_at_postures_are_the_same_at_a_time_and_one_after_another(tmp_path: Path) -> None:
    plain = ("hierarchy.starts=ik", "hierarchy.refinement=[]")
    one, two = (train_hierarchy(small(tmp_path / str(jobs), *plain, f"hierarchy.jobs={jobs}")) for jobs in (1, 2))
    for part in ("pick_place", "return"):
        assert load_config(two / part).task.start == "ik"
        for file in ("metrics.csv", "eval/episodes.csv"):
            assert (one / part / file).read_text().replace(str(one), str(two)) == (two / part / file).read_text()
    assert (two / "cycle" / "eval" / "summary.json").is_file()


def test_every_option_is_a_run_that_begins_where_the_one_before_it_ends(whole):
    first, back, again = (load_config(whole / part) for part in ("pick_place_first", "return_first", "pick_place"))
    assert first.task.start == "ik" and first.task.name == "pick_place"
    assert back.task.start == str(whole / "pick_place_first" / "terminal_states.npz")
    assert again.agent.next_skill == str(whole / "return")
    assert again.initial_policy == str(whole / "pick_place_first")
    assert load_config(whole / "return").agent.next_skill is None
    for part in ("pick_place", "return", "cycle"):
        assert (whole / part / "eval" / "summary.json").is_file()


def test_a_hierarchy_killed_several_times_and_told_to_stop_goes_on_bit_for_bit(whole, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    for name, at in (("pick_place", 20), ("pick_place", 100), ("return", 80), ("return", 20)):
        with stopping(Training, "step", lambda self, n=name, t=at: self.config.task.name == n and self.steps >= t):
            train_hierarchy(small(folder))
    with monkeypatch.context() as patch:
        step = Training.step
        patch.setattr(Training, "step", lambda self: (os.kill(os.getpid(), signal.SIGTERM), step(self))[1])
        with pytest.raises(Preempted, match=f"go on with train hierarchy resume={folder}"):
            train_hierarchy(small(folder))
    config = compose("train_hierarchy", [f"resume='{folder}'"])
    assert isinstance(config, HierarchyTrainConfig)
    train_hierarchy(config)
    assert metrics(folder) == metrics(whole)


def test_a_hierarchy_stopped_before_an_evaluation_does_the_rest(whole, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    with stopping(Training, "step", lambda self: self.config.initial_policy is not None):
        train_hierarchy(small(folder))
    done = []
    monkeypatch.setattr(module, "train", lambda config: done.append(Path(config.output).name))
    monkeypatch.setattr(module, "evaluate", lambda config: done.append(config.output.removeprefix(f"{folder}/")))
    train_hierarchy(small(folder))
    assert done == ["return", "pick_place", "pick_place/eval", "return/eval", "cycle/eval"]


def test_a_finished_hierarchy_says_so_and_shows_its_table_and_report(whole, capsys):
    words = ["train", "hierarchy", *SMALL, f"output='{whole}'"]
    for _ in range(2):
        assert main(words) == 0
    out = capsys.readouterr().out
    assert out.count("is finished") == 2 and "report.html" in out and "cycle" in out
    assert (whole / "report.html").is_file()
    assert main([*words, "train_seed=1"]) == 1
    out, error = capsys.readouterr()
    assert "already holds another hierarchy" in error and "is finished" not in out


def test_checkpoints_of_the_chain_reach_the_report_and_its_commands_work_as_pasted(whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Path("my runs/lr=0.1")
    shutil.copytree(whole, folder, ignore=shutil.ignore_patterns("report.html", "paths.csv"))
    shutil.rmtree(folder / "return" / "eval")
    assert main(["report", override("run", folder), "video=false"]) == 0
    commands = commands_of(folder)
    assert len(commands) > 5
    policy = override("policy", folder)
    (own,) = (each for each in commands if {"checkpoints=all", policy} <= set(shlex.split(each)))
    assert main([*shlex.split(own)[1:], "episodes=2", "levels=[1,10]"]) == 0
    table = read_table(folder / "cycle" / "eval_validation" / "checkpoints.csv")
    assert table is not None and table["comfort_level"].tolist() == [1, 10] * (len(table) // 2) and len(table) > 3
    assert (table["policy_steps"] == table["pick_place"] + table["return"]).all()
    assert set(table["split"]) == {"validation"} and set(table["episodes"]) == {2}
    assert main(["report", override("run", folder), "video=false"]) == 0
    assert "Success and unsafe contacts by checkpoint" in page_of(folder)
    assert own not in html.unescape(page_of(folder))


def page_of(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def commands_of(folder: Path) -> list[str]:
    """Return the commands in the report of a folder; each is taken as pasted."""
    commands = [html.unescape(each) for each in re.findall("<code>(hrl-comfort .*?)</code>", page_of(folder))]
    for command in commands:
        assert main([*shlex.split(command)[1:], "--dry-run"]) == 0, command
    return commands


def test_a_sweep_skips_a_finished_hierarchy_and_goes_on_with_a_stopped_one(whole, tmp_path):
    assert state_of(small(whole)) is RunState.FINISHED
    with pytest.raises(OtherRunError, match="holds another run"):
        state_of(small(whole, "train_seed=1"))
    assert state_of(small(tmp_path / "run")) is RunState.NEW
    with stopping(Training, "step", lambda _: True):
        train_hierarchy(small(tmp_path / "run"))
    assert state_of(small(tmp_path / "run")) is RunState.STOPPED


def test_a_learned_controller_is_killed_goes_on_and_is_evaluated(tmp_path, capsys):
    folder, agent = tmp_path / "run", "meta_controller_agent"
    controller = [
        "human=patrol", "task.objects=2", "task.max_episode_steps=60", "engine.num_envs=2", f"{agent}.options=16",
        f"{agent}.warmup_options=4", f"{agent}.batch_size=4", f"{agent}.log_every=6",
    ]  # fmt: skip
    overrides = ("division=three", "hierarchy.refinement=[]", "agent.policy_steps=40", "agent.learning_starts=20",
                 *(f"hierarchy.budget_fractions.{name}=1" for name in ("pick", "place")), "task.max_episode_steps=20",
                 override("hierarchy.controller", controller))  # fmt: skip
    with stopping(ControllerTraining, "step", lambda training: training.steps >= 8):
        train_hierarchy(small(folder, *overrides))
    for _ in range(2):
        train_hierarchy(small(folder, *overrides))
    assert f"{folder} is finished" in capsys.readouterr().out
    assert load_config(folder / "controller").task.objects == 2
    for name in ("pick", "place", "return", "cycle", "sort_nearest", "sort_learned"):
        assert (folder / name / "eval" / "summary.json").is_file()
    for page in (folder, folder / "controller"):
        assert main(["report", override("run", page), "video=false"]) == 0
    assert "policies.meta_controller" not in str(commands_of(folder)), "it is evaluated"
    (alone,) = commands_of(folder / "controller")
    assert override("policies.pick", folder / "pick") in shlex.split(alone)


def test_without_a_success_the_next_option_starts_from_inverse_kinematics(tmp_path, capsys):
    hopeless = ("task.precision.grasp_tolerance_m=0.005", "hierarchy.refinement=[]", "agent.policy_steps=40")
    folder = train_hierarchy(small(tmp_path / "run", *hopeless, "hierarchy.terminal_states_episodes=2"))
    assert load_config(folder / "return").task.start == "ik"
    assert "starts from inverse kinematics" in capsys.readouterr().err


def test_with_a_gripper_every_option_starts_from_what_the_one_before_it_left(tmp_path, monkeypatch):
    trained = list[tuple[str, str]]()
    monkeypatch.setattr(module, "_train", lambda config: trained.append((config.task.name, config.task.start)))
    monkeypatch.setattr(module, "terminal_states_of", lambda option, _: f"{option.task.name}'s")
    config = compose("train_hierarchy", ["experiment=grasp", f"output='{tmp_path}'"])
    module.train_options(config, tmp_path)
    assert trained == [("pick", "ik"), ("place", "pick's"), ("return", "place's")]


def test_a_budget_is_shared_and_a_cycle_lasts_three_subtasks():
    config = compose("train_hierarchy", ["division=one", "agent.policy_steps=1000"])
    assert isinstance(config, HierarchyTrainConfig)
    own = option_config(config, "cycle", Path("runs"), "ik")
    assert (own.agent.policy_steps, own.task.max_episode_steps) == (2050, 1500)
    stages = ",".join(f"{{name:{name},policy_steps:{steps},set:{{}}}}" for name, steps in (("a", 1000), ("b", 600)))
    staged = compose("train_hierarchy", ["hierarchy.budget_fractions.place=1.4", f"curriculum.stages=[{stages}]"])
    assert isinstance(staged, HierarchyTrainConfig)
    own = option_config(staged, "place", Path("runs"), "ik")
    assert [stage.policy_steps for stage in own.curriculum.stages] == [1400, 840]


def test_a_controller_is_evaluated_beside_people_that_its_own_training_did_not_see():
    own = "hierarchy.controller=['task=shift','human=fetcher','human.partitioned=true']"
    config = compose("train_hierarchy", ["human=random_walk", own])
    assert isinstance(config, HierarchyTrainConfig)
    options = [option_config(config, name, Path("runs") / name, "ik") for name in config.meta_controller.options]
    splits = {Path(each.output).parent.name: each.split for each in evaluations(config, Path("runs"), options)}
    assert splits["cycle"] == splits["pick"] == "paper" and splits["shift_learned"] == "validation"


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["task=place"], "task.name=place: train hierarchy sets it"),
        (["hierarchy.budget_fractions.pick=0"], r"hierarchy\.budget_fractions\.pick=0\.0 is outside"),
        (
            ["hierarchy.refinement=[{name:a,policy_steps:9,set:{reward.pik:1}}]"],
            r"^hierarchy\.refinement\.0\.set: reward\.pik",
        ),
        (["hierarchy.controller=['human=nobody']"], "human=nobody is not a choice"),
        (["hierarchy.controller=[human=arc]"], r"put human=arc in inner quotes, as in \"hierarchy\.controller=\['"),
        (["agent.demonstrator=expert", "agent.demonstrator_envs=16"], r"envs=16 must be below engine\.num_envs=16"),
        (["hierarchy.controller=['human=patrol']", "division=two"], "choose division=three"),
        (["meta_controller.interruption_steps=5"], r"interruption_steps=5 is for .* in task=cycle"),
        (["task.object=orange"], r"^task\.object=orange: recorded starts need every kind; choose random, or .*=ik$"),
        (["initial_policy=runs/pick"], "initial_policy=runs/pick: train hierarchy sets it"),
    ],
)
def test_a_mistake_is_named_before_anything_is_trained(tmp_path, overrides, said):
    with pytest.raises(ConfigError, match=said):
        train_hierarchy(compose("train_hierarchy", [*overrides, f"output='{tmp_path}/run'"]))
    assert not (tmp_path / "run").exists()
