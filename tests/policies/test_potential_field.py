"""The potential field solves the tasks, heeds the level, and is a function of the state."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.load import make_policy
from hrl_comfort.policies.potential_field import PotentialField
from hrl_comfort.sim.engine import Engine

EPISODES = 16
SEED = 800_000
COARSE = ("task.precision.grasp_tolerance_m=0.3", "task.precision.place_tolerance_m=0.3")


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", list(overrides)))


def at_level(level: int) -> list[str]:
    return ["comfort=conditioned", "comfort.source=fixed", f"comfort.level={level}"]


def success_and_distance(config: EnvConfig) -> tuple[float, float]:
    """Return the share of training episodes solved and their mean distance from tool to person, m."""
    engine = Engine(config, EPISODES, SEED)
    state, field = engine.reset(), PotentialField(engine.scene, config, engine.episodes.subtask)
    executor, solved = torch.ones(EPISODES, dtype=torch.bool), 0
    passed, count = torch.zeros(EPISODES), torch.zeros(EPISODES)
    while executor.any():
        action = np.zeros((EPISODES, 6))
        action[executor.numpy()] = field.act(state.rows(executor)).numpy()
        outcome = engine.step(action)
        counted = outcome.valid & executor[:, None]
        passed += (outcome.human_distance * counted).sum(dim=1)
        count += counted.sum(dim=1)
        solved += int((outcome.success & executor).sum())
        state, executor = outcome.state, executor & ~outcome.done
    engine.close()
    return solved / EPISODES, float((passed / count).mean())


def test_field_stays_farther_at_level_1_than_at_level_10_and_succeeds_at_both() -> None:
    cautious, easy = (
        success_and_distance(configured("task=pick_place", *COARSE, *at_level(level))) for level in (1, 10)
    )
    assert min(cautious[0], easy[0]) >= 0.85
    assert cautious[1] > easy[1] + 0.04


@pytest.mark.parametrize("robot", [("robot=ur3e",), ("robot=jaco", "task.max_step_deg=0.72")])
def test_field_solves_pick_beside_nobody(robot: tuple[str, ...]) -> None:
    assert success_and_distance(configured("task=pick", "human=none", *robot))[0] == 1.0


def test_field_brings_a_cycle_home() -> None:
    assert success_and_distance(configured("task=cycle", *COARSE, *at_level(5)))[0] >= 0.85


def test_field_acts_alike_whatever_rows_are_beside_it() -> None:
    config = configured("task=pick_place", *at_level(1))
    engine = Engine(config, 6, SEED)
    state = engine.reset()
    field = PotentialField(engine.scene, config, engine.episodes.subtask)
    together = field.act(state)
    alone = torch.cat([field.act(state.rows(torch.tensor([row]))) for row in reversed(range(6))]).flip(0)
    assert 0.5 < together.abs().amax() <= 1.0
    torch.testing.assert_close(together, alone, atol=1e-9, rtol=0)


def test_without_a_level_field_acts_as_at_the_middle_of_the_range() -> None:
    config = configured("task=pick")
    engine = Engine(config, 4, SEED)
    state = engine.reset()
    field = PotentialField(engine.scene, config, engine.episodes.subtask)
    # Beside the tool, so that the radius tells.
    state = state.with_(humans_pos=state.tcp_pos[:, None, :2] + torch.tensor([-0.4, 0.3]))
    assert state.level.isnan().all()
    levels = {
        level: field.act(state.with_(level=torch.full((4,), level, dtype=torch.float64))) for level in (1.0, 5.5, 10.0)
    }
    torch.testing.assert_close(field.act(state), levels[5.5], atol=0, rtol=0)
    assert not torch.allclose(levels[1.0], levels[10.0])


def test_where_speed_counts_the_field_goes_no_faster_than_is_at_ease() -> None:
    def fastest(*overrides: str) -> float:
        config = configured("task=pick_place", *COARSE, *overrides, "comfort.beta=1")
        engine = Engine(config, EPISODES, SEED)
        action = PotentialField(engine.scene, config, engine.episodes.subtask).act(engine.reset())
        engine.close()
        return float(action.abs().max())

    assert 0.2 < fastest(*at_level(3)) <= 0.3 + 1e-9
    assert fastest() > 0.9, "nobody has said how much is at ease"


def test_field_pushes_from_the_person_only_within_its_radius() -> None:
    config = configured("task=pick")
    engine = Engine(config, 1, SEED)
    field = PotentialField(engine.scene, config, engine.episodes.subtask)
    tool, goal, person = np.array([0.3, 0.0, 0.5]), np.array([0.3, 0.0, -0.5]), np.array([1.0, 0.0])
    beyond, within = (field.displacement(tool, goal, person, radius, 0.0) for radius in (0.69, 1.2))
    assert beyond[0] == pytest.approx(0.0, abs=1e-12)
    assert within[0] < -0.01


def test_a_preferred_distance_of_nothing_is_no_push_at_all() -> None:
    config = configured("task=pick", *at_level(10), "comfort.min_m=0")
    engine = Engine(config, 2, SEED)
    state, field = engine.reset(), PotentialField(engine.scene, config, engine.episodes.subtask)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        action = field.act(state)
    assert action.isfinite().all() and action.abs().amax() > 0.5


def test_field_refuses_cartesian_actions() -> None:
    config = configured("task=pick")
    engine = Engine(config, 1, SEED)
    cartesian = replace(config, task=replace(config.task, action="cartesian"))
    with pytest.raises(ConfigError, match=r"task\.action"):
        PotentialField(engine.scene, cartesian, engine.episodes.subtask)


def test_field_is_a_policy_and_is_named_where_another_is_asked_for() -> None:
    config = configured("task=pick")
    engine = Engine(config, 2, SEED)
    act = make_policy("potential_field", engine.episodes.subtask, engine.scene, config, 0)
    assert act(engine.reset()).shape == (2, 6)
    with pytest.raises(ConfigError, match="potential_field"):
        make_policy("no/such", engine.episodes.subtask, engine.scene, config, 0)
