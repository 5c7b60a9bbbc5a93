"""The expert's goal postures grasp squarely at bounded cost; behind the shield it waits for nobody for ever."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import EnvConfig
from hrl_comfort.policies.expert import NEAREST
from hrl_comfort.policies.hand.carrying import CARRY_M_S
from hrl_comfort.policies.hand.expert import GraspingExpert
from hrl_comfort.policies.hand.postures import DISTINCT_RAD, SEEDS, GoalPostures
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.grippers import GRIPPERS
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.grasps import BACK_M, CLEAR_M, CLOSE_M, TILTS_RAD, Grasps, approaches, rise_m
from tests.hand.campaign import decisions

SHIELDED = ("human=still", "safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact")
BESIDE_OBJECT = ("human.spawns_m=[[0.61,0.43]]", "human.held_out=[]", "human.spawn=points", "human.spawn_jitter_m=0")


def cell(*words: str) -> EnvConfig:
    return compose_environment("train", ["cell=grasp", *words])


@pytest.mark.parametrize("robot", ["ur3e", "ur5e", "ur10e"])
@pytest.mark.parametrize("gripper", GRIPPERS)
def test_goal_postures_are_distinct_and_lead_straight_to_a_grasp_with_level_pads(robot: str, gripper: str) -> None:
    scene = scene_of(cell("task=pick", f"robot={robot}", f"gripper={gripper}"))
    grasps = Grasps(scene)
    postures, place = GoalPostures(scene, grasps), np.array([0.28, 0.20, 0.04 + rise_m(scene, 0)])
    turns = list(approaches(place))
    found = postures.found(place, turns, scene.home, NEAREST, back_m=BACK_M)
    assert len(found) == NEAREST
    assert all(np.abs(one - other).max() > DISTINCT_RAD for one, other in combinations(found, 2))
    assert len(found)
    for posture in found:
        at, axes = grasps.pose(posture)
        assert place == pytest.approx(at + BACK_M * axes[:, 2], abs=2 * CLOSE_M + 0.01 * BACK_M)
        assert abs(axes[2, 0]) < 0.02, "the line from pad to pad is level"
        assert -axes[2, 2] > np.cos(TILTS_RAD[-1]) - 0.01
        assert grasps.free(posture, away=True)
        grasp = grasps.reach(posture, place, min(turns, key=lambda turn: float(np.linalg.norm(turn - axes))))
        assert grasp is not None and grasps.free(grasp)


def test_a_carried_object_keeps_clear_of_the_elbow_of_a_2f_85() -> None:
    scene = scene_of(cell("task=place", "gripper=robotiq_2f85"))
    grasps, arm = Grasps(scene), Separation(scene).arm
    place = np.array([0.28, -0.20, 0.04 + rise_m(scene, 0)])
    found = GoalPostures(scene, grasps).found(place, list(approaches(place)), scene.home, NEAREST, up_m=0.12)
    hand, inner = (np.flatnonzero(each) for each in (arm.link == arm.joints - 1, arm.link <= 2))
    share = np.linspace(0.0, 1.0, 20)
    assert len(found)
    for posture in found:
        first, second = arm.pose(posture[None]).ends[..., 0].transpose(2, 1, 0)
        points = first[:, None] + share[:, None] * (second - first)[:, None]  # (C, 20, 3)
        apart = np.linalg.norm(points[hand, None, :, None] - points[None, inner, None], axis=-1).min(axis=(2, 3))
        assert (apart - arm.radius[hand, None] - arm.radius[inner]).min() > CLEAR_M / 2


def test_a_plan_solves_inverse_kinematics_a_bounded_number_of_times_and_none_for_a_goal_that_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solve, problems = GoalPostures.solve, list[int]()

    def counted(self: GoalPostures, joints: np.ndarray, *pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        problems.append(len(joints))
        return solve(self, joints, *pose)

    monkeypatch.setattr(GoalPostures, "solve", counted)
    config = cell("task=pick", "human=none", "task.object=ball")
    engine = Engine(config, 2, 0)
    expert, state = GraspingExpert(engine.scene, config, engine.episodes.subtask), engine.reset()
    expert.act(state)
    solves, turns = sum(problems), 64
    assert 0 < solves <= 2 * 2 * SEEDS * turns
    for _ in range(3):
        state = engine.step(expert.act(state).numpy()).state
    assert sum(problems) == solves


def test_the_expert_passes_slowly_by_somebody_who_stands_beside_the_object_for_ever() -> None:
    config = cell("task=pick", "task.object=ball", *SHIELDED, *BESIDE_OBJECT)
    engine = Engine(config, 1, 0)
    expert, state = GraspingExpert(engine.scene, config, engine.episodes.subtask), engine.reset()
    assert torch.linalg.vector_norm(state.humans_pos[0, 0] - torch.tensor([0.61, 0.43])) < 0.05
    for _ in range(config.task.max_episode_steps // config.task.action_repeat):
        result = engine.step(expert.act(state).numpy())
        state = result.state
        assert not state.unsafe_contact.any()
        if result.done.any():
            break
    assert result.success.all()


def test_an_object_is_carried_at_up_to_a_metre_a_second_however_far_the_way_is() -> None:
    """An arm of this size goes over its own top."""
    config = cell("task=pick_place", "cell=bench_hand", "robot=ur10e", "task.object=puck", "human=none")
    fastest, placed = 0.0, 0
    for going, result in decisions(config, 5):
        carried = (result.instants.carried[..., 0] & result.valid).numpy() & going[:, None]
        speed = torch.linalg.vector_norm(result.instants.objects_vel[..., 0, :], dim=-1).numpy()
        fastest = max(fastest, float(np.where(carried, speed, 0.0).max()))
        placed += int((result.success.numpy() & going).sum())
    assert placed == 5 and fastest < 1.4 * CARRY_M_S


def test_a_hand_leaves_what_it_has_put_down_straight_up_however_it_is_tilted() -> None:
    """Along its tool it would come to its own base, where objects belong close to it."""
    config = cell("task=pick_place", "robot=ur10e", "task.object=cube", "task.object_jitter_m=0.07", "human=none")
    left, ways = np.full((10, 3), np.nan), np.zeros((10, 2))
    for going, result in decisions(config, 10, 4):
        state = result.state
        tool, open_ = state.tcp_pos.numpy(), (~state.pads[:, 0].any(-1) & (state.stage == 1)).numpy() & going
        left = np.where((open_ & np.isnan(left[:, 0]))[:, None], tool, left)
        way = tool - left
        ways = np.where(open_[:, None], [*zip(np.hypot(way[:, 0], way[:, 1]), way[:, 2], strict=True)], ways)
    level, up = ways.T
    assert result.success.any() and (up > 0.04).all() and (level < 0.01).all()
