"""Capsules of arm and person are MuJoCo's; speeds and accelerations are bounds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hrl_comfort.config.compose import compose
from hrl_comfort.safety.contact import closing_speed
from hrl_comfort.safety.geometry import ArmGeometry, PersonGeometry, gaps, norm
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.ur import UR_ARMS
from hrl_comfort.scene.workcell import Scene, build_scene

ROWS = 40


def scene_of(robot: str) -> Scene:
    config = compose("train", [f"robot={robot}"])
    return build_scene(config.robot, config.cell, config.engine.substeps)


def people(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    x, y, yaw, phase = rng.uniform(-1.0, 1.0, (4, ROWS))
    return limb_poses(x, y, 3 * yaw, 3 * phase, 0.4, scene.floor_z)


@pytest.mark.parametrize("robot", [*UR_ARMS, "jaco"])
def test_gaps_are_mujocos_distances(robot: str) -> None:
    scene, rng = scene_of(robot), np.random.default_rng(0)
    arm, person = ArmGeometry(scene), PersonGeometry(scene)
    angles, limbs = rng.uniform(-3.0, 3.0, (ROWS, arm.joints)), people(scene, rng)
    found = gaps(arm, arm.pose(angles).ends, person, person.ends(limbs)).min(axis=0)
    model, data = scene.model, mujoco.MjData(scene.model)
    links = [
        g for g in range(model.ngeom) if model.geom(g).name.startswith("robot/") and "base" not in model.geom(g).name
    ]
    limb_geoms = [g for g in range(model.ngeom) if model.body_mocapid[model.geom_bodyid[g]] in range(limbs.shape[1])]
    for row in range(0, ROWS, 8):
        data.qpos[:] = angles[row]
        data.mocap_pos[: limbs.shape[1]], data.mocap_quat[: limbs.shape[1]] = limbs[row, :, :3], limbs[row, :, 3:]
        mujoco.mj_kinematics(model, data)
        apart = min(mujoco.mj_geomDistance(model, data, a, b, 10.0, None) for a in links for b in limb_geoms)
        # In deep overlap MuJoCo's depth is not that of the axes.
        assert found[row] == pytest.approx(apart, abs=1e-6) or (found[row] < -0.01 and apart < 0)


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


def test_closing_speed_is_the_rate_at_which_the_arm_closes_the_gap() -> None:
    scene, rng = scene_of("ur3e"), np.random.default_rng(3)
    arm, person = ArmGeometry(scene), PersonGeometry(scene)
    angles, velocity, limbs = rng.uniform(-3, 3, (ROWS, 6)), rng.uniform(-1, 1, (ROWS, 6)), people(scene, rng)
    step = 1e-6

    def gap(at: np.ndarray) -> np.ndarray:
        return gaps(arm, arm.pose(at).ends, person, person.ends(limbs)).min(axis=0)

    apart = gap(angles)
    closed = (apart - gap(angles + step * velocity)) / step
    outside = apart > 0
    assert outside.sum() > ROWS // 2
    assert closing_speed(arm, person, angles, velocity, limbs)[outside] == pytest.approx(closed[outside], abs=1e-3)
