"""The batched engine, held to the dm_control front, and the TorchRL environment over it."""

from __future__ import annotations

import pickle
from copy import copy, deepcopy
from dataclasses import replace
from operator import methodcaller
from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EnvConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans import load_evaluation_set
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import SUBTASKS, State

TASKS = sorted(SUBTASKS)
FIELDS = ("joint_pos", "joint_vel", "joint_target", "tcp_pos", "humans_pos", "humans_yaw", "humans_seen")


def configured(*overrides: str) -> EnvConfig:
    return environment(compose("train", overrides))


def test_the_states_that_terms_get_are_whole_states() -> None:
    engine = Engine(configured("task=pick"), 3, 0)
    start, seen = engine.reset(), list[tuple[State, State]]()
    task = engine.episodes.subtask

    def watched(before: State, after: State) -> torch.Tensor:
        seen.append((before, after))
        return task.rewards["contact"](before, after)

    engine.episodes.referee.subtask = replace(task, rewards={**task.rewards, "contact": watched})
    engine.step(np.ones((3, 6)))
    ((before, after),) = seen
    same = (copy, deepcopy, lambda state: pickle.loads(pickle.dumps(state)), replace, methodcaller("with_"))
    for earlier_state, later_state in ((each(before), each(after)) for each in same):
        for name, value in earlier_state.fields().items():
            steps = getattr(later_state, name)
            earlier = torch.cat([getattr(start, name)[:, None], steps[:, :-1]], dim=1)[:, : value.shape[1]]
            assert value.shape[1] in (1, 5)
            if name != "stage":  # that of the decision
                torch.testing.assert_close(value, earlier, rtol=0, atol=0, equal_nan=True)
    with pytest.raises(AttributeError, match="has no attribute 'kinds_of'"):
        _ = before.kinds_of  # type: ignore[attr-defined]


def test_actions_of_another_shape_and_no_rows_are_refused_at_once() -> None:
    engine = Engine(configured("task=pick"), 3, 0)
    engine.reset()
    for shape in ((1, 6), (3, 5), (6,)):
        with pytest.raises(ValueError, match=r"must have shape \(3, 6\)"):
            engine.step(np.ones(shape))
    with pytest.raises(ValueError, match="name at least one row"):
        engine.step(np.ones((3, 6)), np.array([], dtype=np.int64))
    assert engine.step(np.ones((3, 6))).decision_steps.tolist() == [5, 5, 5]


def test_a_state_of_some_fields_refuses_the_others() -> None:
    changed = State.of(stage=torch.ones(2)).with_(level=torch.full((2,), 3.0))
    assert changed.level.tolist() == [3.0, 3.0] and changed.stage.tolist() == [1.0, 1.0]
    with pytest.raises(AttributeError, match="steps"):
        _ = changed.steps


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("human", ["random_walk", "approach"])
def test_engine_and_dm_control_front_run_one_trajectory(task: str, human: str) -> None:
    config = configured(f"task={task}", f"human={human}")
    front, engine = make_environment(config, 3), Engine(config, 4, 3)
    front.reset()
    engine.reset()
    rng = np.random.default_rng(0)
    for _ in range(40):
        action = rng.uniform(-1, 1, (4, 6))
        step, outcome = front.step(action[0]), engine.step(action)
        theirs, ours = front.task.episodes.state, outcome.state
        for name in FIELDS:
            gap = (getattr(theirs, name)[0] - getattr(ours, name)[0]).abs().max()
            assert gap <= 1e-9, name
        assert abs(step.reward - float(outcome.reward[0])) <= 1e-9
        assert step.last() == bool(outcome.done[0])
        engine.reset(np.flatnonzero(outcome.done.numpy()))
        if step.last():
            front.reset()


def test_cartesian_action_runs_one_trajectory_on_both_fronts() -> None:
    config = configured("task=reach", "task.action=cartesian")
    front, engine = make_environment(config, 0), Engine(config, 2, 0)
    front.reset()
    start = engine.reset().tcp_pos.clone()
    up = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    for _ in range(4):
        front.step(up)
        outcome = engine.step(np.tile(up, (2, 1)))
    torch.testing.assert_close(front.task.episodes.state.tcp_pos[0], outcome.state.tcp_pos[0], rtol=0, atol=1e-9)
    moved = (outcome.state.tcp_pos - start)[0]
    assert moved[2] < -0.02 and moved[2].abs() > moved[:2].abs().max()


def test_an_episode_does_not_depend_on_the_rows_beside_it() -> None:
    config = configured("task=place")
    few, many = Engine(config, 2, 5), Engine(config, 9, 5)
    few.reset()
    many.reset()
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.uniform(-1, 1, (9, 6))
        a, b = few.step(action[:2]), many.step(action)
        torch.testing.assert_close(a.state.tcp_pos, b.state.tcp_pos[:2], rtol=0, atol=0)
        torch.testing.assert_close(a.reward, b.reward[:2], rtol=0, atol=0)


def test_partial_reset_leaves_the_other_rows_alone() -> None:
    engine = Engine(configured("task=pick"), 4, 0)
    engine.reset()
    before = engine.step(np.full((4, 6), 0.2)).state
    after = engine.reset(np.array([1]))
    others = torch.tensor([0, 2, 3])
    torch.testing.assert_close(after.joint_pos[others], before.joint_pos[others], rtol=0, atol=0)
    assert after.steps.tolist() == [5, 0, 5, 5]
    assert not torch.equal(after.joint_pos[1], before.joint_pos[1])


def test_state_dict_continues_bit_for_bit() -> None:
    config = configured("task=pick_place")
    first, second = Engine(config, 4, 0), Engine(config, 4, 0)
    rng = np.random.default_rng(0)

    def advance(engine: Engine, actions: np.ndarray) -> torch.Tensor:
        outcome = engine.step(actions)
        engine.reset(np.flatnonzero(outcome.done.numpy()))
        return outcome.state.tcp_pos

    first.reset()
    for _ in range(15):
        advance(first, rng.uniform(-1, 1, (4, 6)))
    second.reset()
    second.load_state_dict(first.state_dict())
    for _ in range(30):
        action = rng.uniform(-1, 1, (4, 6))
        assert torch.equal(advance(first, action), advance(second, action))


def test_time_limit_truncates_and_does_not_terminate() -> None:
    engine = Engine(configured("task=pick", "human=none", "task.max_episode_steps=12"), 3, 0)
    engine.reset()
    ends = [engine.step(np.zeros((3, 6))) for _ in range(3)]
    assert not ends[1].done.any()
    assert ends[2].truncated.all() and not ends[2].terminated.any()
    assert ends[2].state.steps.tolist() == [12, 12, 12]
    assert ends[2].decision_steps.tolist() == [2, 2, 2]


WALKER = ("human=approach", "human.keep_out_m=0", "human.bound_m=10", "human.speed_m_s=1.0")


@pytest.mark.parametrize("terminate_on", ["contact", "unsafe_contact"])
def test_who_walks_into_a_still_robot_makes_a_safe_contact(terminate_on: str) -> None:
    engine = Engine(configured("task=reach", *WALKER, f"task.terminate_on={terminate_on}"), 4, 0, measure_arm=True)
    engine.reset()
    touched, ended = torch.zeros(4, dtype=torch.bool), torch.zeros(4, dtype=torch.bool)
    for _ in range(60):
        outcome = engine.step(np.zeros((4, 6)))
        assert not outcome.state.unsafe_contact.any() and outcome.state.arm_distance.min() > -0.04
        touched |= outcome.state.contact
        ended |= outcome.state.contact & outcome.terminated
        engine.reset(np.flatnonzero(outcome.done.numpy()))
    assert touched.any() and ended.any() == (terminate_on == "contact")


@pytest.mark.parametrize("terminate_on", ["contact", "unsafe_contact"])
def test_an_arm_that_swings_into_somebody_makes_an_unsafe_contact(terminate_on: str) -> None:
    engine = Engine(configured("task=reach", *WALKER, f"task.terminate_on={terminate_on}"), 8, 0)
    engine.reset()
    unsafe = 0
    for decision in range(80):
        outcome = engine.step(np.tile([1.0 - 2 * (decision // 10 % 2), 0, 0, 0, 0, 0], (8, 1)))
        here = outcome.state.unsafe_contact
        assert (outcome.terminated & ~outcome.success)[here].all() and outcome.state.contact[here].all()
        unsafe += int(here.sum())
        engine.reset(np.flatnonzero(outcome.done.numpy()))
    assert unsafe


def test_a_touch_is_paid_once_though_the_episode_goes_on() -> None:
    engine = Engine(configured("task=reach", *WALKER, "task.terminate_on=unsafe_contact"), 4, 0)
    touching = engine.reset().touching[:, None]
    paid, touches = torch.zeros(4), torch.zeros(4)
    term = engine.episodes.reward_names.index("contact")
    for _ in range(60):
        outcome = engine.step(np.zeros((4, 6)))
        paid += outcome.reward_terms[:, term]
        touching = torch.cat([touching[:, -1:], outcome.instants.touching], dim=1)
        touches += (touching[:, 1:] & ~touching[:, :-1]).sum(dim=1)
        assert not outcome.done.any()
    assert paid.tolist() == (-10 * touches).tolist() and touches.max() > 1


def test_evaluation_rows_take_spawn_and_motion_from_the_set_whatever_the_task() -> None:
    entries = load_evaluation_set().part(0, 6)
    starts = []
    for task in ("pick", "return"):
        engine = Engine(configured(f"task={task}"), 6, 0, entries)
        state = engine.reset()
        np.testing.assert_allclose(state.humans_pos[:, 0].numpy(), entries.position, atol=1e-5)
        starts.append(engine.step(np.zeros((6, 6))).state.humans_pos)
    torch.testing.assert_close(starts[0], starts[1], rtol=0, atol=0)


def test_training_spawns_stay_clear_of_the_held_out_ones() -> None:
    config = configured("task=pick")
    engine = Engine(config, 256, 0)
    state = engine.reset()
    held_out = torch.from_numpy(engine.episodes.sampler.spawns[0][list(config.human.held_out)])
    assert torch.cdist(state.humans_pos[:, 0], held_out).min() >= config.human.spawn_margin_m


@pytest.mark.parametrize("task", ["pick", "place", "point_to_point", "cycle"])
def test_human_never_within_35_cm_of_a_goal(task: str) -> None:
    engine = Engine(configured(f"task={task}", "human.jitter_m=0.05"), 16, 0)
    engine.reset()
    centres = torch.from_numpy(
        engine.episodes.sampler.keep_out(engine.episodes.draw.points, engine.episodes.draw.goals).centres
    )
    for _ in range(30):
        outcome = engine.step(np.zeros((16, 6)))
        gaps = (outcome.instants.humans_pos - centres[:, None]).norm(dim=-1)
        assert gaps.min() >= 0.35 - 1e-6


@pytest.mark.parametrize("robot", ["ur5e", "ur10e"])
def test_other_robots_stand_in_the_same_cell(robot: str) -> None:
    engine = Engine(configured(f"robot={robot}"), 4, 0)
    engine.reset()
    outcome = engine.step(np.full((4, 6), 0.1))
    assert outcome.state.tcp_pos.isfinite().all() and not outcome.done.any()


@pytest.mark.parametrize("task", TASKS)
def test_torchrl_environment_passes_check_env_specs(task: str) -> None:
    check_env_specs(CellEnv(configured(f"task={task}"), 3, 0))


def test_torchrl_environment_reports_what_the_engine_does() -> None:
    env = CellEnv(configured("task=pick"), 3, 0)
    step = env.rand_step(env.reset())["next"]
    torch.testing.assert_close(step["reward"], step["reward_terms"].sum(-1, keepdim=True))
    assert step["decision_steps"].tolist() == [[5], [5], [5]]
    assert step["human_distance"].isfinite().all()


def test_engine_rejects_a_start_file_that_is_not_there() -> None:
    with pytest.raises(ValueError, match=r"task\.start='nowhere\.npz' is neither 'ik' nor"):
        Engine(configured("task=place", "task.start=nowhere.npz"), 2, 0)


def test_a_decision_ends_where_its_stage_does_on_both_fronts() -> None:
    bend = np.tile([0.0, -1.0, 0.0, 0.0, 0.0, 0.0], (3, 1))
    scout = Engine(configured("task=point_to_point", "human=none"), 3, 0)
    scout.reset()
    scout.step(bend)
    passed = scout.step(bend).steps[2].tcp_pos[0].tolist()
    config = configured(
        "task=point_to_point",
        "human=none",
        "task.point=fixed",
        f"task.point_m={passed}",
        "task.precision.grasp_tolerance_m=0.02",
    )
    front, engine = make_environment(config, 0), Engine(config, 3, 0)
    front.reset()
    engine.reset()
    taken, stages = [], []
    for _ in range(12):
        action = bend if 1 not in stages else 0 * bend
        front.step(action[0])
        outcome = engine.step(action)
        taken.append(int(outcome.decision_steps[0]))
        stages.append(int(outcome.state.stage[0]))
        assert not outcome.done.any()
        for name in FIELDS:
            ours, theirs = getattr(outcome.state, name)[0], getattr(front.task.episodes.state, name)[0]
            torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-9)
        if stages.count(1) == 3:
            break
    picked = stages.index(1)
    assert taken[picked] < 5
    assert [steps for index, steps in enumerate(taken) if index != picked] == [5] * (len(taken) - 1)
    assert int(outcome.state.steps[0]) == sum(taken)


def test_recorded_starts_keep_the_joints_moving(tmp_path: Path) -> None:
    engine = Engine(configured("task=pick"), 1, 0)
    angles = engine.scene.home + np.array([0.0, -0.5, 0.2, 0.0, 0.0, 0.0])
    bank = np.concatenate([angles, np.full(6, 0.3), angles + 0.01])[None]
    np.savez(tmp_path / "starts.npz", orange=bank, pink=bank)
    engine = Engine(configured("task=place", f"task.start='{tmp_path}/starts.npz'"), 2, 0)
    state = engine.reset()
    torch.testing.assert_close(state.joint_vel, torch.full((2, 6), 0.3, dtype=torch.float64))
    torch.testing.assert_close(state.joint_target - state.joint_pos, torch.full((2, 6), 0.01, dtype=torch.float64))


def test_rows_that_are_left_out_of_a_decision_change_nothing_for_the_others() -> None:
    config = configured("task=cycle", "human=patrol", "comfort=conditioned", "comfort.source=simulated")
    whole, part = (Engine(config, 4, 3, measure_arm=True, disturbance="drop") for _ in range(2))
    whole.reset()
    part.reset()
    rows, kept = np.array([0, 2]), torch.tensor([0, 2])
    rng = np.random.default_rng(0)
    for _ in range(6):
        action = rng.uniform(-1, 1, (4, 6))
        expected, outcome = whole.step(action), part.step(action, rows)
        for name, value in expected.state.fields().items():
            torch.testing.assert_close(getattr(outcome.state, name)[kept], value[kept], rtol=0, atol=0, equal_nan=True)
        assert torch.equal(outcome.reward_terms[kept], expected.reward_terms[kept])
        assert np.array_equal(part.physics.state[rows], whole.physics.state[rows])
