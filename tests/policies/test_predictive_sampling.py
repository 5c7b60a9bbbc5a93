"""Predictive sampling solves the cycle by a rated arm, heeds the level, and is a function of the state."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.config.compose import compose, environment
from hrl_comfort.policies.load import make_policy
from hrl_comfort.policies.predictive_sampling import HORIZON, PredictiveSampling
from hrl_comfort.sim.engine import Engine

ROWS = 8
RATED = ("robot.rating=collaborative", "safety=ssm", "task.terminate_on=unsafe_contact", "task.arrival_speed_rad_s=0.5")


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", [*RATED, *overrides]))


def at_level(level: int) -> list[str]:
    return ["comfort=distance_and_speed", "comfort.source=fixed", f"comfort.level={level}"]


def solved_and_measured(config: EnvConfig) -> tuple[float, float, float]:
    """Return the share of training episodes solved, their mean distance of arm and person, m, and their mean steps."""
    engine = Engine(config, ROWS, 800_000, measure_arm=True)
    state, policy = engine.reset(), PredictiveSampling(engine.scene, config, engine.episodes.subtask)
    running, solved = torch.ones(ROWS, dtype=torch.bool), 0
    apart, count = 0.0, 0
    while running.any():
        action = np.zeros((ROWS, len(engine.scene.home)))
        action[running.numpy()] = policy.act(state.rows(running)).numpy()
        result = engine.step(action)
        apart += float(result.state.arm_distance[running].sum())
        count += int(running.sum())
        solved += int((result.success & running).sum())
        state, running = result.state, running & ~result.done
    engine.close()
    return solved / ROWS, apart / count, count / ROWS


def test_it_solves_the_cycle_beside_nobody() -> None:
    assert solved_and_measured(configured("task=cycle", "human=none"))[0] == 1.0


def test_it_is_slower_and_farther_from_a_person_at_level_1_than_at_level_10() -> None:
    cautious, easy = (solved_and_measured(configured("task=pick", "human=patrol", *at_level(n))) for n in (1, 10))
    assert easy[0] >= 0.85
    assert cautious[1] > easy[1]
    assert cautious[2] > 1.5 * easy[2]


def test_it_is_a_function_of_each_row() -> None:
    config = configured("task=pick", *at_level(5))
    engine = Engine(config, ROWS, 800_000)
    state, act = engine.reset(), make_policy("predictive_sampling", engine.episodes.subtask, engine.scene, config, 0)
    together, again = act(state), act(state)
    torch.testing.assert_close(together, again, rtol=0, atol=0)
    torch.testing.assert_close(act(state.rows(torch.tensor([3]))), together[3:4], rtol=0, atol=1e-12)
    engine.close()


def test_motions_end_at_rest_and_stay_within_the_bounds() -> None:
    config = configured("task=pick")
    engine = Engine(config, ROWS, 800_000)
    policy = PredictiveSampling(engine.scene, config, engine.episodes.subtask)
    motions = policy.motions(np.zeros((2, 6)), np.ones((2, 4, 6)))
    assert motions.shape[2] == HORIZON
    assert np.abs(motions).max() <= 1.0
    assert not motions[:, :, -1].any()
    engine.close()


def test_other_actions_than_joint_increments_are_refused() -> None:
    config = configured("task=pick")
    engine = Engine(config, 1, 0)
    cartesian = environment(compose("train", ["task=pick", "task.action=cartesian"]))
    with pytest.raises(ConfigError, match="predictive_sampling"):
        make_policy("predictive_sampling", engine.episodes.subtask, engine.scene, cartesian, 0)
    engine.close()
