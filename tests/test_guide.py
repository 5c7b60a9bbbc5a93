"""A guide has a process of its own, which ends with the training and says when it cannot go on."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from hrl_comfort.compose import environment
from hrl_comfort.config import ConfigError
from hrl_comfort.experiments.guide import ActsApart
from hrl_comfort.experiments.train_cell import train_cell
from hrl_comfort.sim.engine import Engine
from tests.point_env import small_config

GUIDED = ("task=pick_place", "agent.guide=field", "agent.guided_rows=2", "engine.rows=4")


@pytest.fixture
def apart(tmp_path: Path) -> ActsApart:
    return ActsApart(small_config(tmp_path, *GUIDED))


def test_the_process_of_a_guide_ends_with_the_training_even_while_it_thinks(tmp_path, capfd):
    guide = ActsApart(small_config(tmp_path, *GUIDED))
    process = guide._process
    guide(Engine(environment(small_config(tmp_path, *GUIDED)), 2, 0).reset())
    assert process.poll() is None
    del guide
    assert process.poll() == -signal.SIGKILL
    assert "Traceback" not in capfd.readouterr().err


def test_a_training_beside_its_guide_is_the_one_that_waits_for_it(tmp_path, monkeypatch):
    choices = (*GUIDED, "agent.decisions=80", "agent.warmup_decisions=0", "agent.log_every=40")
    apart = train_cell(small_config(tmp_path / "apart", *choices))
    monkeypatch.setattr("hrl_comfort.experiments.train_cell.SLOW", ())
    here = train_cell(small_config(tmp_path / "here", *choices))
    assert (apart / "metrics.csv").read_bytes() == (here / "metrics.csv").read_bytes()


def test_what_goes_wrong_in_the_process_of_a_guide_is_raised_here(tmp_path):
    choices = ("task=pick", "human=none", "agent.guide=expert", "agent.guided_rows=2", "engine.rows=4")
    config = small_config(tmp_path, *choices, "cell.ball_m=[-1.3,-0.07,0.287]")
    state = Engine(environment(config), 2, 0).reset()
    with pytest.raises(ConfigError, match="no posture found"):
        ActsApart(config)(state)()


def test_a_guide_told_to_stop_still_acts_for_the_decision_under_way(apart, tmp_path):
    state = Engine(environment(small_config(tmp_path, *GUIDED)), 2, 0).reset()
    for _ in range(2):
        for number in (signal.SIGTERM, signal.SIGINT):
            os.kill(apart._process.pid, number)
        assert apart(state)().shape == (2, 6)


def test_a_guide_whose_process_was_killed_says_so(apart, tmp_path):
    state = Engine(environment(small_config(tmp_path, *GUIDED)), 2, 0).reset()
    apart._process.kill()
    with pytest.raises(RuntimeError, match="the process of the guide has ended, with exit code -9"):
        apart(state)()
