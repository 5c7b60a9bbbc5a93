"""Cells that a hand works in: low places, oblong boxes, objects that are not there, and grippers with a fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.policies.load import make_policy
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.hand.sensors import fallen_m
from tests.hand.campaign import decisions
from tests.hand.pincer import Pincer
from tests.studio.test_page_safety import drawn_policy

ALONE = ("cell=grasp", "human=none", "task.object_jitter_m=0.05")


def cell(*words: str) -> EnvConfig:
    return compose_environment("train", [*ALONE, *words])


def solved(config: EnvConfig, rows: int) -> int:
    """Return in how many of `rows` cells the expert succeeds."""
    return sum(int((result.success.numpy() & going).sum()) for going, result in decisions(config, rows))


@pytest.mark.parametrize("base_m", [0.02, 0.1, 0.16])
def test_an_object_in_a_low_cell_is_lost_on_the_floor_alone(base_m: float) -> None:
    config = cell(f"cell.base_height_m={base_m}", "~cell.obstacles.table", "task=pick", "task.object=cube")
    engine = Engine(config, 1, 0)
    assert not engine.reset().object_lost.any()
    assert not engine.step(np.zeros((1, 7))).state.object_lost.any()
    at = 1 + engine.scene.model.joint("object_1_cube").qposadr[0]
    engine.physics.state[0, at : at + 3] = (0.3, 0.6, engine.scene.floor_z + 0.02)  # beside the places
    assert engine.step(np.zeros((1, 7))).state.object_lost.all()


def test_from_places_on_the_floor_nothing_falls() -> None:
    low = cell(
        "cell.base_height_m=0.0", "cell.places.left.top_m=[0.28,0.2,0.01]", "cell.places.right.top_m=[0.28,-0.2,0]"
    )
    assert (fallen_m(low.cell) == -np.inf).all()


@pytest.mark.parametrize("gripper", ["two_finger", "robotiq_2f85"])
@pytest.mark.parametrize("size", ["[0.05,0.015,0.02]", "[0.015,0.05,0.02]"])
def test_the_expert_takes_an_oblong_box_by_its_narrow_side(size: str, gripper: str) -> None:
    box = (f"gripper={gripper}", "~cell.objects.ball", f"cell.objects.cube.size_m={size}")
    assert solved(cell(*box, "task=pick"), 6) == 6
    assert solved(cell(*box, "task=pick", "task.start=pregrasp"), 4) == 4
    assert solved(cell(*box, "task=place"), 4) == 4


def test_objects_that_are_not_in_an_episode_touch_nothing_until_it_is_over() -> None:
    config = cell("task=pick", "task.object=cube", "task.max_episode_steps=300")
    engine = Engine(config, 1, 0)
    engine.reset()
    at = 1 + engine.scene.model.joint("object_1_ball").qposadr[0]
    heights = [engine.physics.state[0, at + 2]]
    while not (result := engine.step(np.zeros((1, 7)))).done.all():
        heights.append(engine.physics.state[0, at + 2])
    fallen = 9.81 * (0.02 * result.state.steps.item()) ** 2 / 2
    assert heights[0] - engine.physics.state[0, at + 2] == pytest.approx(fallen, rel=0.01)
    assert engine.physics.state[0, at + 2] > engine.scene.floor_z + 1.0


class Raises(Pincer):
    def attach(self, flange: Any, force_n: float) -> None:
        raise KeyError("palm")


class HasNoDrive(Pincer):
    def attach(self, flange: Any, force_n: float) -> None:
        super().attach(flange, force_n)
        flange.root.find("actuator", "hand").remove()


class HasNoTool(Pincer):
    def attach(self, flange: Any, force_n: float) -> None:
        super().attach(flange, force_n)
        flange.root.find("site", "tcp").remove()


class NamesOtherPads(Pincer):
    pads = ("left", "right_jaw")

    def attach(self, flange: Any, force_n: float) -> None:
        Pincer().attach(flange, force_n)


class HasNoRange(Pincer):
    def attach(self, flange: Any, force_n: float) -> None:
        super().attach(flange, force_n)
        del flange.root.find("actuator", "hand").ctrlrange


class HasNoMass(Pincer):
    def attach(self, flange: Any, force_n: float) -> None:
        super().attach(flange, force_n)
        for geom in flange.root.find("body", "left_jaw").geom:
            geom.mass = 0


class HasNoPads:
    name, opening_m, tip_m, attach = "no_pads", 0.1, 0.02, None


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (Raises, "attach.. raised KeyError: 'palm'"),
        (HasNoDrive, "it lacks actuator 'hand'"),
        (HasNoTool, "it lacks site 'tcp'"),
        (NamesOtherPads, "it lacks body 'left'"),
        (HasNoRange, "the actuator 'hand' has no ctrlrange"),
        (HasNoMass, "MuJoCo does not take it: .*mass"),
        (HasNoPads, "must be a Gripper"),
    ],
)
def test_a_faulty_gripper_of_a_user_s_own_is_refused_in_one_line(
    made: Callable[[], Any], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.hand.pincer.PINCER", made())
    with pytest.raises(ConfigError, match=rf"robot\.gripper\.name=.*{says}") as told:
        scene_of(cell("gripper=tests.hand.pincer:PINCER"))
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("kind", ["peg", "block"])
def test_the_expert_puts_pegs_into_a_slot_and_lets_go(kind: str) -> None:
    config = compose_environment("train", ["cell=tray", "task=place_fine", "human=none", f"task.object={kind}"])
    engine = Engine(config, 2, 0)
    state, act = engine.reset(), make_policy("expert", engine.episodes.subtask, engine.scene, config, 0)
    play, depth = config.cell.places["slot"].size_m[0] / 2 - 0.02, 0.012
    going = np.ones(2, dtype=bool)
    while going.any():
        result = engine.step(act(state).numpy(), np.flatnonzero(going))
        state, ended = result.state, result.done.numpy() & going
        for row in np.flatnonzero(ended):
            off = (state.objects[row, 0] - state.target_place[row]).abs()
            assert result.success[row] and state.free_steps[row, 0] >= 25 and not state.pads[row].any()
            assert off[:2].max() <= play + 1e-3 and off[2] < depth
        going &= ~ended


def test_a_policy_sees_the_same_whichever_hand_the_arm_wears(tmp_path: Path) -> None:
    words = ("task=cycle", "task.observation=sight", "human=still")
    two, linked = (Engine(cell(*words, f"gripper={name}"), 2, 0) for name in ("two_finger", "robotiq_2f85"))
    theirs, state = linked.reset(), two.reset()
    task = two.episodes.subtask
    assert task.layout(state) == linked.episodes.subtask.layout(theirs)
    assert len(task.layout(state)["clearances"]) == 3 * state.arm_body.shape[1] == 21
    assert torch.equal(state.arm_body, theirs.arm_body) and not torch.equal(state.hand_body, theirs.hand_body[:, :4])
    trained = {"observation": "sight", "gripper": "two_finger", "shield": False}
    policy = drawn_policy(tmp_path / "policy.pt", [*ALONE, *words], seed=0, **trained)
    act = make_policy(str(policy.policy), linked.episodes.subtask, linked.scene, linked.episodes.config, 0)
    assert act(theirs).shape == (2, 7)


def test_people_near_the_hand_alone_are_seen() -> None:
    engine = Engine(cell("task=pick", "task.observation=sight", "human=still"), 1, 0)
    state = engine.reset()
    along = state.tcp_pos - state.hand_body[:, 0, :3]
    ahead = state.tcp_pos + 0.3 * along / along.norm()
    person = torch.cat([ahead, ahead, torch.full((1, 1), 0.05)], dim=-1)[:, None]
    still = {"humans_body": person, "humans_body_vel": torch.zeros(1, 1, 6).double()}
    people = engine.episodes.subtask.observations["people"]
    seen, without = (people(state.with_(**still, **hand))[0, 1] for hand in ({}, {"hand_body": state.arm_body}))
    assert seen > without + 0.05
