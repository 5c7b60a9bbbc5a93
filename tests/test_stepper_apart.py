"""Cells in a process of their own: the same training, which ends them and says when they have ended."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.__main__ import main
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments import train_cell as train_cell_module
from hrl_comfort.experiments.own_process import COMMAND, KilledError, same_paths
from hrl_comfort.experiments.stepper_apart import StepperApart
from hrl_comfort.experiments.stepper_main import ALONE, _sent
from hrl_comfort.experiments.stepper_process import StepperProcess
from hrl_comfort.experiments.train import Training
from hrl_comfort.experiments.train_cell import train_cell
from tests.point_env import SMALL, small_config
from tests.stopping import stopping

CHOICES = (
    "task=pick_place", "human=random_walk", "comfort=conditioned", "agent.guide=field", "agent.guided_rows=2",
    "engine.rows=4", "agent.decisions=120", "agent.warmup_decisions=16", "agent.log_every=40",
    "agent.checkpoint_every=40", "agent.cells_apart=true", "task.limit_steps=30",
)  # fmt: skip
ACTION = torch.zeros(4, 6)


def ends(group: int) -> bool:
    """Return whether every process of a group is over, soon."""
    for _ in range(3000):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.01)
    return False


def config_of(folder: Path, *overrides: str) -> TrainConfig:
    return small_config(folder, *CHOICES, *overrides)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that steps its cells itself."""
    return train_cell(config_of(tmp_path_factory.mktemp("runs") / "whole", "agent.cells_apart=false"))


def apart_in(folder: Path) -> StepperApart:
    return StepperApart(config_of(folder), StepperProcess())


@pytest.fixture
def apart(tmp_path: Path) -> StepperApart:
    return apart_in(tmp_path)


def test_a_training_is_the_same_to_the_bit_wherever_its_cells_are_stepped(whole, tmp_path):
    folder = train_cell(config_of(tmp_path / "apart"))
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_training_goes_on_wherever_its_cells_were_stepped(whole, tmp_path):
    folder = tmp_path / "half"
    with stopping(Training, "take_in", lambda training: training.decisions >= 60):
        train_cell(config_of(folder))
    train_cell(replace(config_of(tmp_path / "unused"), resume=str(folder)))
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_the_process_ends_with_the_training_even_while_it_steps(tmp_path, capfd):
    apart = apart_in(tmp_path)
    process = apart._process.process
    apart.reset(0.3)
    apart.start(ACTION, 0.3)
    assert process.poll() is None
    del apart
    assert process.poll() == -signal.SIGKILL
    assert "Traceback" not in capfd.readouterr().err


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[StepperProcess]:
    """The processes that the command line begins; trainings begin no others."""
    processes: list[StepperProcess] = []

    def begin() -> StepperProcess:
        processes.append(StepperProcess())
        return processes[-1]

    monkeypatch.setattr("hrl_comfort.__main__.StepperProcess", begin)
    monkeypatch.setattr(train_cell_module, "StepperProcess", None)
    return processes


def test_the_command_begins_the_process_that_its_training_then_uses(whole, tmp_path, begun):
    folder = tmp_path / "apart"
    assert main(["train", *SMALL, *CHOICES, f"output={folder}"]) == 0
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    assert [process.process.poll() for process in begun] == [-signal.SIGKILL]


def test_the_process_ends_with_a_command_that_never_gets_to_it(whole, begun, capsys):
    assert main(["train", *SMALL, *CHOICES, f"output={whole}"]) == 1
    assert [process.process.poll() for process in begun] == [-signal.SIGKILL]


def test_no_process_begins_for_cells_that_are_not_apart(tmp_path, begun):
    words = [*SMALL, *CHOICES, "agent.cells_apart=false", f"output={tmp_path / 'here'}"]
    assert main(["train", *words]) == 0
    assert not begun


def test_the_process_ends_while_it_imports_should_whoever_began_it_be_gone():
    begun = StepperProcess()
    assert begun.process.stdin is not None
    begun.process.stdin.close()
    assert begun.process.wait(60) == ALONE


@pytest.mark.parametrize(
    ("choices", "problem"),
    [
        (["agent.guide=nobody"], "agent.guide=nobody: policy='nobody' is not there"),
        (["agent.successor=nobody"], "agent.successor=nobody: nobody: no such file"),
        (["agent.guide=expert", "human=none", "cell.ball_m=[-1.3,-0.07,0.287]"], "no posture found"),
    ],
)
def test_what_goes_wrong_in_the_process_is_raised_here(tmp_path, choices, problem):
    with pytest.raises(ConfigError, match=problem):
        train_cell(config_of(tmp_path / "run", *choices))


def test_an_error_that_cannot_be_sent_arrives_by_name():
    class Odd(Exception):
        def __init__(self, one: str, other: str) -> None:
            super().__init__(f"{one} {other}")

    assert str(_sent(Odd("quite", "odd"))) == "Odd: quite odd"
    assert isinstance(_sent(ConfigError("no")), ConfigError)


def test_the_process_runs_this_code_wherever_the_command_is_given(tmp_path, monkeypatch):
    (tmp_path / "torch.py").write_text("raise SystemExit('not this one')")
    (tmp_path / "hrl_comfort").mkdir()
    monkeypatch.chdir(tmp_path)
    steps = apart_in(tmp_path / "run")
    assert steps.shape.rows == 4
    steps.close()


def test_a_command_told_to_stop_leaves_a_checkpoint_and_no_process(whole, tmp_path):
    folder = tmp_path / "stopped"
    words = [*SMALL, *CHOICES, f"output='{folder}'"]
    command = [*COMMAND, "train", *words]
    started = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True, env=same_paths()
    )
    while not (folder / "checkpoints" / "latest.pt").exists():
        assert started.poll() is None
        time.sleep(0.01)
    os.killpg(started.pid, signal.SIGTERM)
    _, said = started.communicate()
    assert started.returncode == 128 + signal.SIGTERM, said
    assert "stopped by SIGTERM; go on with resume=" in said and "Traceback" not in said
    assert ends(started.pid)
    train_cell(replace(config_of(tmp_path / "unused"), resume=str(folder)))
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_told_to_stop_the_process_still_finishes_the_decision_under_way(apart):
    apart.reset(0.3)
    for _ in range(2):
        apart.start(ACTION, 0.3)
        for number in (signal.SIGTERM, signal.SIGINT):
            os.kill(apart._process.process.pid, number)
        assert apart.finish().observation.shape == (4, apart.shape.observation_dim)
    assert "env" in apart.state_dict()


def test_a_process_that_was_killed_is_named(apart):
    apart.reset(0.3)
    apart._process.process.kill()
    with pytest.raises(KilledError, match="the process of the cells was ended by SIGKILL"):
        apart.state_dict()
