"""A policy brings its environment: from any working directory, after its run was moved, whatever keys came since."""

from __future__ import annotations

import inspect
import shutil
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
import yaml

import hrl_comfort
import hrl_comfort.gym
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files import state_file, versions
from hrl_comfort.files.documents import read_config
from hrl_comfort.files.run_config import (
    environment,
    load_config,
    save_config,
    trained_environment,
    yaml_of,
)
from hrl_comfort.sb3 import make_vec_env

PICK, PLACE = "hrl_comfort/Pick-v0", "hrl_comfort/Place-v0"
SMALL = [
    "agent.policy_steps=64", "agent.learning_starts=32", "agent.hidden=[8]", "agent.batch_size=8", "agent.log_every=32",
    "agent.checkpoint_every=32", "engine.num_envs=4", "task.max_episode_steps=30", "human=recorded",
    "human.file=walk.csv", "human.clipping=full", "safety=ssm", "robot.rating=collaborative",
    "comfort=distance_and_speed",
]  # fmt: skip


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a walk and, trained from relative paths, runs/demo/pick and runs/demo/place after it."""
    folder = tmp_path_factory.mktemp("project")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("walk.csv").write_text("t,x,y,yaw\n" + "".join(f"{t},{t / 10},1,0\n" for t in range(10)))
        joints = np.zeros((4, 18), dtype=np.float32)
        starts = Path("runs/demo/pick/terminal_states.npz")
        assert main(["train", "task=pick", *SMALL, "output=runs/demo/pick"]) == 0
        np.savez(starts, orange=joints, pink=joints)
        assert main(["train", "task=place", f"task.start={starts}", *SMALL, "output=runs/demo/place"]) == 0
    return folder


@pytest.fixture
def runs(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the project's runs/demo, read from another working directory."""
    shutil.copytree(project, tmp_path / "moved")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return tmp_path / "moved" / "runs" / "demo"


def changed(run: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change what config.yaml and policy.pt of `run` hold of the environment."""
    values = yaml.safe_load((run / "config.yaml").read_text())
    change(values)
    (run / "config.yaml").write_text(yaml.safe_dump(values))
    state = state_file.load(run / "policy.pt")
    change(state["spec"]["config"])
    state_file.save(run / "policy.pt", state)


def alone(run: Path, folder: Path) -> Path:
    """Return a copy of the policy file of `run` without the run, at the same place beside others."""
    shutil.copy(run / "policy.pt", folder / "policy.pt")
    return folder / "policy.pt"


def test_the_six_lines_of_the_page_run_from_another_folder(runs: Path) -> None:
    text = inspect.getdoc(hrl_comfort.load) or ""
    lines = textwrap.dedent("\n".join(line for line in text.splitlines() if line.startswith("    "))).splitlines()
    script = "\n".join(lines[: next(i for i, line in enumerate(lines) if "env.step" in line) + 1])
    assert len(script.splitlines()) == 6 and '"runs/demo/pick"' in script
    names: dict[str, Any] = {}
    exec(script.replace('"runs/demo/pick"', repr(str(runs / "pick"))), names)
    assert names["step"].last()


@pytest.mark.parametrize(("task", "env_id"), [("pick", PICK), ("place", PLACE)])
def test_a_policy_acts_in_the_environment_of_its_run_in_every_front(runs: Path, task: str, env_id: str) -> None:
    run = runs / task
    policy, env = hrl_comfort.load_policy(run), gymnasium.make(env_id, run=run)
    observation, _ = env.reset(seed=0)
    first = env.step(policy(observation))
    dm = hrl_comfort.load(run=run, seed=0, flat_observation=True)
    assert np.allclose(dm.reset().observation["observations"], observation, atol=1e-6)
    assert dm.step(policy(observation)).reward == pytest.approx(first[1])
    cells = gymnasium.make_vec(env_id, num_envs=2, run=run)
    assert cells.step(policy(cells.reset(seed=0)[0]))[1][0] == pytest.approx(first[1])
    assert policy(make_vec_env(env_id, 2, run=run).reset()).shape == (2, 6)
    episodes = hrl_comfort.evaluate(run, episodes=1, human="still")
    assert episodes["task"].tolist() == [task] and episodes["steps"].max() <= 300  # 30 at each of ten levels
    batch = CellEnv(hrl_comfort.environment_of(run=run), 2, seed=0)
    assert np.allclose(batch.reset()["observation"][0].numpy(), observation, atol=1e-6)
    config = load_config(run)
    assert isinstance(config, TrainConfig)
    made = hrl_comfort.environment_of(run=run)
    assert (made.task, made.human, made.safety, made.comfort) == (
        config.task,
        config.human,
        config.safety,
        config.comfort,
    )


def test_overrides_go_on_top_of_a_run(runs: Path) -> None:
    made = hrl_comfort.environment_of(run=runs / "pick", choices={"task.max_episode_steps": 77, "human": "still"})
    assert (made.task.max_episode_steps, made.human.motion, made.human.clipping) == (77, "still", "full")


def test_another_environment_than_that_of_the_run_is_refused_with_the_remedy(runs: Path) -> None:
    policy = hrl_comfort.load_policy(runs / "pick")
    other = hrl_comfort.load("pick", flat_observation=True).reset().observation["observations"]
    with pytest.raises(
        ConfigError, match=r"takes observations of \d+ numbers, not \d+; hrl_comfort.load\(run='.*pick'\)"
    ):
        policy(other)
    with pytest.raises(ConfigError, match="was trained for task=pick, not place"):
        gymnasium.make(PLACE, run=runs / "pick")
    for none in ("expert", "runs/none", str(runs)):
        with pytest.raises(ConfigError, match=r"run='.*' is not the run folder or policy file of a training"):
            hrl_comfort.load(run=none)


def test_an_experiment_is_a_keyword() -> None:
    shielded = hrl_comfort.environment_of("place", {"experiment": "shielded"})
    assert (shielded.task.name, shielded.safety.kind, shielded.task.observation) == ("place", "ssm", "sight")
    comfort = hrl_comfort.environment_of("pick", {"experiment": "comfort"})
    assert comfort == environment(compose("train", ["task=pick", "experiment=comfort"]))


def test_paths_of_a_run_are_relative_to_it(project: Path) -> None:
    config = yaml.safe_load((project / "runs/demo/place/config.yaml").read_text())
    assert (config["output"], config["task"]["start"]) == (".", "../pick/terminal_states.npz")
    assert config["human"]["file"] == "../../../walk.csv"
    spec = state_file.load(project / "runs/demo/place/checkpoints/step_000000064.pt")["spec"]
    assert spec["config"]["task"] == config["task"] and spec["config"]["human"] == config["human"]


def test_a_run_is_evaluated_from_another_folder_after_it_was_moved(runs: Path) -> None:
    assert main(["evaluate", str(runs / "place"), "episodes=2", "record=true"]) == 0
    loaded = load_config(runs / "place" / "eval")
    assert isinstance(loaded, EvaluateConfig)
    assert (loaded.policy, loaded.output) == (str(runs / "place"), str(runs / "place" / "eval"))
    assert read_config(runs / "place" / "eval" / "config.yaml")[1]["policy"] == str(runs / "place")
    starts, walk = runs / "pick" / "terminal_states.npz", runs.parent.parent / "walk.csv"
    assert (loaded.task.start, loaded.human.file) == (str(starts), str(walk))


def test_a_run_behind_a_link_finds_its_files(runs: Path) -> None:
    Path("latest").symlink_to(runs / "place")
    start = hrl_comfort.environment_of(run="latest").task.start
    assert Path(start).resolve() == (runs / "pick" / "terminal_states.npz").resolve()


def test_a_run_from_before_paths_were_relative_to_it_is_read_from_anywhere(runs: Path) -> None:
    config = compose("train", ["task=place", "task.start=runs/demo/pick/terminal_states.npz", "output=runs/demo/place"])
    (runs / "place" / "config.yaml").write_text(yaml.safe_dump(yaml.safe_load(yaml_of(config))))
    loaded = load_config(runs / "place")
    assert isinstance(loaded, TrainConfig) and loaded.task.start == str(runs / "pick" / "terminal_states.npz")


def test_names_and_distant_paths_stay_as_they_are(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b" / "run"
    given = {
        "human.motion": "live", "human.file": "udp://localhost:9", "agent.demonstrator": "expert",
        "agent.demonstrator_envs": 1, "initial_policy": "/data/run", "agent.next_skill": str(folder.parent / "place"),
    }  # fmt: skip
    config = compose("train", [f"{key}={value}" for key, value in given.items()])
    save_config(config, folder / "config.yaml")
    values = yaml.safe_load((folder / "config.yaml").read_text())
    assert values["human"]["file"] == "udp://localhost:9" and values["initial_policy"] == "/data/run"
    assert values["agent"]["demonstrator"] == "expert" and values["agent"]["next_skill"] == "../place"


def test_a_policy_file_alone_brings_its_environment(runs: Path, tmp_path: Path) -> None:
    whole = trained_environment(str(runs / "pick"))
    (runs / "pick" / "config.yaml").unlink()
    for source in (runs / "pick", runs / "pick" / "policy.pt", next((runs / "pick" / "checkpoints").glob("step_*.pt"))):
        assert trained_environment(str(source)) == whole, source
    file = alone(runs / "pick", tmp_path)
    assert main(["evaluate", str(file), "human=still", "episodes=1", "output=out"]) == 0


def test_keys_that_came_since_take_what_conf_says(runs: Path) -> None:
    before = trained_environment(str(runs / "pick")), load_config(runs / "pick")

    def change(values: dict[str, Any]) -> None:
        del values["task"]["terminate_on"], values["randomise"], values["comfort"]["stream"]["stall_s"]
        values.pop("logger", None)

    changed(runs / "pick", change)
    assert (trained_environment(str(runs / "pick")), load_config(runs / "pick")) == before
    (runs / "pick" / "config.yaml").unlink()
    assert trained_environment(str(runs / "pick")) == before[0]


def test_a_key_whose_default_would_change_a_run_takes_its_value_of_before(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(versions.BEFORE, "task.max_step_deg", 0.5)
    changed(runs / "pick", lambda values: values["task"].pop("max_step_deg"))
    assert hrl_comfort.environment_of(run=runs / "pick").task.max_step_deg == 0.5


@pytest.mark.parametrize("with_config", [True, False])
def test_a_key_that_is_gone_is_one_line_unless_it_did_nothing(runs: Path, with_config: bool) -> None:
    key = "human_collision"
    before = trained_environment(str(runs / "pick"))
    changed(runs / "pick", lambda values: values["reward"].update({key: versions.GONE[f"reward.{key}"]}))
    assert trained_environment(str(runs / "pick")) == before
    changed(runs / "pick", lambda values: values["reward"].update({key: -7}))
    if not with_config:
        (runs / "pick" / "config.yaml").unlink()
    with pytest.raises(ConfigError, match=f"reward.{key} is not a key of this version") as error:
        hrl_comfort.load(run=runs / "pick")
    assert str(runs / "pick") in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("config", [5, {}, {"task": {"name": "pick"}}, {"task": torch.zeros(3)}])
def test_a_damaged_environment_in_a_policy_file_is_one_line(runs: Path, config: object) -> None:
    (runs / "pick" / "config.yaml").unlink()
    state = state_file.load(runs / "pick" / "policy.pt")
    state["spec"]["config"] = config
    state_file.save(runs / "pick" / "policy.pt", state)
    with pytest.raises(ConfigError, match=r"policy.pt' is damaged: its config is not that of an environment$"):
        trained_environment(str(runs / "pick"))


def test_an_unfinished_training_says_so(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = runs / "pick" / "provenance.json"
    file.write_text(file.read_text().replace('"finished": true', '"finished": false'))
    said = rf"the training in {runs / 'pick'} is not finished: its policy has 64 policy steps so far"
    with pytest.warns(UserWarning, match=said):
        assert main(["evaluate", str(runs / "pick"), "episodes=1"]) == 0
    with pytest.warns(UserWarning, match=said):
        hrl_comfort.environment_of(run=runs / "pick")
    with pytest.warns(UserWarning, match=said):
        assert main(["report", str(runs / "pick"), "video=false"]) == 0
    assert said in (runs / "pick" / "report.html").read_text()
