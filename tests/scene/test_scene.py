"""The compiled cell: kinematics, limits, contacts, sensors and the human."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from hrl_comfort.config import FAR_AWAY_M, ConfigError, ObstacleConfig, RobotConfig
from hrl_comfort.humans import body
from hrl_comfort.humans.body import ARM_LENGTH_M, ARM_RADIUS_M, FOREARM_M, HIP_M, SHOULDER_M, UPPER_ARM_M
from hrl_comfort.scene import (
    CONTROL_SPEC,
    LIMBS,
    TOOL_LENGTH_M,
    Scene,
    build_scene,
    limb_poses,
)
from hrl_comfort.scene.human import LEG_RADIUS_M
from hrl_comfort.scene.ur import GRIPPER_MASS_KG, JOINTS, LINKS, UR_ARMS
from hrl_comfort.scene.workcell import DEEPEST_M
from tests.cells import PAPER
from tests.scene.kinematics import forward_kinematics

BLOCK = ObstacleConfig(shape="box", position_m=[-0.3, 0.5, 0.1], size_m=[0.1, 0.15, 0.2], yaw_deg=30.0)
CELL = replace(PAPER, obstacles={"block": BLOCK})
STILL = (
    "place_ball_table", "place_orange_table", "place_pink_table", "obstacle_block", "pedestal", "floor",
)  # fmt: skip
every_robot = pytest.mark.parametrize("name", sorted(UR_ARMS))


@cache
def scene(name: str = "ur3e", substeps: int = 2) -> Scene:
    return build_scene(RobotConfig(name=name, home_deg=None, rating="paper"), CELL, substeps)


def data_at(cell: Scene, joint_pos: np.ndarray, human: np.ndarray | None = None) -> mujoco.MjData:
    """Return the data at joint_pos (6,) rad with limbs at human (7, 7), or without a human."""
    data = mujoco.MjData(cell.model)
    data.qpos[:] = joint_pos
    if human is not None:
        data.mocap_pos[: len(LIMBS)], data.mocap_quat[: len(LIMBS)] = human[:, :3], human[:, 3:]
    mujoco.mj_forward(cell.model, data)
    return data


def touching(cell: Scene, data: mujoco.MjData) -> dict[str, list[int]]:
    """Return, for each group of contact sensors, the indices of those with a contact."""
    return {k: np.flatnonzero(data.sensordata[cell.sensors[k]]).tolist() for k in ("human", "table", "self")}


def standing(cell: Scene, x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    return limb_poses(x, y, yaw, 0.0, 0.0, cell.floor_z)


@every_robot
def test_forward_kinematics_agrees_with_an_independent_solver(name: str) -> None:
    ur_analytic_ik = pytest.importorskip("ur_analytic_ik", reason="its wheels are for Python 3.11 on x86-64")
    joint_pos = np.random.default_rng(0).uniform(-2 * np.pi, 2 * np.pi, (1000, 6))
    expected = np.stack([getattr(ur_analytic_ik, name).forward_kinematics(*q) for q in joint_pos])
    np.testing.assert_allclose(forward_kinematics(UR_ARMS[name], joint_pos), expected, rtol=0, atol=1e-6)


@every_robot
def test_compiled_flange_and_tool_are_where_the_dh_table_puts_them(name: str) -> None:
    cell = scene(name)
    data = mujoco.MjData(cell.model)
    joint_pos = np.random.default_rng(1).uniform(*cell.joint_range.T, (1000, 6))
    flange, tcp = np.tile(np.eye(4), (1000, 1, 1)), np.empty((1000, 3))
    for i, q in enumerate(joint_pos):
        data.qpos[:] = q
        mujoco.mj_kinematics(cell.model, data)
        flange[i, :3, :3] = data.site("robot/flange").xmat.reshape(3, 3)
        flange[i, :3, 3], tcp[i] = data.site("robot/flange").xpos, data.site("robot/tcp").xpos
    expected = forward_kinematics(UR_ARMS[name], joint_pos)
    np.testing.assert_allclose(flange, expected, rtol=0, atol=1e-6)
    np.testing.assert_allclose(tcp, expected[:, :3, 3] + TOOL_LENGTH_M * expected[:, :3, 2], rtol=0, atol=1e-6)


@every_robot
def test_compiled_limits_and_masses_are_the_sourced_constants(name: str) -> None:
    cell, source = scene(name), UR_ARMS[name]
    model = cell.model
    bodies = [model.body(f"robot/{link}") for link in LINKS]
    np.testing.assert_allclose([b.mass[0] for b in bodies], source.mass_kg)
    np.testing.assert_allclose([b.ipos for b in bodies], source.com_m)
    assert model.body("robot/gripper").mass[0] == pytest.approx(GRIPPER_MASS_KG)
    assert model.body("robot/").subtreemass[0] == pytest.approx(sum(source.mass_kg) + GRIPPER_MASS_KG)
    limit = np.radians(source.joint_limit_deg)
    np.testing.assert_allclose(cell.joint_range, np.stack([-limit, limit], -1))
    for i, joint in enumerate(JOINTS):
        assert model.joint(f"robot/{joint}").qposadr[0] == model.joint(f"robot/{joint}").dofadr[0] == i
        servo = model.actuator(f"robot/{joint}")
        assert servo.id == i
        np.testing.assert_allclose(servo.forcerange, [-source.torque_nm[i], source.torque_nm[i]])
        np.testing.assert_allclose(servo.ctrlrange, [-limit[i], limit[i]])
        assert model.dof_armature[i] == pytest.approx(source.armature_kg_m2[i])


def test_ur3e_constants_are_the_published_ones() -> None:
    source = UR_ARMS["ur3e"]
    assert sum(source.mass_kg) == pytest.approx(8.7985)
    assert source.a_m == (0, -0.24355, -0.2132, 0, 0, 0)
    assert source.d_m == (0.15185, 0, 0, 0.13105, 0.08535, 0.0921)
    assert source.torque_nm == (54, 54, 28, 9, 9, 9)
    assert source.joint_limit_deg == (360, 360, 180, 360, 360, 360)


def test_unknown_robot_is_refused_with_the_list_of_known_ones() -> None:
    stranger = RobotConfig(name="ur7", home_deg=None, rating="paper")
    with pytest.raises(ConfigError, match=r"robot\.name='ur7'.*ur3e, ur5e, ur10e, jaco, franka"):
        build_scene(stranger, CELL, 2)


@every_robot
def test_home_touches_nothing(name: str) -> None:
    cell = scene(name)
    data = data_at(cell, cell.home)
    assert data.ncon == 0
    # A home that is one degree off is free too.
    for offset in np.radians(np.vstack([np.eye(6), -np.eye(6)])):
        assert data_at(cell, cell.home + offset).ncon == 0


def test_overlap_with_a_limb_is_a_contact_of_that_limb_alone() -> None:
    cell = scene()
    data = data_at(cell, cell.home)
    tool = data.sensordata[cell.sensors["tcp_pos"]]
    for limb, name in enumerate(LIMBS):
        # Only this limb overlaps the tool.
        human = standing(cell, FAR_AWAY_M, 0.0)
        drop = -0.2 if name == "trunk" else 0.2 if "forearm" in name else 0.3
        human[limb, :3] = tool
        human[limb, 2] += drop
        assert touching(cell, data_at(cell, cell.home, human)) == {"human": [limb], "table": [], "self": []}


def test_human_beside_the_arm_has_contact_only_within_reach() -> None:
    cell = scene()
    stretched = np.radians([0, 0, 0, 0, 90, 0])
    for x, expected in ((-0.5, True), (-2.0, False)):
        seen = touching(cell, data_at(cell, stretched, standing(cell, x, -0.13)))
        assert bool(seen["human"]) == expected
        assert (seen["table"], seen["self"]) == ([], [])


def test_human_has_no_contact_with_the_cell_or_itself() -> None:
    cell = scene()
    for x, y, _ in CELL.goals.values():
        assert data_at(cell, cell.home, standing(cell, x, y)).ncon == 0


@pytest.mark.parametrize("obstacle", STILL)
def test_overlap_with_an_obstacle_is_a_contact_of_that_obstacle_alone(obstacle: str) -> None:
    # The long arm reaches everything, down to the floor.
    cell = scene("ur10e")
    rng = np.random.default_rng(3)
    assert cell.still == STILL
    index, found = STILL.index(obstacle), 0
    data = mujoco.MjData(cell.model)
    for joint_pos in rng.uniform(-np.pi, np.pi, (6000, 6)):
        data.qpos[:] = joint_pos
        mujoco.mj_forward(cell.model, data)
        body = cell.model.geom_bodyid[data.contact.geom].reshape(-1, 2)
        names = {cell.model.body(b).name for b in body.ravel()}
        others = {n for n in names if not n.startswith("robot/")}
        if others != {"world" if obstacle == "floor" else obstacle}:
            continue
        found += 1
        seen = touching(cell, data)
        assert (seen["table"], seen["human"]) == ([index], [])
        in_itself = any(all(cell.model.body(b).name.startswith("robot/") for b in pair) for pair in body)
        assert bool(seen["self"]) == in_itself
        if found == 5:
            return
    pytest.fail(f"no pose found that touches {obstacle} alone")


@every_robot
def test_folded_arm_has_self_contact_alone(name: str) -> None:
    cell = scene(name)
    folded = np.radians([0, -90, 175, 0, 90, 0])
    assert touching(cell, data_at(cell, folded)) == {"human": [], "table": [], "self": [0]}


def test_sensor_slices_hold_what_their_names_say() -> None:
    cell = scene()
    data = data_at(cell, np.array([0.1, -1.2, 0.3, 0.4, 1.5, 0.6]))
    data.qvel[:] = np.arange(6)
    mujoco.mj_forward(cell.model, data)
    read = {key: data.sensordata[at] for key, at in cell.sensors.items()}
    np.testing.assert_array_equal(read["joint_pos"], data.qpos)
    np.testing.assert_array_equal(read["joint_vel"], data.qvel)
    np.testing.assert_allclose(read["tcp_pos"], data.site("robot/tcp").xpos)
    assert [len(read[k]) for k in ("human", "table", "self")] == [len(LIMBS), len(STILL), 1]
    assert sum(len(v) for v in read.values()) == cell.model.nsensordata


@pytest.mark.parametrize("substeps", [1, 2, 10])
def test_control_step_is_20_ms_and_state_is_positions_and_velocities_alone(substeps: int) -> None:
    cell = scene(substeps=substeps)
    assert cell.model.opt.timestep * substeps == pytest.approx(0.02)
    assert cell.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART
    assert (cell.nstate, cell.model.na) == (1 + 6 + 6, 0)
    assert cell.ncontrol == mujoco.mj_stateSize(cell.model, CONTROL_SPEC) == 6 + 7 * len(scene().mocap)


def test_mocap_bodies_are_limbs_furniture_and_props_in_order_and_all_but_furniture_start_away() -> None:
    cell = scene()
    for index, name in enumerate(cell.mocap):
        assert cell.model.body(name).mocapid[0] == index
    assert cell.mocap[: len(LIMBS)] == LIMBS
    assert cell.model.nmocap == len(cell.mocap)
    places = mujoco.MjData(cell.model).mocap_pos
    assert (np.delete(places[:, 0], range(len(LIMBS), cell.first_prop)) >= FAR_AWAY_M - 1).all()
    np.testing.assert_array_equal(places[len(LIMBS) : cell.first_prop], cell.layout[:, :3])


def test_furniture_is_touched_where_the_control_puts_it() -> None:
    cell = scene()
    data = data_at(cell, cell.home)
    assert touching(cell, data)["table"] == []
    for index in range(4):
        moved = mujoco.MjData(cell.model)
        moved.qpos[:] = cell.home
        moved.mocap_pos[len(LIMBS) + index] = [*data.site("robot/tcp").xpos[:2], 0.3]
        mujoco.mj_forward(cell.model, moved)
        assert touching(cell, moved)["table"] == [index]


def test_the_papers_goals_are_those_of_its_balls() -> None:
    ball, orange, pink = CELL.goals.values()
    assert (ball, orange, pink) == ([-0.615, -0.070, 0.287], [0.647, -0.055, 0.273], [0.126, 0.453, 0.265])


def test_places_hold_the_object_at_the_goals() -> None:
    cell = scene()
    for name, goal in CELL.goals.items():
        data = data_at(cell, cell.home)
        top = data.geom(f"{name}_top").xpos[2] + cell.model.geom(f"{name}_top").size[2]
        assert top == pytest.approx(goal[2] - CELL.objects["orange"].half_height_m)
        np.testing.assert_allclose(data.geom(f"{name}_top").xpos[:2], goal[:2])


def test_robot_may_stand_on_the_floor() -> None:
    robot = RobotConfig(name="ur3e", home_deg=None, rating="paper")
    cell = build_scene(robot, replace(CELL, base_height_m=0.0), 2)
    assert cell.floor_z == 0.0
    assert data_at(cell, cell.home).ncon == 0
    assert touching(cell, data_at(cell, np.radians([0, 60, 0, 0, 90, 0])))["table"][-1] == STILL.index("floor")


def test_cameras_show_the_cell_although_unused_bodies_are_far_away() -> None:
    model = scene().model
    assert model.vis.map.znear * model.stat.extent < 0.1
    assert {model.camera(i).name for i in range(model.ncam)} == {"top", "side"}
    assert (model.vis.quality.shadowsize, model.vis.quality.offsamples) == (1024, 0)


def test_walking_limbs_keep_unit_quaternions_and_feet_on_the_floor() -> None:
    rng = np.random.default_rng(4)
    x, y, yaw, phase = rng.uniform(-4, 4, (4, 200))
    poses = limb_poses(x, y, yaw, phase, 0.5, -0.75)
    assert poses.shape == (200, len(LIMBS), 7)
    np.testing.assert_allclose(np.linalg.norm(poses[..., 3:], axis=-1), 1.0, atol=1e-12)
    down = np.empty(3)
    for pose, turn in zip(poses, yaw, strict=True):
        ends = []
        leg_length = HIP_M - LEG_RADIUS_M
        for limb, length in ((1, leg_length), (2, leg_length), (3, UPPER_ARM_M), (5, FOREARM_M)):
            mujoco.mju_rotVecQuat(down, np.array([0.0, 0.0, -length]), pose[limb, 3:])
            ends.append(pose[limb, :3] + down)
        assert ends[0][2] - LEG_RADIUS_M == pytest.approx(-0.75, abs=1e-9)
        assert ends[1][2] - LEG_RADIUS_M == pytest.approx(-0.75, abs=1e-9)
        # Left arm against left leg, both in the direction of walking.
        forward = np.array([np.cos(turn), np.sin(turn), 0.0])
        leg, arm = (ends[0] - pose[1, :3]) @ forward, (ends[2] - pose[3, :3]) @ forward
        assert leg * arm <= 0
        # The forearm goes on where the upper arm ends, in its direction.
        np.testing.assert_allclose(ends[2], pose[5, :3], atol=1e-12)
        assert np.linalg.norm(ends[3] - pose[3, :3]) == pytest.approx(ARM_LENGTH_M - ARM_RADIUS_M)


def test_standing_human_faces_its_yaw_with_the_left_arm_to_the_left() -> None:
    poses = limb_poses(1.0, 2.0, np.pi / 2, 0.3, 0.0, -0.75)
    np.testing.assert_allclose(poses[0, :3], [1.0, 2.0, HIP_M - 0.75])
    np.testing.assert_allclose(poses[3, :3], [1.0 - 0.18, 2.0, SHOULDER_M - 0.75])
    np.testing.assert_allclose(poses[:, 3:], np.tile([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], (7, 1)), atol=1e-12)


def test_limbs_with_directions_point_along_them_and_hang_together() -> None:
    rng = np.random.default_rng(5)
    x, y, yaw = rng.uniform(-2, 2, (3, 50))
    hands = rng.normal(size=(50, 2, 3))
    hands = body.SHOULDERS + hands / np.linalg.norm(hands, axis=-1, keepdims=True) * rng.uniform(0.2, 0.55, (50, 2, 1))
    poses = limb_poses(x, y, yaw, 0.0, 0.0, -0.75, body.reaching(hands))
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    wanted = np.stack([cos * hands[..., 0] - sin * hands[..., 1], sin * hands[..., 0] + cos * hands[..., 1]], axis=-1)
    down = np.empty(3)
    for pose, place, hand in zip(poses, np.stack([x, y], axis=-1), wanted, strict=True):
        for side in range(2):
            for limb, length in ((3 + side, UPPER_ARM_M), (5 + side, FOREARM_M)):
                mujoco.mju_rotVecQuat(down, np.array([0.0, 0.0, -length]), pose[limb, 3:])
                if limb < 5:
                    np.testing.assert_allclose(pose[limb, :3] + down, pose[limb + 2, :3], atol=1e-9)
            np.testing.assert_allclose((pose[limb, :3] + down)[:2], place + hand[side], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(poses[..., 3:], axis=-1), 1.0, atol=1e-9)


@pytest.mark.parametrize(("name", "overshoot_deg"), [("ur3e", 2.5), ("ur5e", 4.0), ("ur10e", 5.0)])
def test_servos_follow_a_full_speed_ramp_closely_and_settle(name: str, overshoot_deg: float) -> None:
    cell = build_scene(RobotConfig(name=name, home_deg=None, rating="paper"), CELL, 2)
    cell.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT  # some ramps cross a table
    start = np.radians([0, -45, 60, 0, 90, 0])
    for direction in [*np.eye(6), np.array([1, -1, 1, -1, 1, -1])]:
        data = mujoco.MjData(cell.model)
        data.qpos[:], target = start, start.copy()
        behind = np.empty((50, 6))
        for step in range(50):
            if step < 20:
                target += np.radians(2.0) * direction
            data.ctrl[:] = target
            mujoco.mj_step(cell.model, data, 2)
            behind[step] = np.degrees(target - data.qpos) * np.where(direction < 0, -1, 1)
        assert np.abs(behind[15:20]).max() < 2.5
        assert behind.min() > -overshoot_deg
        assert np.abs(behind[-10:]).max() < 0.3


def test_gravity_is_compensated() -> None:
    cell = scene()
    start = np.radians([0, -45, 60, -90, 90, 0])
    data = data_at(cell, start)
    assert data.ncon == 0
    data.ctrl[:] = start
    mujoco.mj_step(cell.model, data, 200)
    np.testing.assert_allclose(data.qpos, start, atol=1e-9)


def test_a_step_depends_on_state_and_control_alone() -> None:
    cell = scene()
    fresh, used = mujoco.MjData(cell.model), mujoco.MjData(cell.model)
    used.ctrl[:] = 0.5
    mujoco.mj_step(cell.model, used, 50)
    for data in (fresh, used):
        data.time, data.qpos[:], data.qvel[:], data.ctrl[:] = 0.0, cell.home, 0.1, cell.home + 0.05
        mujoco.mj_step(cell.model, data, 10)
    np.testing.assert_array_equal(fresh.qpos, used.qpos)
    np.testing.assert_array_equal(fresh.sensordata, used.sensordata)


@every_robot
def test_the_shoulder_is_touched_without_a_force(name: str) -> None:
    cell, found = scene(name), 0
    alone = data_at(cell, cell.home)
    for bearing in np.linspace(-np.pi, np.pi, 60):
        for radius in np.linspace(0.15, 0.35, 20):
            data = data_at(cell, cell.home, standing(cell, radius * np.cos(bearing), radius * np.sin(bearing)))
            bodies = {cell.model.body(cell.model.geom_bodyid[geom]).name for each in data.contact for geom in each.geom}
            deepest = min((each.dist for each in data.contact), default=0.0)
            if {each for each in bodies if each.startswith("robot/")} == {"robot/shoulder"} and deepest > -DEEPEST_M:
                found += 1
                assert touching(cell, data)["human"]
                np.testing.assert_allclose(data.qacc, alone.qacc, atol=1e-9)
    assert found > 10
