"""The arm keeps to its set-points, or they are taken back to it, so that no servo flings it at somebody."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.files.run_config import environment
from hrl_comfort.safety.drive import Drive, SetPoints, rating_of
from hrl_comfort.safety.geometry import farthest
from hrl_comfort.safety.separation import Separation
from hrl_comfort.safety.shield import LAGS, SERVO_SHARE
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.servos import SERVO_LAG_S
from hrl_comfort.scene.workcell import build_scene
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.engine import Engine
from tests.safety.persistent import PAIRS, POLICIES, run

SHIELDED = ("robot.rating=collaborative", "safety=ssm", "task.terminate_on=unsafe_contact")


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("human", ["mixture", "adversary"])
def test_policies_that_persist_provoke_no_unsafe_contact(human: str, policy: str) -> None:
    found = run("shift", human, "observed", policy, 5000, 0, 48)
    assert found.unsafe == [] and found.fastest_m_s < 0.25
    assert found.excess_rad <= 0.0 and found.contacts > 0


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("people", PAIRS)
def test_neither_do_they_beside_two_people(people: str, policy: str) -> None:
    found = run("shift", people, "observed", policy, 5000, 0, 32)
    assert found.unsafe == [] and found.fastest_m_s < 0.25
    assert found.excess_rad <= 0.0 and (found.contacts > 0 or people == "pair")


@pytest.mark.parametrize(
    ("task", "more"),
    [
        ("sort", ["human=adversary", "engine.substeps=5"]), ("cycle", ["human=mixture", "task.action_repeat=1"]),
        ("shift", ["human=adversary", "task.action_repeat=20"]), ("cycle", ["human=adversary", "robot=ur5e"]),
        ("shift", ["human=adversary", "task.action=cartesian"]),
        ("shift", ["human=mixture", "robot.home_deg=[90,-60,80,-20,90,0]"]),
        ("shift", ["human=adversary", "randomise.servo_lag_s=[0,0.1]", "randomise.latency_s=[0,0.1]",
                   "safety.lag_s=0.13", "safety.latency_s=0.1"]),
    ],
)  # fmt: skip
def test_nor_do_they_in_other_worlds(task: str, more: list[str]) -> None:
    human = more[0].removeprefix("human=")
    found = run(task, human, "worst", "held", 2000, 1, 32, *more[1:])
    assert found.unsafe == [] and found.excess_rad <= 0.0
    assert found.contacts > 0 or human != "adversary"


def test_set_points_are_taken_back_to_an_arm_that_does_not_follow() -> None:
    config = compose("train", [*SHIELDED])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    separation = Separation(scene)
    drive = Drive(scene, separation, config, 2)
    limbs = limb_poses(np.full(2, 50.0), 0.0, 0.0, 0.0, 0.0, scene.floor_z)
    angles, velocity = np.tile(scene.home, (2, 1)), np.full((2, 6), 0.1)
    before = SetPoints.unshielded(angles, velocity, np.zeros(2, dtype=np.int64))
    measured = angles - np.array([[0.9], [1.1]]) * drive.following_rad
    joints = np.concatenate([measured, np.zeros_like(measured)], axis=1)
    begin, after = drive.step(before, velocity, joints, separation.encounter(measured, limbs))
    assert (begin[0] == angles[0]).all() and (begin[1] == measured[1]).all()
    assert (after.velocity[1] == 0).all() and (after.angles[1] == measured[1]).all()
    assert after.braking.tolist() == [False, True] and after.protective_stops.tolist() == [0, 1]


def test_a_stored_swing_beside_somebody_is_taken_back_earlier_than_one_far_from_people() -> None:
    config = compose("train", [*SHIELDED])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    separation = Separation(scene)
    drive = Drive(scene, separation, config, 2)
    tool = separation.arm.tool(scene.home[None])[0]
    limbs = limb_poses(np.array([tool[0] + 0.35, 50.0]), np.full(2, tool[1]), 0.0, 0.0, 0.0, scene.floor_z)
    measured = np.tile(scene.home, (2, 1))
    angles = measured + 0.5 * drive.following_rad
    before = SetPoints.unshielded(angles, np.zeros_like(angles), np.zeros(2, dtype=np.int64))
    joints = np.concatenate([measured, np.zeros_like(measured)], axis=1)
    begin, _ = drive.step(before, np.zeros_like(angles), joints, separation.encounter(measured, limbs))
    assert (begin[0] == measured[0]).all() and (begin[1] == angles[1]).all()


@pytest.mark.parametrize("robot", ["ur3e", "ur5e", "ur10e"])
def test_an_arm_is_slow_some_lags_after_its_braking_set_points_are(robot: str) -> None:
    """It is under the safe speed LAGS lags after its set-points have fallen to SERVO_SHARE of it, and stays there."""
    config = compose("train", [f"robot={robot}", *SHIELDED])
    scene = build_scene(config.robot, config.cell, 10)
    arm, rating, rng, rows = Separation(scene).arm, rating_of(config.robot), np.random.default_rng(0), 96
    dt, ticks, joints = CONTROL_STEP_S, 10, len(scene.home)
    angles = rng.uniform(-2.5, 2.5, (rows, joints))
    angles[: rows // 2, 1:3] = [-np.pi / 2, 0.0]  # at full stretch, where servos are damped least
    velocity, points, speeds = np.zeros_like(angles), [angles], []
    asked = rng.uniform(-1.5, 1.5, angles.shape) * rng.integers(0, 2, angles.shape)
    for step in range(70):
        wanted = rating.limited(arm, arm.pose(points[-1]), asked)
        velocity = rating.follow(velocity, wanted) if step < 25 else rating.brake(velocity)
        speeds.append(arm.speeds(arm.pose(points[-1]), velocity).max(axis=0))
        points.append(points[-1] + velocity * dt)
    ramp = np.concatenate([a + np.arange(1, ticks + 1)[:, None, None] / ticks * (b - a) for a, b in pairwise(points)])
    scene.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    start = np.concatenate([np.zeros((rows, 1)), angles, np.zeros_like(angles)], axis=1)
    model_range = scene.model.actuator_ctrlrange
    model_range[:] = [-10.0, 10.0]
    scene.model.jnt_range[:] = [-10.0, 10.0]
    states, _ = rollout.rollout(
        scene.model, mujoco.MjData(scene.model), start, np.ascontiguousarray(ramp.transpose(1, 0, 2))
    )
    safe = config.safety.safe_speed_m_s
    settled = round(LAGS * SERVO_LAG_S / dt * ticks)
    for row in range(rows):
        slow = next(step for step in range(25, 70) if speeds[step][row] <= SERVO_SHARE * safe)
        late = states[row, (slow + 1) * ticks + settled :, 1:]
        real = arm.speeds(arm.pose(late[:, :joints]), late[:, joints:]).max(axis=0)
        assert real.max() < safe, (row, real.max())


def test_a_person_may_come_at_the_largest_speed_as_an_episode_begins() -> None:
    engine = Engine(environment(compose("train", [*SHIELDED, "human=still"])), 3, 0)
    engine.reset()
    drive = engine.episodes.drive
    assert drive is not None and drive.shield is not None
    state = engine.episodes.state
    assert state is not None
    now = engine.episodes.separation.encounter(state.joint_pos.numpy(), limbs_of(engine.scene, engine.episodes.walk))
    assert drive.shield._pace(now) == pytest.approx(engine.episodes.config.safety.human_speed_m_s)


@pytest.mark.parametrize(("away_m", "some"), [(-0.03, False), (-0.04, True), (0.1, False)])
def test_people_who_come_nearer_faster_than_the_shield_assumes_are_counted(away_m: float, some: bool) -> None:
    config = compose("train", [*SHIELDED])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    separation = Separation(scene)
    drive = Drive(scene, separation, config, 1)
    before, after = (limb_poses(np.full(1, x), 0.0, 0.0, 0.0, 0.0, scene.floor_z) for x in (1.0, 1.0 + away_m))
    still = np.zeros((1, len(scene.home)))
    points = SetPoints.unshielded(still, still, np.zeros(1, dtype=np.int64))
    now, ends = separation.encounter(scene.home[None], before), separation.person.ends(after)
    counted = drive.beside(points, now, ends, farthest(ends, now.person).max())
    assert bool(counted.human_beyond_bound[0]) == some


def test_people_of_the_mixture_hardly_ever_come_nearer_faster_than_the_shield_assumes() -> None:
    """Their feet swing faster; see docs/safety.md."""
    found = run("shift", "mixture", "observed", "held", 20000, 0, 128)
    assert found.human_beyond_bound < 0.001 * found.control_steps


def test_the_lateness_of_randomised_servos_widens_the_bound() -> None:
    config = compose("train", [*SHIELDED])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    later = replace(config, safety=replace(config.safety, latency_s=0.1))
    plain, wide = (Drive(scene, Separation(scene), each, 1).following_rad for each in (config, later))
    assert (wide - plain) == pytest.approx(0.1 * rating_of(config.robot).speed_rad_s)
