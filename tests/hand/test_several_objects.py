"""A hand that serves several objects: each has a slot of its own, is placed in it, and lost ones cost their job."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.evaluation.rates import newly_lost
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.hand.arrivals import Arrivals
from hrl_comfort.sim.hand.sensors import Losses

ALONE = ("cell=grasp", "human=none", "split=validation", "output=unused")
POLICIES = ("policies.pick=expert", "policies.place=expert", "policies.return=expert")


def asked(*words: str) -> EvaluateConfig:
    found = compose("evaluate", [*ALONE, *words])
    assert isinstance(found, EvaluateConfig)
    return found


def test_every_object_has_a_slot_of_its_own_where_it_arrives_and_where_it_belongs() -> None:
    config = environment(asked("task=sort", "policy=expert", "meta_controller=none"))
    engine = Engine(config, 6, 0)
    state = engine.reset()
    apart = 0.14 - 2 * config.task.object_jitter_m
    for at in (state.objects, state.object_places):
        gaps = (at[:, :, None] - at[:, None])[..., :2].norm(dim=-1) + torch.eye(4)
        assert gaps.min() >= apart - 1e-6
    assert torch.equal(state.target_place, state.object_places[:, 0])
    chosen = state.with_(target=torch.full((6,), 2))
    assert torch.equal(chosen.target_place, state.object_places[:, 2])
    engine.close()


def test_a_hand_sorts_by_options() -> None:
    words = ("task=sort", "task.objects=2", *POLICIES, "meta_controller=nearest", "episodes=1")
    result = rollout(asked(*words))
    row = result.episodes[0].row()
    assert row["success"] and row["objects_placed"] == 2
    assert row["drops"] == 0 and not row["object_lost"] and not row["diverged"]
    runs = [run["option"] for run in result.options]
    assert {"pick_1", "pick_2"} <= set(runs) and runs.count("place") == runs.count("return") == 2


def test_in_a_shift_a_delivered_and_a_lost_object_arrive_anew_at_rest_and_clear_of_all() -> None:
    engine = Engine(environment(asked("task=shift", "task.objects=2", "policy=expert", "meta_controller=none")), 2, 0)
    state, model = engine.reset(), engine.scene.model
    hold = np.concatenate([np.zeros((2, 6)), np.full((2, 1), -1.0)], axis=1)
    kinds = len(engine.episodes.config.cell.objects)
    body = model.joint(engine.scene.loose[int(state.kinds[0, 0])])
    engine.physics.state[0, 1 + body.qposadr[0] : 4 + body.qposadr[0]] = 0.98, 0.2, -0.4  # beside the table
    stage, placed = torch.tensor([1, 3]), torch.tensor([[False, False], [True, False]])
    engine.episodes.measured(stage=stage.numpy(), placed=placed.numpy())
    lost = [engine.step(hold) for _ in range(8)]
    assert any(bool(step.begun("object_lost")[0]) for step in lost)
    now = lost[-1].state
    assert not now.object_lost.any() and not now.placed.any() and now.stage.tolist() == [0, 3]
    arrivals = torch.from_numpy(engine.episodes.draw.arrivals)
    expected = arrivals[torch.arange(2), 0, now.kinds[:, 0]]
    torch.testing.assert_close(now.objects[:, 0], expected, atol=0.005, rtol=0)
    assert (now.objects_vel.norm(dim=-1) < 0.05).all() and not now.diverged.any()
    poses = engine.physics.state[:, 1 : 1 + model.nq]
    for row in range(2):
        there = [abs(poses[row, model.joint(name).qposadr[0]]) < 2.0 for name in engine.scene.loose]
        assert sum(there) == 2 and there[int(now.kinds[row, 0])] and sum(there[:kinds]) == 1
    engine.close()


def test_an_object_that_is_lost_while_another_is_lost_counts_too() -> None:
    engine = Engine(environment(asked("task=shift", "task.objects=2", "policy=expert", "meta_controller=none")), 2, 0)
    state, losses, model = engine.reset(), Losses(engine.scene), engine.scene.model
    hold = np.concatenate([np.zeros((2, 6)), np.full((2, 1), -1.0)], axis=1)
    poses = [1 + model.joint(engine.scene.loose[int(state.kinds[0, 0]) + index * 2]).qposadr[0] for index in (0, 1)]
    slots = engine.episodes.draw.arrivals
    slots[0, 0] = state.tcp_pos[0].numpy()  # the hand is where it would arrive anew
    counts, begun = np.zeros(2, dtype=np.int64), 0
    for decision in range(8):
        if decision in (0, 4):
            engine.physics.state[0, poses[decision // 4] : poses[decision // 4] + 3] = 0.98, 0.2, -0.4
        if decision == 4:
            slots[0, 1] = slots[0, 0]
        result = engine.step(hold)
        counts += newly_lost(losses, result)
        begun += int(result.begun("object_lost")[0])
    assert counts.tolist() == [2, 0] and begun == 1 and result.state.object_lost.tolist() == [True, False]
    engine.close()


def test_no_object_arrives_in_the_hand_or_in_another_object() -> None:
    engine = Engine(environment(asked("task=shift", "task.objects=2", "policy=expert", "meta_controller=none")), 3, 0)
    state, draw = engine.reset(), engine.episodes.draw
    arrivals, turns = torch.from_numpy(draw.arrivals), torch.from_numpy(draw.turns)
    blocked = state.objects.clone()
    blocked[1, 1] = arrivals[1, 0, int(state.kinds[1, 0])] + torch.tensor([0.01, 0.0, 0.0])
    placed = torch.tensor([[True, False]] * 3)
    blocked[:, 0] = state.object_places[:, 0]
    before = state.with_(objects=blocked, placed=placed)
    slots = arrivals.clone()
    slots[2, 0, :] = state.tcp_pos[2] - torch.tensor([0.0, 0.0, 0.05])
    after = Arrivals(engine.scene).go_on(before, state.kinds[:, 0], slots, turns, engine.episodes.subtask)
    assert after.placed[:, 0].tolist() == [False, True, True]
    assert torch.equal(after.objects[1:], before.objects[1:])
    engine.close()


def test_what_the_hand_carries_is_not_out_of_reach() -> None:
    scene = Engine(
        environment(asked("task=shift", "task.objects=2", "policy=expert", "meta_controller=none")), 1, 0
    ).scene
    losses, kinds = Losses(scene), np.zeros((1, 2), dtype=np.int64)
    away = np.array([[[1.5, 0.0, 0.3], [0.3, 0.0, 0.3]]])
    assert losses(away, kinds, np.zeros((1, 2), dtype=bool)).tolist() == [[True, False]]
    assert not losses(away, kinds, np.ones((1, 2), dtype=bool)).any()


def test_while_the_hand_holds_an_object_no_other_can_be_picked() -> None:
    config = asked("task=sort", "task.objects=2", *POLICIES, "meta_controller=nearest")
    engine = Engine(environment(config), 4, 0)
    executor, _ = make_executor(config, None, engine, 0)
    state = engine.reset()
    picks = [executor.table.position(name) for name in ("pick_1", "pick_2")]
    pads, carried = torch.zeros(4, 2, 2, dtype=torch.bool), torch.zeros(4, 2, dtype=torch.bool)
    pads[1, 0], pads[2, 1, 0], carried[3, 1] = True, True, True  # nothing; the first; one pad at the second; the second
    able = executor.table.can_start(state.with_(pads=pads, carried=carried))[:, picks]
    assert able.tolist() == [[True, True], [True, False], [True, True], [False, True]]
    placed = torch.tensor([[True, False]] * 4)
    laid = executor.table.can_start(state.with_(pads=pads, carried=carried, placed=placed))[:, picks]
    assert laid.tolist() == [[False, True]] * 4, "what is placed is not held"
    engine.close()


def test_an_interrupted_hand_gives_way_with_nothing_in_it_and_opens() -> None:
    words = (
        "task=sort",
        "task.objects=2",
        *POLICIES,
        "meta_controller=nearest",
        "meta_controller.interruption_steps=20",
    )
    config = asked(*words)
    engine = Engine(environment(config), 4, 0)
    executor, _ = make_executor(config, None, engine, 0)
    state, retreat = engine.reset(), executor.table.position("retreat")
    pads, carried = torch.zeros(4, 2, 2, dtype=torch.bool), torch.zeros(4, 2, dtype=torch.bool)
    pads[1, 0], pads[2, 1, 0], carried[3, 1] = True, True, True  # nothing; the first; one pad at the second; the second
    away = state.with_(pads=pads, carried=carried, joint_pos=state.joint_pos + 0.5, grip_target=torch.full((4,), 0.8))
    assert executor.table.can_start(away)[:, retreat].tolist() == [True, False, True, False]
    fingers = executor.table.act(torch.full((4,), retreat), away, torch.ones(4, dtype=torch.bool))[:, -1]
    assert fingers.tolist() == pytest.approx([-1.0, 0.6, -1.0, 0.6])
    engine.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("task=sort", "task.objects=5"), "task.objects=5, but cell.places.left.slots_m has 4; add slots, or choose"),
        (("task=sort", "cell=bench", "gripper=two_finger"), "needs 0.096 m: move the slots apart"),
    ],
)
def test_slots_too_few_or_too_near_to_each_other_are_refused(words: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Engine(environment(asked(*words, "policy=expert", "meta_controller=none")), 1, 0)


def test_what_somebody_fetches_leaves_its_place_and_its_order_opens_anew() -> None:
    words = ("task=kitting", "cell=bench_hand", "human=still", "policy=expert", "meta_controller=none")
    engine = Engine(environment(asked(*words)), 1, 0)
    state = engine.reset()
    assert state.kinds.tolist() == [list(range(6))]
    ends = torch.cat([state.objects, state.object_places], dim=1)[..., :2]
    assert ((ends[:, :, None] - ends[:, None]).norm(dim=-1) + torch.eye(12) > 0.12).all(), "each has slots of its own"
    placed = torch.zeros(1, 6, dtype=torch.bool)
    placed[0, 3] = True
    there = state.object_places[:, 3].clone()
    before = state.with_(placed=placed, objects=state.objects.index_copy(1, torch.tensor([3]), there[:, None]))
    draw, orders = engine.episodes.draw, engine.episodes.subtask
    told = torch.from_numpy(draw.arrivals), torch.from_numpy(draw.turns), orders
    arrivals, kinds = Arrivals(engine.scene), before.kinds[:, 0]
    alone = before.with_(humans_pos=torch.full_like(before.humans_pos, 50.0))
    assert torch.equal(arrivals.go_on(alone, kinds, *told).objects, alone.objects)
    beside = before.with_(humans_pos=there[:, None, :2].clone(), humans_vel=torch.zeros_like(before.humans_vel))
    after = arrivals.go_on(beside, kinds, *told)
    assert not after.placed.any() and torch.equal(after.kinds, before.kinds)
    torch.testing.assert_close(after.objects, state.objects, atol=1e-3, rtol=0)
    engine.close()


def test_objects_arrive_in_dm_control_as_in_the_engine() -> None:
    config = environment(asked("task=shift", "task.objects=2", "policy=expert", "meta_controller=none"))
    engine, env = Engine(config, 1, 3), make_environment(config, 3)
    engine.reset()
    env.reset()
    for episodes in (engine.episodes, env.task.episodes):
        episodes.measured(stage=np.array([3]), placed=np.array([[True, False]]))
    action = np.append(np.zeros(6), -1.0)
    for _ in range(4):
        batch = engine.step(action[None]).state
        env.step(action)
        one = env.task.episodes.state
        assert all(torch.equal(getattr(batch, name), getattr(one, name)) for name in ("joint_pos", "objects", "kinds"))
    assert not batch.placed.any() and not batch.diverged.any()
    engine.close()
