"""Several objects: where they lie, how they are aimed at, and the options that sort them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy import sort as sorting_module
from hrl_comfort.hierarchy.decision import Top
from hrl_comfort.hierarchy.executor import TERMINATIONS, OptionExecutor, execute
from hrl_comfort.hierarchy.option_env import OptionEnv
from hrl_comfort.hierarchy.options import OptionTable, Termination
from hrl_comfort.hierarchy.sort import sorting_table, stop
from hrl_comfort.hierarchy.tops import cautious, nearest
from hrl_comfort.sim.engine import Engine

META = replace(compose("evaluate", ["task=sort", "meta_controller=nearest"]).meta_controller, time_limit_steps=500)
EXPERTS = {"pick": "expert", "place": "expert", "return": "expert"}
STILL = {"pick": "random", "place": "random", "return": "random"}


def config(*overrides: str) -> EnvConfig:
    return environment(compose("train", ["task=sort", *overrides]))


@pytest.mark.parametrize("objects", [2, 4, 6])
def test_objects_lie_on_their_place_and_never_overlap(objects: int) -> None:
    env = config(f"task.objects={objects}")
    state = Engine(env, 40, 0).reset()
    offset = state.objects - torch.tensor(env.cell.goals["ball_table"], dtype=torch.float64)
    half = env.cell.places["ball_table"].size_m[0] / 2
    assert (offset[..., :2].abs() <= half).all() and (offset[..., 2] == 0).all()
    apart = (state.objects[:, :, None] - state.objects[:, None]).norm(dim=-1) + 9 * torch.eye(objects)
    assert (apart >= 2 * env.cell.objects["orange"].half_width_m - 1e-9).all()
    assert state.kinds.unique().tolist() == [0, 1]


def test_more_objects_leave_the_rest_of_an_episode_as_it_is() -> None:
    few, many = (Engine(config(f"task.objects={n}"), 8, 0).reset() for n in (2, 4))
    for name in ("humans_pos", "joint_pos"):
        assert torch.equal(getattr(few, name), getattr(many, name))
    assert torch.equal(few.kinds[:, 0], many.kinds[:, 0])


def test_too_many_objects_for_the_place_or_the_task_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"task.objects=7, but cell.places.ball_table.slots_m has 6"):
        config("task.objects=7")
    with pytest.raises(ConfigError, match=r"task.objects=2.*choose sort"):
        compose("train", ["task=cycle", "task.objects=2"])


def test_aiming_moves_the_goal_and_is_refused_while_an_object_is_held() -> None:
    engine = Engine(config("human=none"), 3, 0)
    engine.reset()
    engine.episodes.aim(torch.tensor([1]), torch.tensor([2]))
    state = engine.episodes.state
    assert state.target.tolist() == [0, 2, 0]
    assert torch.equal(state.target_object[1], state.objects[1, 2])
    assert torch.equal(state.target_place[1], state.kind_places[1, state.kinds[1, 2]])
    engine.episodes.state = state.with_(stage=torch.tensor([0, 1, 0]))
    with pytest.raises(ValueError, match="cannot be picked"):
        engine.episodes.aim(torch.tensor([1]), torch.tensor([0]))


@pytest.mark.parametrize("choose", [nearest, cautious])
def test_experts_sort_every_object_once(choose) -> None:
    engine = Engine(config("task.objects=3", "human=none"), 2, 0)
    options = sorting_table(META, EXPERTS, engine.scene, engine.episodes.config, 0)
    engine.reset()
    steps = list(execute(engine, OptionExecutor(options, engine.episodes), Top(choose.__name__, choose)))
    assert steps[-1].result.state.placed.all() and steps[-1].result.success.all()
    for row in range(2):
        runs = [run for step in steps for run in step.runs if run.row == row]
        assert sorted(run.option for run in runs if run.option.startswith("pick")) == [
            "pick_1",
            "pick_2",
            "pick_3",
        ]
        assert [run.option for run in runs][1::3] == ["place"] * 3
        assert all(run.termination == "success" for run in runs)


@pytest.fixture(scope="module")
def begun() -> tuple[Engine, OptionExecutor]:
    engine = Engine(config(), 8, 0)
    engine.reset()
    options = sorting_table(META, STILL, engine.scene, engine.episodes.config, 0)
    return engine, OptionExecutor(options, engine.episodes)


def idle(executor: OptionExecutor) -> tuple[int, int]:
    return executor.table.position("wait"), executor.table.position("retreat")


def test_only_options_that_can_start_are_offered(begun) -> None:
    engine, executor = begun
    mask, (wait, retreat) = executor.available(engine.episodes.state), idle(executor)
    assert mask[:, :4].all() and mask[:, wait].all()
    assert not (mask[:, 4] | mask[:, 5] | mask[:, retreat]).any()  # place and return follow the picks
    state = engine.episodes.state
    placed = state.placed.clone()
    placed[:, 1] = True
    assert not executor.available(state.with_(placed=placed))[:, 1].any()


def test_what_was_preempted_goes_home_before_anything_else() -> None:
    engine = Engine(config("human=none"), 8, 0)
    state = engine.reset()
    options = sorting_table(replace(META, time_limit_steps=5), STILL, engine.scene, engine.episodes.config, 0)
    executor, everyone = OptionExecutor(options, engine.episodes), torch.ones(8, dtype=torch.bool)
    near, away = (state.joint_home + math.radians(degrees) for degrees in (9, 11))
    assert executor.available(state.with_(joint_pos=away))[:, :4].all()
    executor.begin(everyone, torch.zeros(8, dtype=torch.int64))
    outcome = engine.step(torch.zeros(8, 6).numpy())
    assert (executor.ended(outcome).termination == TERMINATIONS.index(Termination.PREEMPTED)).all()
    for stage in (0, 1, 2):
        lost = state.with_(joint_pos=away, stage=torch.full((8,), stage), steps=outcome.state.steps)
        mask = executor.available(lost)
        assert mask[:, idle(executor)[1]].all() and (mask.sum(dim=1) == 1).all()
        for choose in (nearest, cautious):
            asked = replace(executor.decision(engine.episodes.state), state=lost, mask=mask)
            assert (choose(asked) == options.position("retreat")).all()
    assert executor.available(state.with_(joint_pos=near, steps=outcome.state.steps))[:, :4].all()
    executor.begin(everyone, torch.zeros(8, dtype=torch.int64))
    taken = outcome.state.with_(stage=torch.ones(8, dtype=torch.int64), joint_pos=away)
    executor.ended(replace(outcome, state=taken))
    assert executor.available(taken)[:, 4].all()  # what succeeds leaves the arm where the next skill begins


def test_the_arm_rests_where_it_is_slow_and_retreats_with_no_object(begun) -> None:
    engine, executor = begun
    away = engine.episodes.state.joint_home + math.radians(11)
    for stage, rests, retreats in ((0, True, False), (1, True, False), (2, False, True), (3, True, False)):
        there = engine.episodes.state.with_(joint_pos=away, stage=torch.full((8,), stage))
        mask, (wait, retreat) = executor.available(there), idle(executor)
        assert (mask[:, wait] == rests).all() and (mask[:, retreat] == retreats).all()


def test_a_wait_may_follow_itself_as_often_as_is_allowed_in_every_episode_anew() -> None:
    engine = Engine(config("human=none"), 2, 0)
    state, everyone = engine.reset(), torch.ones(2, dtype=torch.bool)
    options = sorting_table(replace(META, max_waits=2), STILL, engine.scene, engine.episodes.config, 0)
    executor = OptionExecutor(options, engine.episodes)
    wait = torch.full((2,), options.position("wait"))
    for steps, offered in ((0, True), (25, True), (50, False)):
        state = engine.episodes.state = state.with_(steps=torch.tensor([steps, 0]))
        assert executor.available(state)[:, options.position("wait")].tolist() == [offered, True]
        if offered:
            executor.begin(everyone, wait)
    with pytest.raises(ValueError, match="row 0: option wait cannot start now"):
        executor.begin(everyone, wait)
    executor.begin(everyone, torch.zeros(2, dtype=torch.int64))
    assert executor.available(state)[:, options.position("wait")].all()
    never = sorting_table(replace(META, max_waits=0), STILL, engine.scene, engine.episodes.config, 0)
    assert not OptionExecutor(never, engine.episodes).available(state)[:, options.position("wait")].any()


def test_a_pause_lasts_as_long_as_it_says_whatever_the_limit_and_ends_where_its_object_is_lost() -> None:
    engine = Engine(config("human=none"), 3, 0)
    holding = torch.ones(3, dtype=torch.int64)
    engine.episodes.state = engine.reset().with_(stage=holding)
    options = sorting_table(replace(META, time_limit_steps=5), STILL, engine.scene, engine.episodes.config, 0)
    executor, everyone = OptionExecutor(options, engine.episodes), torch.ones(3, dtype=torch.bool)
    executor.begin(everyone, torch.full((3,), options.position("wait")))
    outcome = engine.step(torch.zeros(3, 6).numpy())
    for steps, stage, termination in (
        (20, 1, None),
        (25, 1, Termination.SUCCESS),
        (25, 0, Termination.PREEMPTED),
    ):
        there = outcome.state.with_(steps=torch.full((3,), steps), stage=stage * holding)
        ended = executor.ended(replace(outcome, state=there))
        assert (ended.rows == (termination is not None)).all()
        assert termination is None or (ended.termination == TERMINATIONS.index(termination)).all()


def test_after_a_preempted_option_the_environment_above_options_offers_nothing_but_the_way_home() -> None:
    def make(engine: Engine) -> OptionTable:
        return sorting_table(replace(META, time_limit_steps=10), EXPERTS, engine.scene, engine.episodes.config, 0)

    env = OptionEnv(config("human=none"), make, 2, 0, 0.99)
    td, table = env.reset(), env.executor.table
    stuck = env.step(td.set("action", torch.tensor([0, table.position("wait")])))["next"]
    preempted = TERMINATIONS.index(Termination.PREEMPTED)
    assert stuck["deciding"].all(dim=-1).tolist() == [True, False] and int(stuck["termination"][0]) == preempted
    home = torch.arange(len(table)) == table.position("retreat")
    assert torch.equal(stuck["action_mask"][0], home)
    anew = env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, batch_size=[2]))
    assert anew["action_mask"][0, :4].all()


def test_a_skill_may_be_told_another_level_than_the_one_in_force(begun) -> None:
    engine, _ = begun
    env = config("comfort=sort")
    options = sorting_table(replace(META, level_override=[1, 6]), STILL, engine.scene, env, 0)
    names = options.names
    assert names[:6] == ["pick_1", "pick_2", "pick_3", "pick_4", "place", "return"]
    assert names[6:12] == [f"{name}_as_1" for name in names[:6]] and names[-2:] == ["wait", "retreat"]
    asked = OptionExecutor(options, engine.episodes).decision(engine.episodes.state)
    assert (asked.mask[:, :4] == asked.mask[:, 6:10]).all()
    wait = options.position("wait")
    for choose in (nearest, cautious):  # at the first level that they may give
        assert {*choose(asked).tolist()} <= {6, 7, 8, 9, wait}


def test_a_skill_acts_as_at_the_level_it_is_told(begun, monkeypatch) -> None:
    monkeypatch.setattr(sorting_module, "make_policy", lambda *_: lambda state: state.level[:, None])
    env = config("comfort=sort")
    options = sorting_table(replace(META, level_override=[6]), STILL, begun[0].scene, env, 0)
    state = begun[0].episodes.state.with_(level=torch.full((8,), 3.0, dtype=torch.float64))
    heard = {}
    for index, option in enumerate([*options][:12]):
        chosen = torch.full((8,), index)
        heard[option.name] = options.act(chosen, state, chosen >= 0)[0, 0].item()
    assert all(level == (6 if name.endswith("_as_6") else 3) for name, level in heard.items())


@pytest.mark.parametrize("overrides", [["comfort=sort", "comfort.levels=5"], []])
def test_a_level_that_is_not_there_is_not_told(begun, overrides) -> None:
    env = config(*overrides)
    with pytest.raises(ConfigError, match=r"meta_controller\.level_override=6 with comfort\.source"):
        sorting_table(replace(META, level_override=[6]), STILL, begun[0].scene, env, 0)


def test_whoever_waits_comes_to_rest_where_they_are(begun) -> None:
    engine = Engine(config("human=none"), 2, 0)
    state = engine.reset()
    for _ in range(3):
        state = engine.step(np.full((2, 6), 0.4)).state
    began = state.joint_pos
    for _ in range(6):
        state = engine.step(stop(engine.episodes.config.task)(state).numpy()).state
    rest = state.joint_pos
    state = engine.step(stop(engine.episodes.config.task)(state).numpy()).state
    assert (rest - began).abs().max() < 0.015  # it runs on by 0.021 rad where the targets stay ahead
    assert (state.joint_pos - rest).abs().max() < 1e-3 and state.joint_vel.abs().max() < 0.02


def test_a_wait_ends_with_the_episode_that_succeeds_meanwhile(begun) -> None:
    engine, executor = begun
    state = engine.episodes.state
    executor.begin(torch.ones(8, dtype=torch.bool), torch.full((8,), executor.table.position("wait")))
    outcome = engine.step(torch.zeros(8, 6).numpy())
    won = replace(outcome, success=torch.ones(8, dtype=torch.bool), terminated=torch.ones(8, dtype=torch.bool))
    ended = executor.ended(won)
    assert ended.rows.all() and (ended.termination == TERMINATIONS.index(Termination.SUCCESS)).all()
    engine.episodes.state = state


def test_objects_that_could_overlap_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"object_jitter_m=0.03 lets objects come within"):
        Engine(config("task.object_jitter_m=0.03"), 2, 0)
