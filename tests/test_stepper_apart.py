"""Cells in a process of their own: the same training, which ends them and says when they have ended."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments.stepper_apart import StepperApart
from hrl_comfort.experiments.train import Training
from hrl_comfort.experiments.train_cell import train_cell
from tests.point_env import small_config

CHOICES = (
    "task=pick_place", "human=random_walk", "comfort=conditioned", "agent.guide=field", "agent.guided_rows=2",
    "engine.rows=4", "agent.decisions=120", "agent.warmup_decisions=16", "agent.log_every=40",
    "agent.checkpoint_every=40", "agent.cells_apart=true", "task.limit_steps=30",
)  # fmt: skip
ACTION = torch.zeros(4, 6)


def config_of(folder: Path, *overrides: str) -> TrainConfig:
    return small_config(folder, *CHOICES, *overrides)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training that steps its cells itself."""
    return train_cell(config_of(tmp_path_factory.mktemp("runs") / "whole", "agent.cells_apart=false"))


@pytest.fixture
def apart(tmp_path: Path) -> StepperApart:
    return StepperApart(config_of(tmp_path))


def test_a_training_is_the_same_to_the_bit_wherever_its_cells_are_stepped(whole, tmp_path):
    folder = train_cell(config_of(tmp_path / "apart"))
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_training_goes_on_wherever_its_cells_were_stepped(whole, tmp_path, monkeypatch):
    class Stopped(Exception):
        pass

    take_in = Training.take_in

    def until_half(training: Training) -> list[tuple[float, bool]]:
        if training.decisions >= 60:
            raise Stopped
        return take_in(training)

    folder = tmp_path / "half"
    with monkeypatch.context() as patch:
        patch.setattr(Training, "take_in", until_half)
        with pytest.raises(Stopped):
            train_cell(config_of(folder))
    train_cell(replace(config_of(tmp_path / "unused"), resume=str(folder)))
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_the_process_ends_with_the_training_even_while_it_steps(tmp_path, capfd):
    apart = StepperApart(config_of(tmp_path))
    process = apart._process
    apart.reset(0.3)
    apart.start(ACTION, 0.3)
    assert process.poll() is None
    del apart
    assert process.poll() == -signal.SIGKILL
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(
    ("choice", "problem"),
    [
        ("agent.guide=nobody", "agent.guide=nobody: policy='nobody' is not there"),
        ("agent.successor=nobody", "agent.successor=nobody: nobody: no such file"),
    ],
)
def test_what_goes_wrong_in_the_process_is_raised_here(tmp_path, choice, problem):
    with pytest.raises(ConfigError, match=problem):
        train_cell(config_of(tmp_path / "run", choice))


def test_told_to_stop_the_process_still_finishes_the_decision_under_way(apart):
    apart.reset(0.3)
    for _ in range(2):
        apart.start(ACTION, 0.3)
        for number in (signal.SIGTERM, signal.SIGINT):
            os.kill(apart._process.pid, number)
        assert apart.finish().observation.shape == (4, apart.shape.observation_dim)
    assert "env" in apart.state_dict()


def test_a_process_that_was_killed_is_named(apart):
    apart.reset(0.3)
    apart._process.kill()
    with pytest.raises(RuntimeError, match="the process of the cells has ended, with exit code -9"):
        apart.state_dict()
