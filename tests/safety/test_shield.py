"""Behind the shield no fast link meets a person who keeps to the bounds; without it many do."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine

ROWS, DECISIONS = 64, 320
WORLD = (
    "task=pick_place", "human=adversary", "human.keep_out_m=0", "human.spawn=anywhere",
    "human.spawn_radius_m=[0.8,1.8]", "robot.rating=collaborative",
)  # fmt: skip


def contacts(decisions: int, *overrides: str) -> tuple[int, int]:
    """Return the numbers of episodes that end in a contact, and in an unsafe one, under random actions."""
    engine = Engine(environment(compose("train", [*WORLD, *overrides])), ROWS, 0)
    rng, found = np.random.default_rng(0), np.zeros(2, dtype=int)
    engine.reset()
    for _ in range(decisions):
        result = engine.step(rng.uniform(-1.0, 1.0, (ROWS, 6)))
        found += [int((flag & result.done).sum()) for flag in (result.state.contact, result.state.unsafe_contact)]
        engine.reset(np.flatnonzero(result.done.numpy()))
    engine.close()
    return int(found[0]), int(found[1])


@pytest.mark.parametrize("bound", ["worst", "observed"])
def test_behind_the_shield_no_contact_is_fast(bound: str) -> None:
    touched, unsafe = contacts(DECISIONS // 2, "safety=ssm", f"safety.bound={bound}")
    assert touched > 100 and unsafe == 0


def test_without_it_contacts_are() -> None:
    assert contacts(DECISIONS // 8)[1] >= 5


def test_the_shielded_engine_goes_on_bit_for_bit_after_its_state_is_loaded() -> None:
    config = environment(compose("train", [*WORLD, "human=random_walk", "safety=ssm"]))
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1.0, 1.0, (8, 4, 6))
    one, other = Engine(config, 4, 0), Engine(config, 4, 0)
    one.reset()
    for action in actions[:4]:
        one.step(action)
    other.load_state_dict(one.state_dict())
    for action in actions[4:]:
        first, second = one.step(action).state, other.step(action).state
        assert torch.equal(first.joint_pos, second.joint_pos) and torch.equal(first.share, second.share)


@pytest.mark.parametrize("last", [[0, 2, 1, 2], [1, 1, 1, 1], [2, 2, 2, 2]])
def test_the_shield_remembers_of_a_decision_what_was_valid_in_each_row(last: list[int]) -> None:
    drive = Engine(environment(compose("train", [*WORLD, "safety=ssm"])), 4, 0).episodes.plan.drive
    assert drive is not None and drive.shield is not None
    shield, before = drive.shield, drive.shield.memory
    drive.begin_decision()
    for step in range(3):
        shield.remember(np.full_like(before.seen, step), np.full_like(before.trail, 10 + step))
    shield.sent(np.full(before.trail[:, 0].shape, 50.0))
    drive.end_decision(np.array(last))
    assert (shield.memory.seen == last).all()
    assert (shield.memory.trail[:, -1] == np.where(np.array(last) == 2, 50.0, np.add(last, 10))).all()


def test_policies_see_the_shields_last_share_and_its_stops_are_counted() -> None:
    overrides = ("human=approach", "safety=ssm", "task.terminate_on=unsafe_contact")
    config = environment(compose("train", [*WORLD, *overrides]))
    engine, rng = Engine(config, 8, 0), np.random.default_rng(0)
    engine.reset()
    sums, stops = np.zeros(8), np.zeros(8, dtype=int)
    braking, least, most = np.zeros(8, dtype=bool), 1.0, 0
    for _ in range(60):
        result = engine.step(rng.choice([-1.0, 1.0], (8, 6)))
        for state, valid in zip(result.steps, result.valid.numpy().T, strict=True):
            sums += np.where(valid, state.share.numpy(), 0.0)
            stops += valid & state.braking.numpy() & ~braking
            braking = np.where(valid, state.braking.numpy(), braking)
        after = result.state
        assert torch.equal(engine.episodes.subtask.observe(after)[:, -1], after.share)
        assert after.share_sum.numpy() == pytest.approx(sums) and after.protective_stops.tolist() == stops.tolist()
        least, most = min(least, float(after.share.min())), max(most, int(stops.max()))
        done = result.done.numpy()
        sums[done], stops[done], braking[done] = 0.0, 0, False
        engine.reset(np.flatnonzero(done))
    assert least < 0.5 and most > 0


@pytest.mark.parametrize("safety", ["none", "ssm"])
def test_an_arm_that_touches_somebody_does_not_press_on(safety: str) -> None:
    overrides = (f"safety={safety}", "task.terminate_on=unsafe_contact")
    engine = Engine(environment(compose("train", [*WORLD, *overrides])), 32, 0)
    engine.reset()
    pressed, touched = 0.0, 0
    for decision in range(80):
        result = engine.step(np.tile([0.1 - 0.2 * (decision // 20 % 2), 0, 0, 0, 0, 0], (32, 1)))
        state = result.state.rows(result.state.touching & ~result.done)
        touched += len(state.steps)
        if len(state.steps):
            pressed = max(pressed, float((state.joint_pos - state.joint_target).abs().max()))
        engine.reset(np.flatnonzero(result.done.numpy()))
    assert touched > 50 and pressed < 0.1
