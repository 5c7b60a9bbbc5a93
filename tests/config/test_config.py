"""Composition of every choice, and of every command."""

from __future__ import annotations

import dataclasses

import pytest
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from hrl_comfort.cli import main as commands
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, TrainConfig
from hrl_comfort.config.hydra_conf import composed
from hrl_comfort.config.overrides import ROOTS, check_overrides, choices, config_dir, groups, override
from hrl_comfort.files.run_config import save_config

OWN = {
    "export": ["policy=expert"],
    "identify": ["run=runs"],
    "report": ["run=runs"],
    "figure": ["kind=levels", "evaluations=[runs/pick/eval]", "output=levels.png"],
}
"""Required overrides of commands."""
NEEDED = {"recorded": ["human.file=walk.csv"]}
"""Required overrides of choices."""
CHOICES = [
    (root, group, name)
    for root in ("train", "train_hierarchy", "evaluate")
    for group, names in groups(root).items()
    for name in names
    if root == "train" or name == names[0] or name not in groups("train").get(group, ())
    if (root, group) != ("train_hierarchy", "task")  # it sets the task of each option itself
]
"""Every choice at least once, and every group of these commands but the task of `train_hierarchy`."""


def trained(*overrides: str) -> TrainConfig:
    config = compose("train", overrides)
    assert isinstance(config, TrainConfig)
    return config


@pytest.mark.parametrize(("root", "group", "name"), CHOICES)
def test_every_choice_composes(root, group, name):
    config = compose(root, [f"{group}={name}", *NEEDED.get(name, [])])
    assert isinstance(config, ROOTS[root])
    own = {
        "human": "motion",
        "curriculum": "kind",
        "robot": "name",
        "task": "name",
        "meta_controller": "name",
    }
    if name == "servo" and group == "curriculum":
        assert (config.curriculum.kind, config.agent.policy_steps) == ("adaptive", 96000)
        assert [stage.name for stage in config.curriculum.stages] == ["model", "late"]
    elif name == "grasp" and group == "curriculum":
        schedule = config.curriculum
        assert (schedule.kind, schedule.start_m, schedule.end_m, schedule.reach) == ("adaptive", 0.1, 0.05, [2, 2])
    elif name == "pair":
        assert config.human.motions == "worker+patrol"
    elif group in own:
        assert getattr(getattr(config, group), own[group]) == name


@pytest.mark.parametrize("root", ROOTS)
def test_every_root_composes_to_frozen_dataclasses(root):
    config = compose(root, OWN.get(root, []))
    assert type(config) is ROOTS[root]
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.output = "elsewhere"


def test_every_group_on_disk_belongs_to_a_command():
    folders = {path.name for path in config_dir().iterdir() if path.is_dir()}
    assert folders == {group for root in ("train", "train_meta_controller", "deploy") for group in groups(root)}


def test_a_choice_does_not_repeat_a_line_of_the_shared_file():
    for shared in config_dir().glob("*/_shared.yaml"):
        lines = {line for line in shared.read_text().splitlines() if line and line[0] not in "# "}
        for name in choices(shared.parent.name):
            own = (shared.parent / f"{name}.yaml").read_text().splitlines()
            assert not lines & set(own), f"{shared.parent.name}/{name}.yaml repeats a line of _shared.yaml"


def test_overrides_win_over_the_experiment():
    config = trained("experiment=paper_experiment_1", "task=pick", "engine.num_envs=3")
    assert (config.task.name, config.human.spawn, config.engine.num_envs) == ("pick", "points", 3)


@pytest.mark.parametrize(
    ("root", "overrides"),
    [
        (
            "train",
            ["human=arc", "human.keep_out_m=0.4", "++reward.contact=-3", "reward.contact=-4", "agent.hidden=[16]"],
        ),
        ("train", ["human.speed_m_s=0.1", "human=mixture", "~human.mixture.approach", "+human.mixture.still={}"]),
        ("train", ["hydra/launcher=basic", "hydra.run.dir=/x", "train_seed=3"]),
        ("train_hierarchy", ["agent.gamma=0.9", "division=one", "experiment=comfort_shift", "hierarchy.episodes=3"]),
        ("evaluate", ["task=sort", "++policies.pick=expert", "meta_controller=nearest", "meta_controller.retries=2"]),
    ],
)
def test_values_that_are_set_in_a_copy_are_what_hydra_composes(root: str, overrides: list[str]) -> None:
    known = check_overrides(root, overrides)
    GlobalHydra.instance().clear()  # a sweep in this process may have left its own
    with initialize_config_dir(str(config_dir()), version_base="1.3"):
        at_once = hydra_compose(root, known)
    assert OmegaConf.to_container(composed(root, known)) == OmegaConf.to_container(at_once)


def test_the_time_in_an_output_is_that_of_its_own_composition():
    assert trained("output='${now:%f}'").output != trained("output='${now:%f}'").output


def test_whole_numbers_are_coordinates_too_and_texts_are_not():
    assert trained("human.spawns_m=[[1,1],[0,-2]]", "human.held_out=[]").human.spawns_m == [[1, 1], [0, -2]]
    for value in ("[[1,a]]", "[[1,true]]", "[[1]]", "[1,1]", "[[[1,1]]]", "[[1,nan]]"):
        with pytest.raises(ConfigError, match=r"human\.spawns_m"):
            trained(f"human.spawns_m={value}", "human.held_out=[]")


@pytest.mark.parametrize("name", ["paper_experiment_1", "paper_experiment_2"])
def test_the_papers_experiments_have_the_papers_reward(name: str) -> None:
    reward = trained(f"experiment={name}").reward
    assert (reward.pick, reward.place, reward.home) == (50, 100, 150)
    assert reward.progress == reward.home_progress == reward.contact == reward.other_collision == reward.step == 0
    assert reward.return_shaping == (name == "paper_experiment_1")


def test_a_second_of_the_benchmarks_discomfort_costs_a_controller_of_a_shift_a_quarter_of_an_object() -> None:
    suite = compose("benchmark").comfort
    shift = compose("train_meta_controller", ["task=shift", "comfort=shift"]).comfort
    assert shift.scale / CONTROL_STEP_S == pytest.approx(0.25)
    assert (shift.alpha, shift.beta, shift.time_penalty) == (1, 1, 0)
    same = ("form", "distance", "threshold", "min_m", "max_m", "power", "speed_form", "levels")
    assert [getattr(shift, name) for name in same] == [getattr(suite, name) for name in same]


def test_a_sweep_runs_in_subprocesses(tmp_path, capsys):
    assert commands.main(["evaluate", "-m", "policy=/no/a,/no/b", f"output={tmp_path}", "hydra.launcher.n_jobs=2"]) == 1
    out = capsys.readouterr().out
    assert [line.split(":")[1].strip() for line in out.splitlines()] == ["policy=/no/a", "policy=/no/b"]
    assert "/no/a" in out.splitlines()[0].split(": ", 2)[2]


def test_a_budget_scales_the_refinement_of_a_hierarchy_too():
    stages = "curriculum.stages=[{name:a,policy_steps:5000,set:{}}]"
    refined = "hierarchy.refinement=[{name:again,policy_steps:1000,set:{agent.learning_rate:1e-4}}]"
    whole = compose("train_hierarchy", [stages, refined])
    cut = compose("train_hierarchy", [stages, refined, f"agent.policy_steps={whole.agent.policy_steps // 10}"])
    assert [stage.policy_steps for stage in cut.hierarchy.refinement] == [
        stage.policy_steps // 10 for stage in whole.hierarchy.refinement
    ]


def test_splits_are_evaluated_in_folders_of_their_own():
    folders = [compose("evaluate", ["policy=expert", f"split={split}"]).output for split in ("paper", "validation")]
    assert folders == ["runs/evaluate/pick/expert", "runs/evaluate/pick/expert_validation"]


@pytest.mark.parametrize("human", ["mixture", "patrol", "recorded"])
def test_a_policy_is_evaluated_beside_the_people_of_its_training(tmp_path, human):
    file = tmp_path / "walk.csv"
    file.write_text("t,x,y,yaw\n0,1,0,0\n1,1,1,0\n")
    run = compose("train", [f"human={human}", override("human.file", file) if human == "recorded" else "train_seed=1"])
    save_config(run, tmp_path / "config.yaml")
    assert compose("evaluate", [override("policy", tmp_path)]).human == run.human
