"""Predictive sampling solves the cycle by a rated arm, heeds the level, and is a function of the state."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.load import make_policy
from hrl_comfort.policies.predictive_sampling import HORIZON, PredictiveSampling
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.sim.engine import Engine

ROWS = 8
RATED = ("robot.rating=collaborative", "safety=ssm", "task.terminate_on=unsafe_contact", "task.arrival_speed_rad_s=0.5")


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", [*RATED, *overrides]))


def at_level(level: int) -> list[str]:
    return ["comfort=distance_and_speed", "comfort.source=fixed", f"comfort.level={level}"]


def solved_and_measured(config: EnvConfig) -> tuple[float, float, float]:
    """Return the share of training episodes solved, the mean distance of arm and person, m, and the mean decisions."""
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
    assert min(cautious[0], easy[0]) >= 0.85
    assert cautious[1] > easy[1] + 0.02
    assert cautious[2] > 1.5 * easy[2]


def test_it_plans_the_set_points_that_a_rated_arm_gets_beside_nobody() -> None:
    config = configured("task=pick", "human=none", "safety=none")
    engine = Engine(config, ROWS, 800_000)
    state = engine.reset()
    policy = PredictiveSampling(engine.scene, config, engine.episodes.subtask)
    motions = np.full((ROWS, 1, HORIZON, 6), 1.0) * np.linspace(0.2, 1.0, 6)
    planned = policy.targets(state, motions)
    for decision in range(2):
        state = engine.step(motions[:, 0, decision]).state
        at = (decision + 1) * config.task.action_repeat - 1
        np.testing.assert_allclose(planned[:, 0, at], state.joint_target.numpy(), atol=1e-9)
    engine.close()


def test_it_leaves_a_person_whom_it_touches() -> None:
    config = configured("task=pick", "human=still", "safety=none")
    engine = Engine(config, ROWS, 800_000, measure_arm=True)
    state = engine.reset()
    beside = state.tcp_pos[:, :2] + 0.1
    policy = PredictiveSampling(engine.scene, config, engine.episodes.subtask)
    action = policy.act(state.with_(humans_pos=beside[:, None]))
    gaps = []
    for moved in (torch.zeros_like(action), action):
        joints = state.joint_pos + moved * np.radians(config.task.max_step_deg) * config.task.action_repeat
        limbs = limb_poses(*beside.T.numpy(), state.humans_yaw[:, 0].numpy(), 0.0, 0.0, engine.scene.floor_z)
        gaps.append(Separation(engine.scene).gap(joints.numpy(), limbs))
    assert (gaps[0] < 0).all()
    assert (gaps[1] > gaps[0]).all()
    engine.close()


def test_without_a_person_a_low_level_is_no_reason_to_be_slow() -> None:
    config = configured("task=pick", "human=none", *at_level(1))
    engine = Engine(config, ROWS, 800_000)
    state = engine.reset()
    for name in ("predictive_sampling", "expert"):
        act = make_policy(name, engine.episodes.subtask, engine.scene, config, 0)
        assert act(state).abs().amax() == pytest.approx(1.0)
    engine.close()


def test_it_is_a_function_of_each_row() -> None:
    config = configured("task=pick", *at_level(5))
    engine = Engine(config, ROWS, 800_000)
    state, act = engine.reset(), make_policy("predictive_sampling", engine.episodes.subtask, engine.scene, config, 0)
    fresh = make_policy("predictive_sampling", engine.episodes.subtask, engine.scene, config, 0)
    other, together = fresh(state.rows(torch.tensor([5, 3]))), act(state)
    again = torch.cat([together[:3], other[1:], together[4:5], other[:1], together[6:]])
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
