"""The scripted expert solves what the policies are asked to."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.compose import compose, environment
from hrl_comfort.config import ConfigError
from hrl_comfort.people import load_evaluation_set
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.expert import Expert

EPISODES = 12


@pytest.mark.parametrize("task", ["pick", "return", "pick_place", "cycle"])
def test_expert_succeeds_beside_a_random_walk(task: str) -> None:
    config = environment(compose("train", [f"task={task}"]))
    engine = Engine(config, EPISODES, 0, load_evaluation_set().part(0, EPISODES))
    expert = Expert(engine.scene, config, engine.episodes.subtask)
    state = engine.reset()
    success = torch.zeros(EPISODES, dtype=torch.bool)
    over = success.clone()
    while not over.all():
        action = expert.act(state)
        assert action.abs().max() <= 1.0 + 1e-9
        outcome = engine.step(action.numpy())
        success |= outcome.success & ~over
        over |= outcome.done
        state = outcome.state
    assert np.mean(success.numpy()) >= 0.9


def test_expert_is_a_function_of_the_state() -> None:
    config = environment(compose("train", ["task=pick"]))
    engine = Engine(config, 4, 0)
    expert = Expert(engine.scene, config, engine.episodes.subtask)
    state = engine.reset()
    rows = torch.tensor([2, 0])
    torch.testing.assert_close(expert.act(state)[rows], expert.act(state.rows(rows)))


def test_expert_refuses_a_cartesian_action_by_name() -> None:
    config = environment(compose("train", ["task=pick", "task.action=cartesian"]))
    engine = Engine(config, 1, 0)
    with pytest.raises(ConfigError, match=r"task\.action"):
        Expert(engine.scene, config, engine.episodes.subtask)
