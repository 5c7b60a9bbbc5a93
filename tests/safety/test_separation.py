"""The batched distance between arm and person is MuJoCo's own, and how fast it closes is its rate."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import TrainConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.safety.geometry import segment_distance
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.ur import UR_ARMS
from hrl_comfort.scene.workcell import build_scene
from tests.safety.search import closing_speed


@pytest.mark.parametrize("robot", [*UR_ARMS, "jaco"])
def test_arm_distance_is_mujocos_over_every_pair_of_parts(robot: str) -> None:
    config = compose("train", [f"robot={robot}"])
    assert isinstance(config, TrainConfig)
    cell = environment(config)
    scene = build_scene(cell.robot, cell.cell, 2)
    model, data = scene.model, mujoco.MjData(scene.model)
    rng = np.random.default_rng(0)
    joints = rng.uniform(-np.pi, np.pi, (40, len(scene.joints)))
    x, y = rng.uniform(-1.0, 1.0, (2, 40))
    poses = limb_poses(x, y, rng.uniform(-np.pi, np.pi, 40), rng.uniform(0, 6, 40), 0.5, scene.floor_z)
    person = [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name in LIMBS]
    base = model.body("robot/base").id
    arm = [
        g
        for g in range(model.ngeom)
        if model.body(model.geom_bodyid[g]).name.startswith("robot/") and model.geom_bodyid[g] != base
    ]
    moved = {model.body(body).name for body in range(model.nbody) if model.body_dofnum[body] > 0}
    assert {model.body(model.geom_bodyid[g]).name for g in person} == set(LIMBS), "a limb without a shape"
    assert {model.body(model.geom_bodyid[g]).name for g in arm} >= moved, "a link without a shape"
    assert len(person) == 8 and len(arm) >= 10
    measured = Separation(scene).gap(joints, poses)
    for case in range(40):
        data.qpos[:] = joints[case]
        data.mocap_pos[: len(LIMBS)], data.mocap_quat[: len(LIMBS)] = poses[case, :, :3], poses[case, :, 3:]
        mujoco.mj_kinematics(model, data)
        exact = min(mujoco.mj_geomDistance(model, data, a, p, 10.0, None) for a in arm for p in person)
        if exact > 0:  # in overlap, MuJoCo's depth is along one contact's normal
            assert measured[case] == pytest.approx(exact, abs=1e-6)
        else:
            assert measured[case] < 1e-6


def test_segments_that_cross_touch_and_parallel_ones_keep_their_distance() -> None:
    a, b, side = np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 2.0, 0])
    assert segment_distance(a, b, np.array([0.5, -1.0, 0]), np.array([0.5, 1.0, 0])) == pytest.approx(0.0)
    assert segment_distance(a, b, a + side, b + side) == pytest.approx(2.0)
    assert segment_distance(a, b, np.array([3.0, 0, 0]), np.array([4.0, 0, 0])) == pytest.approx(2.0)
    assert segment_distance(a, a, b, b) == pytest.approx(1.0)


def test_closing_speed_is_the_rate_at_which_the_arm_closes_the_gap() -> None:
    config, rng = compose("train", []), np.random.default_rng(3)
    scene = build_scene(config.robot, config.cell, 2)
    separation = Separation(scene)
    angles, velocity = rng.uniform(-3, 3, (40, 6)), rng.uniform(-1, 1, (40, 6))
    x, y, yaw, phase = rng.uniform(-1.0, 1.0, (4, 40))
    limbs, step = limb_poses(x, y, 3 * yaw, 3 * phase, 0.4, scene.floor_z), 1e-6
    apart = separation.gap(angles, limbs)
    closed = (apart - separation.gap(angles + step * velocity, limbs)) / step
    outside = apart > 0
    assert outside.sum() > 20
    assert closing_speed(separation, angles, velocity, limbs)[outside] == pytest.approx(closed[outside], abs=1e-3)
