"""Set-points keep to the rating, whatever is asked."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.safety.drive import Drive, SetPoints, make_drive
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.ratings import RATINGS
from hrl_comfort.scene.workcell import build_scene

ROWS, STEPS = 64, 300


@pytest.mark.parametrize("rating", ["collaborative", "full"])
@pytest.mark.parametrize("robot", sorted(RATINGS))
def test_set_points_keep_to_speed_acceleration_tool_speed_and_range(robot: str, rating: str) -> None:
    config = compose("train", [f"robot={robot}", f"robot.rating={rating}"])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    separation, rated, rng = Separation(scene), RATINGS[robot][rating], np.random.default_rng(0)
    drive = Drive(scene, separation, config, ROWS)
    limbs = limb_poses(np.full(ROWS, 50.0), 0.0, 0.0, 0.0, 0.0, scene.floor_z)
    low, high = scene.joint_range.T
    home = np.tile(scene.home, (ROWS, 1))
    before = SetPoints.unshielded(home, np.zeros((ROWS, 6)), np.zeros(ROWS, dtype=np.int64))
    asked = np.zeros((ROWS, 6))
    for step in range(STEPS):
        if step % 10 == 0:
            asked = rng.uniform(-1.0, 1.0, (ROWS, 6)) * rng.choice([0.1, 1.0, 8.0], (ROWS, 1))
        joints = np.concatenate([before.angles, before.velocity], axis=1)
        begin, point = drive.step(before, asked, joints, separation.encounter(before.angles, limbs))
        np.testing.assert_array_equal(begin, before.angles)
        assert (np.abs(point.velocity) <= np.radians(rated.speed_deg_s) + 1e-9).all()
        change = np.abs(point.velocity - before.velocity) / CONTROL_STEP_S
        assert (change <= np.array(rated.acceleration_rad_s2) * (1 + 1e-9)).all()
        assert (point.angles >= low).all() and (point.angles <= high).all()
        tool = drive.arm.pose(before.angles).ends[:, -1, 1] - drive.arm.pose(point.angles).ends[:, -1, 1]
        assert (np.linalg.norm(tool, axis=0) / CONTROL_STEP_S <= rated.tool_speed_m_s * 1.01).all()
        before = point


def test_joints_that_brake_together_stay_in_their_range() -> None:
    config = compose("train", ["robot.rating=collaborative"])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    separation, rng = Separation(scene), np.random.default_rng(1)
    drive = Drive(scene, separation, config, ROWS)
    limbs = limb_poses(np.full(ROWS, 50.0), 0.0, 0.0, 0.0, 0.0, scene.floor_z)
    low, high = scene.joint_range.T
    angles = np.where(rng.random((ROWS, 6)) < 0.5, low, high) + rng.uniform(-0.3, 0.3, (ROWS, 6))
    before = SetPoints.unshielded(np.clip(angles, low, high), np.zeros((ROWS, 6)), np.zeros(ROWS, dtype=np.int64))
    for step in range(STEPS):
        if step % 10 == 0:
            asked = rng.uniform(-4.0, 4.0, (ROWS, 6))
        joints = np.concatenate([before.angles, before.velocity], axis=1)
        _, after = drive.step(before, asked, joints, separation.encounter(before.angles, limbs))
        assert (after.angles >= low).all() and (after.angles <= high).all()
        np.testing.assert_allclose(after.angles, before.angles + after.velocity * CONTROL_STEP_S, atol=1e-8)
        before = after


def test_a_shield_needs_a_brake() -> None:
    config = compose("train", ["safety=ssm"])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    with pytest.raises(ConfigError, match=r"safety.kind=ssm needs an arm that brakes .* robot.rating=collaborative"):
        make_drive(scene, Separation(scene), config, 1)


@pytest.mark.parametrize("asked", ["robot.rating=full", "safety=ssm"])
def test_an_arm_without_a_known_rating_is_refused(asked: str) -> None:
    config = compose("train", ["robot=jaco", asked])
    scene = build_scene(config.robot, config.cell, config.engine.substeps)
    with pytest.raises(ConfigError, match=r"robot.name=jaco has no rating: .* are for ur3e, ur5e, ur10e; choose"):
        make_drive(scene, Separation(scene), config, 1)
