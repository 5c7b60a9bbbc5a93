"""A guide has a process of its own, which ends with the training and says when it cannot go on."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from hrl_comfort.compose import environment
from hrl_comfort.experiments.guide import ActsApart
from hrl_comfort.sim.engine import Engine
from tests.point_env import small_config

GUIDED = ("task=pick_place", "agent.guide=field", "agent.guided_rows=2", "engine.rows=4")


@pytest.fixture
def apart(tmp_path: Path) -> ActsApart:
    return ActsApart(small_config(tmp_path, *GUIDED))


def test_the_process_of_a_guide_ends_with_the_training(apart):
    process = apart._process
    assert process.poll() is None
    del apart


def test_a_guide_told_to_stop_still_acts_for_the_decision_under_way(apart, tmp_path):
    state = Engine(environment(small_config(tmp_path, *GUIDED)), 2, 0).reset()
    before = apart(state)()
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(apart._process.pid, number)
    assert (apart(state)() == before).all()


def test_a_guide_whose_process_was_killed_says_so(apart, tmp_path):
    state = Engine(environment(small_config(tmp_path, *GUIDED)), 2, 0).reset()
    apart._process.kill()
    with pytest.raises(RuntimeError, match="the process of the guide has ended, with exit code -9"):
        apart(state)()
