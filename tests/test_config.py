"""Every choice composes, every mistake gets one line, what is written loads back."""

from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

import hrl_comfort
from hrl_comfort import __main__ as commands
from hrl_comfort import compose as composing
from hrl_comfort.compose import (
    LATER,
    ROOTS,
    choices,
    compose,
    config_dir,
    groups,
    load_config,
    override,
    save_config,
)
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig
from hrl_comfort.experiments.again import Left, left
from hrl_comfort.experiments.sweep_record import find_jobs, planned

OWN = {
    "report": ["run=runs"],
    "figure": ["kind=levels", "evaluations=[runs/pick/eval]", "output=levels.png"],
}
"""What a command without sections must be told."""
NEEDED = {"playback": ["human.file=walk.csv"]}
"""What a choice cannot do without."""
CHOICES = [
    (root, group, name)
    for root in ("train", "evaluate")
    for group, names in groups(root).items()
    for name in names
]


def trained(*overrides: str) -> TrainConfig:
    config = compose("train", overrides)
    assert isinstance(config, TrainConfig)
    return config


@pytest.mark.parametrize(("root", "group", "name"), CHOICES)
def test_every_choice_composes(root, group, name):
    config = compose(root, [f"{group}={name}", *NEEDED.get(name, [])])
    assert isinstance(config, ROOTS[root])
    own = {"human": "motion", "curriculum": "kind", "robot": "name", "task": "name", "meta": "name"}
    if group in own and name != "fine":
        assert getattr(getattr(config, group), own[group]) == name


@pytest.mark.parametrize("root", ROOTS)
def test_every_root_composes_to_frozen_dataclasses(root):
    config = compose(root, OWN.get(root, []))
    assert type(config) is ROOTS[root]
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.output = "elsewhere"


def test_every_group_on_disk_belongs_to_a_command():
    folders = {path.name for path in config_dir().iterdir() if path.is_dir()}
    assert folders == {group for root in ("train", "train_meta", "evaluate") for group in groups(root)}


def test_a_group_restates_no_number_that_its_choices_share():
    for shared in config_dir().glob("*/_shared.yaml"):
        lines = {line for line in shared.read_text().splitlines() if line and line[0] not in "# "}
        for name in choices(shared.parent.name):
            own = (shared.parent / f"{name}.yaml").read_text().splitlines()
            assert not lines & set(own), f"{shared.parent.name}/{name}.yaml repeats a line of _shared.yaml"


def test_values_of_the_user_win_over_the_experiment():
    config = trained("experiment=paper", "task=pick", "engine.rows=3")
    assert (config.task.name, config.task.steps_per_decision, config.engine.rows) == ("pick", 1, 3)


def test_the_paper_experiment_is_the_papers():
    config = trained("experiment=paper")
    assert (config.agent.batch_size, config.agent.buffer_size, config.agent.gamma) == (1028, 1_000_000, 0.99)
    assert (config.engine.rows, config.task.steps_per_decision, config.task.observation) == (5, 1, "paper")
    assert (config.reward.pick, config.reward.place, config.reward.home) == (50, 100, 150)
    assert config.curriculum.kind == "off"
    assert config.reward.progress == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["learn"], "learn is not a verb; choose one of train, evaluate"),
        (["train", "task=plce"], "task=plce is not a choice, did you mean place?; choose one of cycle, pick"),
        (["train", "experiment=papr"], "experiment=papr is not a choice, did you mean paper?"),
        (["train", "tsk=pick"], "tsk is not a key, did you mean task?; train has agent, cell"),
        (
            ["train", "task.colur=pink"],
            "task.colur is not a key, did you mean colour?; task has action, ball_jitter_m",
        ),
        (["train", "+task.size=3"], "task.size is not a key"),
        (["train", "output.x=3"], "output.x is not a key"),
        (["train", "task.precision=1"], "set task.precision.take_m, "),
        (
            ["train", "task.colour=red"],
            "task.colour='red' is not allowed; choose one of random, orange, pink",
        ),
        (["train", "agent.batch_size=many"], "agent.batch_size: Value 'many' of type 'str'"),
        (["train", "agent.tau=4"], "agent.tau=4.0 is outside its range [0, 1]"),
        (["train", "agent.tau=nan"], "agent.tau=nan is outside its range"),
        (["train", "agent.tau=null"], "agent.tau"),
        (["train", "human.spawns_m=[[a,b]]"], "human.spawns_m[0]: Value 'a'"),
        (["train", "human=playback"], "human.file=null: motion=playback needs a CSV"),
        (["train", "output=${nowhere}"], "output: Interpolation key 'nowhere' not found"),
        (["train", "task=pick,place"], "task=pick,place holds several values; add -m"),
        (["train", "pick"], "'pick' is not an override; write key=value"),
        (["train", "a=["], "'a=[' is not an override"),
        (["train", "agent={"], "'agent={' is not an override"),
        (["train", "agent.tau=" + "[" * 900 + "]" * 900], "lists too deep in lists to be read"),
        (["train", "train_seed=" + "9" * 5000], "is not an override"),
        (["train", "agent.tau=" + "9" * 400], "int too large to convert to float"),
        (["train", "task=" + "a" * 5000], " … "),
        (
            ["train", "cell.ball_m=[-2,-1e300,0.2]"],
            "-1e+300, 0.2] must be 3 finite numbers",
        ),
        (["train", "hydra.nothing=1"], "hydra.nothing"),
        (["train", "-m", "task=pick,plce"], "task=plce is not a choice"),
        (["evaluate", "levels=[1,4,1]"], "levels=[1, 4, 1] names a level twice"),
        (["evaluate", "levels=[0]"], "levels=0 is outside its range [1, 10]"),
        (["evaluate", "levels=[1,11]"], "levels=11 is outside its range [1, 10]"),
        (
            ["evaluate", "levels=[1]", "comfort=conditioned", "comfort.source=simulated"],
            "levels=[1] does not go with comfort.source=simulated; choose none, fixed or random",
        ),
        (["evaluate", "levels=[1]", "endings=e.npz"], "levels=[1] does not go with endings="),
        (["evaluate", "levels=[1]", "checkpoints=all"], "levels=[1] does not go with checkpoints=all"),
        (["train", "resume="], "resume='' is empty; it takes a value"),
        (["train", "output="], "output='' is empty"),
        (["train", "-m", "output=", "train_seed=0,1"], "output='' is empty"),
        (["train", "meta", "policies.pick="], "policies.pick='' is empty"),
        (["evaluate", "policy="], "policy='' is empty"),
        (["report"], "run must be set: run=VALUE"),
        (["report", "run=/no/such/folder"], "/no/such/folder"),
        (["report", "task=pick"], "task is not a key; report has output, run, video"),
        (["figure", *OWN["figure"], "kind=bars"], "kind='bars' is not allowed; choose one of levels, speed"),
        (["figure", *OWN["figure"], "output=a.pdf"], "output='a.pdf' must end in .png"),
        (["figure", *OWN["figure"], "kind=jump"], "jump_s=null"),
        (["figure", *OWN["figure"], "evaluations=[/no/such/folder]"], "/no/such/folder"),
        (["bench"], "say bench env, update, train, together, cores or start"),
        (["bench", "-m"], "bench cannot be swept"),
    ],
)
def test_a_mistake_gets_one_line_and_exit_code_1(words, says, capsys):
    assert commands.main(words) == 1
    out, error = capsys.readouterr()
    assert error.startswith("hrl-comfort: ")
    assert error.count("\n") == 1
    assert says in error
    assert "Traceback" not in out + error


def test_help_lists_every_verb_and_choice(capsys):
    assert commands.main(["--help"]) == 0
    text = capsys.readouterr().out
    for word in [*commands.VERBS, *commands.RUN, *(name for _, _, name in CHOICES)]:
        assert word in text
    assert {verb.split()[0] for verb in commands.RUN} == set(commands.VERBS)


@pytest.mark.parametrize("root", ROOTS)
def test_a_written_configuration_loads_back_equal(root, tmp_path):
    config = compose(root, OWN.get(root, ["human.speed_m_s=0.1234567890123"]))
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == load_config(tmp_path) == config


@pytest.mark.parametrize("key", LATER)
def test_a_configuration_from_before_a_key_loads_as_if_it_said_what_was_so_then(key, tmp_path):
    section, name = key.rsplit(".", 1)
    root = {"meta": "evaluate", "meta_agent": "train_meta"}.get(section, "train")
    config = compose(root, [*OWN.get(root, []), override(key, LATER[key])])
    save_config(config, tmp_path / "config.yaml")
    older = OmegaConf.load(tmp_path / "config.yaml")
    del OmegaConf.select(older, section)[name]
    OmegaConf.save(older, tmp_path / "config.yaml")
    assert load_config(tmp_path) == config


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "does not exist"),
        ("run: x\nvideo: true\n", "has not the keys of"),
        ("run: x\noutput: null\nvideo: perhaps\n", "video: Value 'perhaps'"),
        ("- a list\n", "has not the keys of"),
        ("true\n", "cannot be read"),
        ("a: " + "[" * 900 + "]" * 900, "too deep"),
        ("&a [*a]\n", "holds itself"),
    ],
)
def test_a_broken_configuration_file_is_named(text, says, tmp_path):
    file = tmp_path / "config.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError, match=says) as error:
        load_config(file)
    assert str(file) in str(error.value)


def test_a_list_in_a_file_holds_nothing_but_what_it_should(tmp_path):
    file = tmp_path / "config.yaml"
    save_config(compose("train", ["human.held_out=[3]"]), file)
    file.write_text(file.read_text().replace("held_out:\n  - 3\n", "held_out:\n  - 3: {}\n"))
    with pytest.raises(ConfigError, match=r"held_out=.* holds {3: {}}, which is not of type int"):
        load_config(file)


def test_a_policy_is_evaluated_as_it_was_trained_unless_said_otherwise(tmp_path):
    run = trained(
        "task=place",
        "robot=ur5e",
        "human=arc",
        "human.clipping=full",
        "reward=sparse",
        "task.max_step_deg=1.5",
    )
    save_config(run, tmp_path / "config.yaml")
    (tmp_path / "checkpoints").mkdir()
    checkpoint = tmp_path / "checkpoints" / "10.pt"
    checkpoint.touch()
    for policy in (tmp_path, checkpoint):
        config = compose("evaluate", [override("policy", policy)])
        assert isinstance(config, EvaluateConfig)
        assert (config.robot, config.human, config.task, config.reward) == (
            run.robot,
            run.human,
            run.task,
            run.reward,
        )
        assert config.output == str(tmp_path / "eval")
    config = compose("evaluate", [override("policy", tmp_path), "human=still", "task.max_step_deg=1"])
    assert isinstance(config, EvaluateConfig)
    assert (config.human.motion, config.human.clipping) == ("still", "full")
    assert (config.task.name, config.task.max_step_deg) == ("place", 1.0)


def test_policies_of_a_chain_are_named_by_subtask():
    config = compose(
        "evaluate", ["task=cycle", "meta=scripted", "policies.pick=a/b.pt", "policies.place=expert"]
    )
    assert isinstance(config, EvaluateConfig)
    assert config.policies == {"pick": "a/b.pt", "place": "expert"}
    assert config.output == "runs/evaluate/cycle/chain"


@pytest.mark.parametrize(
    "value", ["a b", "it's", "x=1,2", "C:\\runs", "a\\", "\\'b", "[]", "${x}", "", "null ", "ü"]
)
def test_text_from_python_reaches_the_configuration_unchanged(value):
    refused = {"${x}": "'x' not found", "": "initial_policy='' is empty"}
    if value in refused:
        with pytest.raises(ConfigError, match=refused[value]):
            trained(override("initial_policy", value))
    else:
        assert trained(override("initial_policy", value)).initial_policy == value


def test_numbers_lists_and_flags_from_python_keep_their_type():
    config = trained(
        override("human.masked", True), override("agent.hidden", [8, 4]), override("agent.tau", 1e-6)
    )
    assert (config.human.masked, config.agent.hidden, config.agent.tau) == (True, [8, 4], 1e-6)
    assert trained(override("resume", None)).resume is None


def test_load_passes_choices_on_to_the_environment(monkeypatch):
    seen = {}
    dm = type(sys)("dm")
    dm.make_environment = lambda config, seed: seen.update(config=config, seed=seed)
    monkeypatch.setitem(sys.modules, "hrl_comfort.envs.dm", dm)
    hrl_comfort.load("place", seed=4, human="arc", **{"human.speed_m_s": 1.0})
    assert (seen["seed"], seen["config"].task.name) == (4, "place")
    assert (seen["config"].human.motion, seen["config"].human.speed_m_s) == ("arc", 1.0)
    with pytest.raises(ConfigError, match="did you mean arc"):
        hrl_comfort.load("place", human="ark")


def test_a_missing_conf_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(composing, "__file__", str(tmp_path / "compose.py"))
    with pytest.raises(ConfigError, match="conf/ is neither in"):
        config_dir()


def test_a_sweep_gives_each_job_its_folder_and_reports_the_failing_one(tmp_path, monkeypatch, capsys):
    def run(overrides: list[str]) -> None:
        config = compose("evaluate", overrides)
        assert isinstance(config, EvaluateConfig)
        if config.policy == "bad":
            raise FileNotFoundError("bad holds\nno run")
        (Path(config.output) / "done.txt").write_text(str(config.policy))

    monkeypatch.setitem(commands.RUN, "evaluate", run)
    words = ["evaluate", "-m", "policy=a,bad,b", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 1
    out, error = capsys.readouterr()
    assert "failed: policy=bad: bad holds no run" in out
    assert f"done: policy=a: {tmp_path}/0\n" in out
    assert error == "hrl-comfort: 1 of 3 jobs failed\n"
    assert [job.state for job in find_jobs(tmp_path).values()] == ["done", "failed", "done"]
    assert planned(tmp_path) == [job.overrides for job in find_jobs(tmp_path).values()]
    assert [(tmp_path / job / "done.txt").read_text() for job in ("0", "2")] == ["a", "b"]


def test_a_report_takes_a_folder_by_itself(tmp_path, capsys):
    assert commands.main(["report", str(tmp_path)]) == 1
    assert f"run={str(tmp_path)!r} holds no run" in capsys.readouterr().err


def test_a_sweep_names_its_folders_as_asked(tmp_path, monkeypatch, capsys):
    def run(overrides: list[str]) -> None:
        (Path(compose("evaluate", overrides).output) / "done.txt").write_text("done")

    monkeypatch.setitem(commands.RUN, "evaluate", run)
    where = f"output={tmp_path}/sweep/level_${{comfort.level}}"
    words = ["comfort=conditioned", "comfort.source=fixed", "comfort.level=range(1,3)", "policy=a"]
    assert commands.main(["evaluate", "-m", *words, where, "hydra.launcher.n_jobs=1"]) == 0
    assert sorted(path.parent.name for path in (tmp_path / "sweep").glob("*/done.txt")) == [
        "level_1",
        "level_2",
    ]


def test_a_sweep_that_is_started_again_does_only_what_is_left(tmp_path, monkeypatch, capsys):
    ran = []

    def run(overrides: list[str]) -> None:
        resumed = [line.split("=", 1)[1].strip("'") for line in overrides if line.startswith("resume=")]
        if resumed:
            ran.append(f"on {Path(resumed[0]).name}")
            return
        config = compose("train", overrides)
        folder = Path(config.output)
        ran.append(f"from the start {folder.name}")
        save_config(config, folder / "config.yaml")
        (folder / "provenance.json").write_text(f'{{"finished": {str(config.train_seed == 0).lower()}}}')
        if config.train_seed == 1:
            (folder / "checkpoints").mkdir(parents=True)
            (folder / "checkpoints" / "latest.pt").touch()

    monkeypatch.setitem(commands.RUN, "train", run)
    words = ["train", "-m", "train_seed=0,1,2", f"output={tmp_path}", "hydra.launcher.n_jobs=1"]
    assert commands.main(words) == 0
    capsys.readouterr()
    assert commands.main(words) == 0
    assert ran == [*(f"from the start {k}" for k in range(3)), "on 1", "from the start 2"]
    out = capsys.readouterr().out
    assert [line.split(":")[0] for line in out.splitlines()] == ["skipped, finished", "resumed", "done"]

    assert commands.main([*words, "agent.decisions=7"]) == 1  # another run by the same name
    assert "holds another run; choose another, or delete it" in capsys.readouterr().out
    assert all("agent.decisions=7" not in job.overrides for job in find_jobs(tmp_path).values())


def test_an_evaluation_is_done_again_where_its_policy_is_newer(tmp_path):
    policy, folder = tmp_path / "policy.pt", tmp_path / "eval"
    policy.touch()
    config = compose("evaluate", [f"policy={policy}", f"output={folder}"])
    assert left(config) is Left.ALL
    save_config(config, folder / "config.yaml")
    assert left(config) is Left.ALL  # it was stopped
    (folder / "summary.json").touch()
    os.utime(policy, (1, 1))
    assert left(config) is Left.NOTHING
    assert left(compose("evaluate", [f"policy={policy}", f"output={folder}", "episodes=7"])) is Left.ALL
    os.utime(folder / "summary.json", (0, 0))
    assert left(config) is Left.ALL


def test_an_evaluation_is_done_again_where_its_controller_is_newer(tmp_path):
    controller, folder = tmp_path / "meta", tmp_path / "eval"
    controller.mkdir()
    (controller / "meta.pt").touch()
    overrides = ["task=sort", "meta=learned", f"policies.meta={controller}", f"output={folder}"]
    config = compose("evaluate", overrides)
    save_config(config, folder / "config.yaml")
    (folder / "summary.json").touch()
    os.utime(controller / "meta.pt", (1, 1))
    assert left(config) is Left.NOTHING
    os.utime(folder / "summary.json", (0, 0))
    assert left(config) is Left.ALL


def test_a_controllers_configuration_from_before_disturbances_loads(tmp_path):
    save_config(compose("train_meta"), tmp_path / "config.yaml")
    older = OmegaConf.load(tmp_path / "config.yaml")
    del older["disturbance"]
    OmegaConf.save(older, tmp_path / "config.yaml")
    assert load_config(tmp_path).disturbance == "none"


def test_a_sweep_runs_in_processes_of_its_own(tmp_path, capsys):
    assert (
        commands.main(
            ["evaluate", "-m", "policy=/no/a,/no/b", f"output={tmp_path}", "hydra.launcher.n_jobs=2"]
        )
        == 1
    )
    out = capsys.readouterr().out
    assert [line.split(":")[1].strip() for line in out.splitlines()] == ["policy=/no/a", "policy=/no/b"]
    assert "/no/a" in out.splitlines()[0].split(": ", 2)[2]
