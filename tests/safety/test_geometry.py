"""Speeds and accelerations of the arm's capsules are bounds."""

from __future__ import annotations

import numpy as np

from hrl_comfort.composition.compose import compose
from hrl_comfort.safety.geometry import ArmGeometry, norm
from hrl_comfort.scene.workcell import Scene, build_scene

ROWS = 40


def scene_of(robot: str) -> Scene:
    config = compose("train", [f"robot={robot}"])
    return build_scene(config.robot, config.cell, config.engine.substeps)


def test_speeds_bound_those_of_every_point_and_are_reached() -> None:
    scene, rng = scene_of("ur3e"), np.random.default_rng(1)
    arm = ArmGeometry(scene)
    angles, velocity = rng.uniform(-3.0, 3.0, (ROWS, 6)), rng.uniform(-2.0, 2.0, (ROWS, 6))
    pose = arm.pose(angles)
    step = 1e-6
    moved = norm((arm.pose(angles + step * velocity).ends - pose.ends) / step).max(axis=1)
    bound = arm.speeds(pose, velocity)
    assert (bound >= moved - 1e-4).all()
    spin = np.abs(velocity).sum(axis=1) * arm.radius[:, None]
    assert (bound <= moved + spin + 1e-4).all()


def test_bending_bounds_the_change_of_speed_at_constant_joint_rates() -> None:
    scene, rng = scene_of("ur5e"), np.random.default_rng(2)
    arm = ArmGeometry(scene)
    angles, velocity = rng.uniform(-3.0, 3.0, (ROWS, 6)), rng.uniform(-2.0, 2.0, (ROWS, 6))
    before = arm.speeds(arm.pose(angles), velocity)
    for time in (0.02, 0.1, 0.3):
        after = arm.speeds(arm.pose(angles + time * velocity), velocity)
        assert (np.abs(after - before) <= arm.bending(velocity) * time + 1e-9).all()
