"""A controller's training that was stopped goes on to the same bits, or is refused in one line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, MetaControllerTrainConfig
from hrl_comfort.files.provenance import read_provenance, resumable
from hrl_comfort.files.sweep_record import find_jobs
from hrl_comfort.hierarchy.tops import RULES
from hrl_comfort.sweeps.subprocesses import run_in_subprocess
from hrl_comfort.training import loop as module
from hrl_comfort.training.controller_trainer import ControllerTraining, train_meta_controller
from hrl_comfort.training.preemption import Preempted
from tests.stopping import stopping

CHOICES = (  # beside people the experts would deliberate for most of the time
    "task.objects=2", "human=none", "engine.num_envs=4",
    "meta_controller_agent.options=48", "meta_controller_agent.warmup_options=8",
    "meta_controller_agent.batch_size=8", "meta_controller_agent.log_every=12", "meta_controller_agent.buffer_size=40",
    *(f"policies.{name}=expert" for name in ("pick", "place", "return")),
)  # fmt: skip


def config_of(folder: Path, *more: str) -> MetaControllerTrainConfig:
    config = compose("train_meta_controller", [*CHOICES, *more, f"output='{folder}'"])
    assert isinstance(config, MetaControllerTrainConfig)
    return config


def resumed(folder: Path) -> MetaControllerTrainConfig:
    return replace(config_of(folder), resume=str(folder))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that nobody stopped."""
    return train_meta_controller(config_of(tmp_path_factory.mktemp("runs") / "whole"))


def same(one: Path, other: Path) -> bool:
    """Return whether two finished trainings came to the same bits."""
    networks = [checkpoint.load(folder / "meta_controller.pt")["network"] for folder in (one, other)]
    tensors = [torch.equal(networks[0][name], networks[1][name]) for name in networks[0]]
    rows = [(folder / "meta_controller_metrics.csv").read_bytes() for folder in (one, other)]
    return all(tensors) and rows[0] == rows[1]


def test_a_shift_that_is_over_has_succeeded_and_counts_all_that_was_placed(tmp_path: Path) -> None:
    direct = (f"policies.{name}=direct" for name in ("pick", "place", "return"))
    config = config_of(tmp_path / "run", "task=shift", "task.max_episode_steps=900", "engine.num_envs=2", *direct)
    collector, over = ControllerTraining(config, tmp_path, resumes=False).collector, []
    while not over:
        over = collector.step(RULES["nearest"](collector.env.decision)).finished
    assert over[0]["success"] == 1.0 and over[0]["placed"] >= 2


@pytest.mark.parametrize("at", [14, 25, 40])
def test_a_controllers_training_that_was_killed_goes_on_to_the_same_bits(whole, tmp_path, at):
    folder = tmp_path / "run"
    with stopping(ControllerTraining, "step", lambda training: training.steps >= at):
        train_meta_controller(config_of(folder))
    train_meta_controller(resumed(folder))
    assert same(folder, whole)
    assert read_provenance(folder).finished and not resumable(folder)


def test_a_controllers_training_beside_people_that_was_killed_goes_on_to_the_same_bits(tmp_path):
    beside = ("human=patrol", *(f"policies.{name}=potential_field" for name in ("pick", "place", "return")))
    undisturbed = train_meta_controller(config_of(tmp_path / "undisturbed", *beside))
    with stopping(ControllerTraining, "step", lambda training: training.steps >= 25):
        train_meta_controller(config_of(tmp_path / "run", *beside))
    train_meta_controller(replace(config_of(tmp_path / "run", *beside), resume=str(tmp_path / "run")))
    assert same(tmp_path / "run", undisturbed)


RULED = ("meta_controller_agent.rule=due", "meta_controller_agent.rule_envs=3")


def test_a_rule_chooses_in_the_first_environments_and_all_learn_from_it(tmp_path, monkeypatch):
    training = ControllerTraining(config_of(tmp_path / "run", *RULED), tmp_path / "run", resumes=False)
    env, observed = training.collector.env, []
    begin, observe = type(env._process).begin, training.learner.observe

    def began(process, rows, action):
        ruled = rows & (torch.arange(4) < 3)
        assert torch.equal(action[ruled], RULES["due"](env.decision)[ruled])
        begin(process, rows, action)

    monkeypatch.setattr(type(env._process), "begin", began)
    monkeypatch.setattr(training.learner, "observe", lambda seen: (observed.append(seen.clone()), observe(seen)))
    while training.steps < 24:
        training.step()
    seen = torch.cat(observed)
    assert set(seen["row"].tolist()) == {0, 1, 2, 3}
    assert training.collector.ran.sum() == seen["steps_to_next_obs"][seen["row"] == 3].sum()  # the learner's alone
    training.collector.close()


def test_a_training_beside_a_rule_that_was_killed_goes_on_to_the_same_bits(tmp_path):
    undisturbed = train_meta_controller(config_of(tmp_path / "undisturbed", *RULED))
    with stopping(ControllerTraining, "step", lambda training: training.steps >= 25):
        train_meta_controller(config_of(tmp_path / "run", *RULED))
    train_meta_controller(replace(config_of(tmp_path / "run", *RULED), resume=str(tmp_path / "run")))
    assert same(tmp_path / "run", undisturbed)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((RULED[0],), r"rule=due does not go with meta_controller_agent\.rule_envs=0"),
        ((RULED[1],), r"rule=None does not go with meta_controller_agent\.rule_envs=3"),
        ((RULED[0], "meta_controller_agent.rule_envs=4"), r"rule_envs=4 must be below engine\.num_envs=4"),
        ((*RULED, "meta_controller_agent=ppo"), "does not go with meta_controller_agent=ppo"),
        (("meta_controller_agent.rule=learned",), "choose one of nearest, free, due, greedy, cautious, patient"),
    ],
)
def test_rules_that_cannot_demonstrate_are_refused(tmp_path, words, said):
    with pytest.raises(ConfigError, match=said):
        config_of(tmp_path, *words)


def test_a_controllers_training_told_to_stop_goes_on_to_the_same_bits(whole, tmp_path, monkeypatch):
    @contextmanager
    def told_soon() -> Iterator[Callable[[], bool]]:
        asked = iter(range(100))
        yield lambda: next(asked) >= 9

    folder = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(module, "asked_to_stop", told_soon)
        with pytest.raises(Preempted, match="go on with train meta_controller resume="):
            train_meta_controller(config_of(folder))
    assert not read_provenance(folder).finished
    with pytest.raises(ConfigError, match="already holds a run; choose another, or say resume="):
        train_meta_controller(config_of(folder))
    assert main(["train", "meta_controller", f"resume='{folder}'"]) == 0
    assert same(folder, whole)


def test_what_cannot_go_on_is_named(whole, tmp_path, capsys):
    with pytest.raises(ConfigError, match=r"is finished$"):
        train_meta_controller(resumed(whole))
    with pytest.raises(ConfigError, match="is not a run folder"):
        train_meta_controller(resumed(tmp_path / "nobody"))
    assert main(["train", "meta_controller", f"resume='{whole}'", "train_seed=1"]) == 1
    assert "leave out train_seed=1" in capsys.readouterr().err
    assert main(["train", f"resume='{whole}'"]) == 1
    assert f"trains a controller; say train meta_controller resume={whole}" in capsys.readouterr().err


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """The folder of a training killed after its first checkpoint."""
    folder = tmp_path / "run"
    with stopping(ControllerTraining, "step", lambda training: training.steps >= 14):
        train_meta_controller(config_of(folder))
    return folder


@pytest.mark.parametrize(("is_now", "was"), [("  - 32", "  - 128"), ("  objects: 3", "  objects: 2")])
def test_a_checkpoint_of_another_configuration_is_refused_in_one_line(stopped, capsys, is_now, was):
    file = stopped / "config.yaml"
    assert was in file.read_text()
    file.write_text(file.read_text().replace(was, is_now, 1))
    assert main(["train", "meta_controller", f"resume='{stopped}'"]) == 1
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and "its checkpoint does not fit its config.yaml: " in said[0]


def test_a_controller_whose_training_left_nothing_to_go_on_from_may_be_trained_anew(whole, stopped):
    checkpoint.drop_resumable(stopped / "checkpoints")
    (stopped / "meta_controller.pt").write_bytes((whole / "meta_controller.pt").read_bytes())
    train_meta_controller(config_of(stopped))
    assert same(stopped, whole)


def test_a_sweep_of_controllers_goes_on_with_what_was_stopped_and_skips_what_is_finished(whole, tmp_path, capsys):
    words = ["train", "meta_controller", "-m", *CHOICES, "train_seed=0,1", f"output='{tmp_path}'"]
    words.append("hydra.launcher.n_jobs=1")
    with stopping(ControllerTraining, "step", lambda training: training.steps >= 14):
        train_meta_controller(config_of(tmp_path / "0"))
    capsys.readouterr()
    assert main(words) == 0
    out = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in out] == ["resumed", "done"]
    assert same(tmp_path / "0", whole) and not same(tmp_path / "1", whole)
    assert main(["train", "-m", "meta_controller", *words[3:]]) == 0, "-m may stand anywhere"
    out = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in out] == ["skipped, finished"] * 2
    assert [job.verb for job in find_jobs(tmp_path).values()] == ["train meta_controller"] * 2


def test_a_job_with_a_controller_in_its_own_process_says_the_same(tmp_path):
    with pytest.raises(ConfigError, match=r"^meta_controller_agent\.gamma=2\.0 is outside its range"):
        run_in_subprocess("train meta_controller", ["meta_controller_agent.gamma=2", f"output='{tmp_path}'"])
