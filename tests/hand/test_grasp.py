"""A hand that holds: scripted grasps lift, carry and place; losses and divergence are told; people keep clear of it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig
from hrl_comfort.envs.dm import make_environment
from hrl_comfort.evaluation.handover import _terminal_states, alone, handover
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.load import make_policy
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.grippers import GRIPPERS
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.sim.variation.grasps import rise_m
from hrl_comfort.tasks.hand.observation import target_near, way_near
from tests.hand.campaign import decisions

ALONE = ("cell=grasp", "human=none", "task.object_jitter_m=0.07")


def cell(*words: str) -> EnvConfig:
    return compose_environment("train", [*ALONE, *words])


def successes(config: EnvConfig, rows: int) -> tuple[np.ndarray, list[StepResult]]:
    """Return which of the first episodes (N,) of the expert succeed, and the results of its decisions."""
    found, results = np.zeros(rows, dtype=bool), list[StepResult]()
    for going, result in decisions(config, rows):
        found |= result.success.numpy() & going
        results.append(result)
    return found, results


@pytest.mark.parametrize("gripper", GRIPPERS)
@pytest.mark.parametrize("kind", ["ball", "cube"])
@pytest.mark.parametrize("task", ["pick", "place", "return", "cycle"])
def test_the_expert_does_every_task_with_every_gripper(gripper: str, kind: str, task: str) -> None:
    found, results = successes(cell(f"gripper={gripper}", f"task={task}", f"task.object={kind}"), 6)
    assert found.all()
    assert not any(result.state.drops.any() or result.state.diverged.any() for result in results)


def test_a_gripper_of_a_user_s_own_grasps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    found, _ = successes(cell("gripper=pincer:PINCER", "task=cycle"), 4)
    assert found.all()


@pytest.mark.parametrize("robot", ["ur5e", "ur10e"])
def test_other_arms_grasp_too(robot: str) -> None:
    found, _ = successes(cell(f"robot={robot}", "task=cycle"), 4)
    assert found.all()


def test_a_rated_arm_grasps_behind_the_shield_beside_people() -> None:
    shielded = ("human=mixture", "safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact")
    found, results = successes(cell("task=pick", *shielded), 6)
    assert found.sum() >= 5, "one may be held up by somebody who stays in the way"
    assert not any(result.state.unsafe_contact.any() for result in results)


def test_an_episode_with_an_object_in_the_hand_begins_when_both_pads_touch_it() -> None:
    engine = Engine(cell("task=place", "task.object=cube"), 2, 0)
    model, begin, begun = engine.scene.model, engine.episodes.plan.begin, list[list[int]]()
    at = model.joint("object_1_cube").qposadr[0]

    def dropped_at_first(rows: np.ndarray, *others: Any) -> Any:
        planned, control = begin(rows, *others)
        if not begun:
            planned.bodies[0, at] += 0.2
        begun.append(rows.tolist())
        return planned, control

    engine.episodes.plan.begin = dropped_at_first  # type: ignore[method-assign]
    assert engine.reset().pads.all()
    assert begun[:2] == [[0, 1], [0]]


def test_people_touch_neither_an_object_that_lies_there_nor_those_that_are_not_in_the_episode() -> None:
    engine = Engine(cell("task=pick", "task.object=cube", "human=still"), 1, 0)
    model, data = engine.scene.model, mujoco.MjData(engine.scene.model)
    state = engine.reset()
    bodies = engine.physics.state[0, 1 : 1 + model.nq]
    for name in ("object_1_ball", "object_1_cube"):
        data.qpos[:] = bodies
        mujoco.mj_kinematics(model, data)
        at = data.body(name).xpos.copy()
        for limb in engine.scene.limbs:
            data.mocap_pos[model.body(limb).mocapid[0]] = at
        mujoco.mj_forward(model, data)
        limbs = [model.body(limb).id for limb in engine.scene.limbs]
        touched = model.geom_bodyid[data.contact.geom]
        assert not (np.isin(touched, limbs).any(axis=1) & (touched == model.body(name).id).any(axis=1)).any()
    assert state.objects[0, 0, 2] == pytest.approx(bodies[model.joint("object_1_cube").qposadr[0] + 2])
    parked = bodies[model.joint("object_1_ball").qposadr[0] :][:2]
    assert abs(parked[1]) > 1.0, "beside absent people, who stand at (50, 0)"


def test_an_object_that_is_let_go_is_dropped_and_one_on_the_floor_is_lost() -> None:
    config = cell("task=place", "task.object=cube")
    engine = Engine(config, 2, 0)
    state = engine.reset()
    assert state.pads.all() and state.carried.all()
    let_go = np.zeros((2, 7))
    let_go[:, 6] = -1.0
    for _ in range(6):
        result = engine.step(let_go)
    assert result.state.drops.tolist() == [1, 1] and not result.failed.any()
    bodies = engine.physics.state
    at = 1 + engine.scene.model.joint("object_1_cube").qposadr[0]
    bodies[0, at : at + 3] = (0.3, 0.7, -0.6)  # beside the table
    for _ in range(4):
        result = engine.step(let_go)
        if result.done.any():
            break
    assert result.failed.tolist() == [True, False] and result.state.object_lost.tolist() == [True, False]


def test_an_object_that_has_fallen_is_picked_where_it_lies() -> None:
    config = cell("task=place", "task.object=cube")
    engine = Engine(config, 4, 0)
    state, act = engine.reset(), make_policy("expert", engine.episodes.subtask, engine.scene, config, 0)
    done = torch.zeros(4, dtype=torch.bool)
    for decision in range(120):
        action = act(state).numpy()
        if decision < 5:
            action[:, :6], action[:, 6] = 0.0, -1.0
        result = engine.step(action)
        state, done = result.state, done | result.success
        if done.all():
            break
        state = engine.reset(np.flatnonzero(result.done.numpy()))
    assert done.all()


def test_a_hand_that_has_closed_on_nothing_opens_before_it_closes_again() -> None:
    config = cell("task=pick", "task.object=cube")
    engine = Engine(config, 1, 0)
    state, act = engine.reset(), make_policy("expert", engine.episodes.subtask, engine.scene, config, 0)
    grips, asked = list[float](), list[float]()
    for _ in range(30):
        believed = state.tcp_pos[:, None] - torch.tensor([0.0, 0.0, rise_m(engine.scene, 1)])
        action = act(state.with_(objects=believed)).numpy()
        grips.append(float(state.grip[0]))
        asked.append(float(action[0, 6]))
        state = engine.step(action).state
    closed = [grip for grip, (before, after) in zip(grips[1:], pairwise(asked), strict=True) if after > before]
    opened = [grip for grip, (before, after) in zip(grips[1:], pairwise(asked), strict=True) if after < before]
    assert len(closed) > 1 and max(closed) < 0.1
    assert len(opened) > 1 and min(opened) > 0.98


def test_physics_that_diverges_ends_the_episode_and_is_told() -> None:
    engine = Engine(cell("task=pick"), 2, 0)
    engine.reset()
    engine.physics.state[0, 1 + engine.scene.model.nq + 7] = 1e12
    result = engine.step(np.zeros((2, 7)))
    assert result.state.diverged.tolist() == [True, False] and result.terminated.tolist() == [True, False]
    known = [value for value in result.state.fields().values() if value.is_floating_point()]
    assert all((value[0].isfinite() | ~value[1].isfinite()).all() for value in known)  # NaN is what is not measured


def test_an_arm_that_begins_anew_after_physics_diverged_touches_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    config = cell("task=pick", "human=still", "comfort=distance_and_speed", "comfort.distance=arm")
    engine = Engine(config, 2, 0)
    before = engine.reset()
    engine.physics.state[0, 1 + engine.scene.model.nq + 7] = 1e12
    advance, sensors = engine.episodes.advance, engine.scene.sensors

    def touched(sensed: np.ndarray, rows: np.ndarray | None) -> StepResult:
        for name in ("human", "table", "self"):
            sensed[0, ..., sensors[name]] = 1.0
        return advance(sensed, rows)

    monkeypatch.setattr(engine.episodes, "advance", touched)
    after = engine.step(np.zeros((2, 7))).state
    assert after.diverged.tolist() == [True, False]
    names = ("joint_pos", "joint_vel", "tcp_pos", "touching", "table_collision", "self_collision", "contact")
    for name in (*names, "unsafe_contact", "arm_distance", "objects", "pads"):
        assert torch.equal(getattr(after, name)[0], getattr(before, name)[0]), name
    assert after.arm_distance.isfinite().all()


def test_a_chain_of_skills_grasps_and_tells_what_was_dropped_or_lost() -> None:
    skills = [f"policies.{name}=expert" for name in ("pick", "place", "return")]
    words = ["task=cycle", "meta_controller=nearest", *skills, "split=train", "episodes=4", "output=unused"]
    table = rollout(compose("evaluate", [*ALONE, *words])).table  # type: ignore[arg-type]
    assert table["success"].all()
    assert (table["drops"] == 0).all() and not table["object_lost"].any() and not table["diverged"].any()


def test_handover_lets_a_place_begin_with_what_the_hand_of_the_pick_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hrl_comfort.evaluation.handover.RECORDED_EPISODES", 6)
    skills = [f"policies.{name}=expert" for name in ("pick", "place", "return")]
    words = ["task=cycle", "meta_controller=nearest", *skills, "split=train", "episodes=3", f"output='{tmp_path}'"]
    config = compose("evaluate", [*ALONE, *words])
    assert isinstance(config, EvaluateConfig)
    with pytest.raises(ConfigError, match=r"^policies\.pick=expert is no run folder"):  # a gripper is none of its cares
        handover(config)
    start = _terminal_states(config, tmp_path, "pick", "expert", "ik")
    part = alone(config, "place", start, "expert")
    engine = Engine(environment(part), 3, 0)
    assert engine.reset().pads[:, 0].all()
    engine.close()
    assert rollout(part).table["success"].all()


def test_a_policy_that_was_trained_without_a_hand_says_so() -> None:
    trained = str(Path(__file__).parents[2] / "runs" / "reference" / "comfort_shift" / "levels0" / "pick")
    config = compose_environment("evaluate", [f"policy={trained}", "gripper=two_finger", "safety.clearance_m=null"])
    assert config.robot.gripper.name == "two_finger"
    engine = Engine(config, 1, 0)
    with pytest.raises(ConfigError, match="was trained with gripper=none; choose that"):
        make_policy(trained, engine.episodes.subtask, engine.scene, config, 0)


def test_fingers_and_what_they_hold_count_for_the_shield_and_people_touch_them() -> None:
    config = cell("task=pick", "human=still")
    scene = scene_of(config)
    arm = Separation(scene).arm
    assert arm.joints == 6 and len(arm.radius) - len(Separation(scene_of(cell("gripper=none"))).arm.radius) == 1
    held = max(np.linalg.norm(each.half_m) for each in config.cell.objects.values())
    assert arm.radius.max() > held
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:6] = scene.home
    mujoco.mj_kinematics(model, data)
    data.mocap_pos[:, 0] = 50.0
    side = data.site("robot/tcp").xpos + data.site("robot/tcp").xmat.reshape(3, 3)[:, 1] * (held + 0.04)
    data.mocap_pos[model.body("left_forearm").mocapid[0]] = side  # its elbow beside an empty hand
    mujoco.mj_forward(model, data)
    assert data.sensordata[scene.sensors["human"]].any()


@pytest.mark.parametrize("gripper", ["two_finger", "robotiq_2f85", "pincer:PINCER"])
def test_open_pads_lie_within_the_capsules_of_the_arm_however_small_the_objects_are(
    gripper: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    small = ("~cell.objects.ball", "cell.objects.cube.size_m=[0.0075,0.0075,0.0075]")
    scene = scene_of(cell("task=pick", f"gripper={gripper}", *small))
    model, data, arm = scene.planning, mujoco.MjData(scene.planning), Separation(scene).arm
    data.qpos[:] = scene.home
    mujoco.mj_kinematics(model, data)
    first, second = arm.pose(scene.home[None]).ends[..., 0].transpose(2, 1, 0)
    assert scene.gripper is not None
    pads = [model.body(f"robot/{name}").id for name in scene.gripper.pads]
    geoms = [
        i
        for i in range(model.ngeom)
        if model.geom_bodyid[i] in pads and model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX
    ]
    assert len(geoms) == 2
    for geom in geoms:
        for signs in product((-1, 1), repeat=3):
            at = data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ (model.geom_size[geom] * signs)
            share = ((at - first) * (second - first)).sum(axis=1) / ((second - first) ** 2).sum(axis=1).clip(1e-12)
            nearest = first + share.clip(0, 1)[:, None] * (second - first)
            assert (np.linalg.norm(at - nearest, axis=1) <= arm.radius + 1e-9).any()


def test_without_a_gripper_the_state_knows_no_hand() -> None:
    engine = Engine(compose_environment("train", ["task=pick", "human=none"]), 1, 0)
    assert not {"grip", "pads", "objects_quat", "drops"} & engine.reset().fields().keys()


def test_dm_control_and_the_batch_run_the_same_episode() -> None:
    config = cell("task=pick", "task.object=cube")
    engine, env = Engine(config, 1, 3), make_environment(config, 3)
    engine.reset()
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(8):
        action = rng.uniform(-0.3, 0.3, 7)
        batch = engine.step(action[None]).state
        env.step(action)
        one = env.task.episodes.state
        for name in ("joint_pos", "objects", "grip"):
            assert torch.equal(getattr(batch, name), getattr(one, name))


def test_episodes_go_on_exactly_from_a_saved_state() -> None:
    config = cell("task=place")
    engine, other = Engine(config, 3, 0), Engine(config, 3, 0)
    engine.reset()
    other.reset()
    actions = np.random.default_rng(0).uniform(-0.3, 1.0, (6, 3, 7))
    for action in actions[:3]:
        engine.step(action)
    other.load_state_dict(engine.state_dict())
    for action in actions[3:]:
        mine, its = engine.step(action).state, other.step(action).state
        assert all(
            torch.equal(getattr(mine, name), getattr(its, name)) for name in ("joint_pos", "objects", "aloft_steps")
        )


@pytest.mark.parametrize(
    ("root", "words", "says"),
    [
        ("train", ["gripper=two_finger", "robot.end_effector=rg2"], "both at the flange"),
        ("train", ["gripper=two_finger", "task=shift"], "slots_m has 1; add slots"),
        ("train", ["gripper=three_finger"], "is not a choice"),
    ],
)
def test_what_does_not_go_with_a_gripper_is_refused_in_one_line(root: str, words: Sequence[str], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        compose(root, words)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["robot=jaco", "gripper=two_finger"], "jaco has its own hand"),
        (["gripper=math:pi"], "must be a Gripper"),
        (["cell=grasp", "cell.objects.ball.size_m=[0.06]"], "takes up to 0.065 m"),
    ],
)
def test_what_is_no_gripper_is_refused_when_the_cell_is_built(words: Sequence[str], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        scene_of(compose_environment("train", words))


def test_offsets_from_near_have_the_tool_s_axes_and_a_scale_of_five_centimetres() -> None:
    state = Engine(cell("task=cycle"), 4, 0).reset()
    w, x, y, z = state.tcp_quat.numpy().T
    third = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    for seen, way in (
        (target_near(state), state.target_object - state.tcp_pos),
        (way_near(state), state.target_place - state.target_object),
    ):
        along = (way.numpy() * third).sum(axis=1)
        assert seen[:, 2].numpy() == pytest.approx(np.tanh(along / 0.05))
        assert ((seen.abs() <= 1) & (seen != 0)).all()
