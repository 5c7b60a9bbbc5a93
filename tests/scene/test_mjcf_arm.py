"""Arms from MJCF files move, weigh and collide like the files that they come from."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest

import hrl_comfort
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.safety.geometry import ArmGeometry, segment_distance
from hrl_comfort.scene import MjcfArm, build_scene, franka
from hrl_comfort.scene.jaco import JACO
from hrl_comfort.scene.robots import robot_named
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.variation.layouts import inverse_kinematics

LINK = "<geom type='capsule' fromto='0 0 0 0 0 .12' size='.03' mass='0.5'/>"
AXES = ["001", "010", "001", "010", "001", "010", "001"]


def seven(kind: str = "hinge") -> str:
    """Return an MJCF file of an upright chain of seven joints on a base, beside a floor."""
    bodies = "".join(
        f"<body name='b{i}' pos='0 0 {0.15 if i else 0.1}'>"
        f"<joint name='j{i}' axis='{' '.join(axis)}' range='-170 170' {f'type={kind!r}' if i == 6 else ''}/>{LINK}"
        for i, axis in enumerate(AXES)
    )
    tool = "<site name='tool' pos='0 0 .1'/>"
    return (
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body name='base'><geom size='.05'/>"
        f"{bodies}{tool}{'</body>' * 7}</body></worldbody></mujoco>"
    )


INERTIA = "<inertial pos='0 0 0' mass='1' diaginertia='.01 .01 .01'/>"


def xml(text: str) -> partial[mujoco.MjModel]:
    return partial(mujoco.MjModel.from_xml_string, text)


SEVEN = MjcfArm(
    name="seven",
    model=xml(seven()),
    joints=tuple(f"j{i}" for i in range(7)),
    tool="tool",
    home_deg=(0.0, 30.0, 0.0, 60.0, 0.0, 60.0, 0.0),
    torque_nm=(50.0,) * 7,
    speed_deg_s=(180.0,) * 7,
)
ARMS = pytest.mark.parametrize("arm", [JACO, SEVEN], ids=lambda arm: arm.name)


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return `robot=` for the seven-joint arm as a user would name it."""
    monkeypatch.setitem(sys.modules, "my_arm", type(sys)("my_arm"))
    monkeypatch.setattr(sys.modules["my_arm"], "SEVEN", SEVEN, raising=False)
    return "my_arm:SEVEN"


def postures(model: mujoco.MjModel, count: int) -> np.ndarray:
    low, high = model.jnt_range.T
    return np.random.default_rng(0).uniform(np.maximum(low, -np.pi), np.minimum(high, 2 * np.pi), (count, len(low)))


@ARMS
def test_tool_and_inertia_are_those_of_the_file_in_any_posture(arm: MjcfArm) -> None:
    model, source = mujoco.MjModel.from_xml_string(arm.build().to_xml_string()), arm.model()
    data, given = mujoco.MjData(model), mujoco.MjData(source)
    at = [int(source.joint(name).qposadr[0]) for name in arm.joints]
    for joints in postures(model, 5):
        data.qpos[:], given.qpos[at] = joints, joints
        full, expected = np.empty((model.nv, model.nv)), np.empty((source.nv, source.nv))
        for this, that, matrix in ((model, data, full), (source, given, expected)):
            mujoco.mj_forward(this, that)
            mujoco.mj_fullM(this, that, matrix)
        np.testing.assert_allclose(data.site("tcp").xpos, given.site(arm.tool).xpos, atol=1e-9)
        np.testing.assert_allclose(data.site("tcp").xmat, given.site(arm.tool).xmat, atol=1e-9)
        np.testing.assert_allclose(full, expected[np.ix_(at, at)], atol=1e-9)


def test_a_mounted_arm_is_the_same_arm_turned_about_the_vertical() -> None:
    tools = []
    for mount in (0.0, 90.0):
        model = mujoco.MjModel.from_xml_string(replace(SEVEN, mount_deg=mount).build().to_xml_string())
        data = mujoco.MjData(model)
        data.qpos[:] = np.radians(SEVEN.home_deg)
        mujoco.mj_kinematics(model, data)
        tools.append(data.site("tcp").xpos.copy())
    (x, y, z), turned = tools
    np.testing.assert_allclose(turned, [-y, x, z], atol=1e-12)


def test_nearly_every_vertex_of_the_file_is_within_a_centimetre_of_a_capsule() -> None:
    model, source = mujoco.MjModel.from_xml_string(JACO.build().to_xml_string()), JACO.model()
    data, given = mujoco.MjData(model), mujoco.MjData(source)
    for this, that in ((model, data), (source, given)):
        that.qpos[:] = 0.0
        mujoco.mj_kinematics(this, that)
    half = np.where(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE, model.geom_size[:, 1], 0.0)
    reach = half[:, None] * data.geom_xmat.reshape(-1, 3, 3)[:, :, 2]
    near = []
    for geom in np.flatnonzero(source.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        first, count = (int(table[source.geom_dataid[geom]]) for table in (source.mesh_vertadr, source.mesh_vertnum))
        vertices = source.mesh_vert[first : first + count] @ given.geom_xmat[geom].reshape(3, 3).T
        points = (vertices + given.geom_xpos[geom])[:, None]
        ends = ((data.geom_xpos + side * reach).T[:, None] for side in (-1, 1))
        gap = segment_distance(points.T.swapaxes(1, 2), points.T.swapaxes(1, 2), *ends) - model.geom_size[:, 0]
        near += list(gap.min(axis=1) < 0.01)
    assert np.mean(near) > 0.95


@ARMS
def test_an_arm_follows_its_set_points_within_seven_degrees(arm: MjcfArm) -> None:
    model = mujoco.MjModel.from_xml_string(arm.build().to_xml_string())
    model.opt.timestep, model.opt.integrator = 0.01, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = np.radians(arm.home_deg)
    step = np.radians(min(*arm.speed_deg_s, 100.0)) * model.opt.timestep
    for index in range(100):
        data.ctrl += step * (1 if index < 30 else 0)
        mujoco.mj_step(model, data)
        assert np.abs(data.ctrl - data.qpos).max() < np.radians(7.0)
    np.testing.assert_allclose(data.qpos, data.ctrl, atol=np.radians(0.5))


@pytest.mark.parametrize("name", ["ur3e", "jaco", "seven"])
def test_capsules_axes_and_tool_are_those_of_mujoco(name: str, module: str) -> None:
    config = environment(f"robot={module if name == 'seven' else name}")
    scene = build_scene(config.robot, config.cell, 2)
    model, data, arm = scene.model, mujoco.MjData(scene.model), ArmGeometry(scene)
    joints = postures(model, 4)
    pose, tool = arm.pose(joints), arm.tool(joints)
    capsules = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] in model.jnt_bodyid]
    assert len(capsules) == len(arm.radius)
    for row, posture in enumerate(joints):
        data.qpos[:] = posture
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(tool[row], data.site("robot/tcp").xpos, atol=1e-12)
        np.testing.assert_allclose(pose.axis[..., row].T, data.xaxis, atol=1e-12)
        np.testing.assert_allclose(pose.ends[..., row].mean(axis=2).T, data.geom_xpos[capsules], atol=1e-12)


def environment(*overrides: str) -> EnvConfig:
    config = compose("train", list(overrides))
    assert isinstance(config, EnvConfig)
    return config


def test_a_seven_joint_arm_runs_episodes(module: str) -> None:
    env = hrl_comfort.load("reach", robot=module)
    step = env.reset()
    assert env.action_spec().shape == (7,)
    assert {name: len(value) for name, value in step.observation.items()} == {
        "joint_angles": 14, "joint_error": 7, "joint_velocity": 7, "tool": 3, "human": 2, "human_from_tool": 3,
        "goal_offset": 4,
    }  # fmt: skip
    assert env.step(np.ones(7)).reward is not None
    short = {"task.max_episode_steps": 20, "robot": module}
    episodes = hrl_comfort.evaluate(lambda seen: np.zeros((len(seen), 7)), task="reach", episodes=2, **short)
    assert (episodes["human_distance_min_m"] > 0).all()
    assert len(hrl_comfort.evaluate("random", task="reach", episodes=2, **{**short, "task.action": "cartesian"})) == 2
    assert len(hrl_comfort.evaluate("potential_field", task="reach", episodes=2, **short)) == 2
    with pytest.raises(ConfigError, match=r"returned shape \(2, 6\); actions have shape \(2, 7\)"):
        hrl_comfort.evaluate(lambda seen: np.zeros((len(seen), 6)), task="reach", episodes=2, **short)
    with pytest.raises(ConfigError, match=r"my_arm:SEVEN is not allowed with policy=expert; choose one of ur3e, ur"):
        hrl_comfort.evaluate("expert", task="reach", episodes=2, **short)


def test_an_arm_of_another_file_starts_at_the_object_and_at_home() -> None:
    config = environment("robot=jaco", "task=place", "human=none")
    engine = Engine(config, 2, seed=0)
    state = engine.reset()
    assert state.joint_pos.shape == (2, 6)
    assert float((state.target_object - state.tcp_pos).norm(dim=-1).max()) < config.task.precision.grasp_tolerance_m
    engine.close()
    assert inverse_kinematics.cache_info().currsize >= 1


def test_a_mounted_arm_starts_at_an_object_beyond_the_limit_of_its_first_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    # The ball of the cell bears -173 degrees; the joint turns by 166 degrees each way from where the base faces.
    arm = replace(SEVEN, model=xml(seven().replace("-170 170", "-166 166")))
    monkeypatch.setitem(sys.modules, "my_arm", type(sys)("my_arm"))
    monkeypatch.setattr(sys.modules["my_arm"], "MOUNTED", replace(arm, mount_deg=90.0), raising=False)
    config = environment("robot=my_arm:MOUNTED", "task=place", "human=none")
    engine = Engine(config, 4, seed=0)
    state = engine.reset()
    assert float((state.target_object - state.tcp_pos).norm(dim=-1).max()) < config.task.precision.grasp_tolerance_m
    assert float(np.degrees(state.joint_pos[:, 0].abs().max())) < 166.0
    engine.close()


def capsules_of(arm: MjcfArm) -> tuple[np.ndarray, ...]:
    """Return places, directions and sizes of the built arm's capsules at home, and the place of its tool."""
    model = mujoco.MjModel.from_xml_string(arm.build().to_xml_string())
    data = mujoco.MjData(model)
    data.qpos[:] = np.radians(arm.home_deg)
    mujoco.mj_kinematics(model, data)
    return data.geom_xpos, data.geom_xmat, model.geom_size, data.site("tcp").xpos


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<body name='base'>", "<body name='base' pos='0.4 0.2 0.8'>"),
        ("<body name='base'>", "<body name='table' pos='0.4 0 0.3'><geom type='box' size='1 1 .1'/>"
                               "<body name='base' pos='0 0.2 0.5'><geom type='plane' size='0 0 1'/>"),
        ("<geom type='capsule'", "<geom contype='0' conaffinity='0' type='capsule'"),
        ("size='.03' mass='0.5'/>", "size='.03' mass='0.5'/><geom contype='0' conaffinity='0' size='.5' mass='0'/>"),
    ],
)  # fmt: skip
def test_an_arm_is_the_same_wherever_its_base_stands_and_whatever_is_drawn(old: str, new: str) -> None:
    file = seven().replace(old, new)
    file = file.replace("</worldbody>", "</body>" * (file.count("<body") - file.count("</body>")) + "</worldbody>")
    for one, other in zip(capsules_of(SEVEN), capsules_of(replace(SEVEN, model=xml(file))), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_joints_may_have_the_names_of_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    file = seven().replace("'j0'", "'base'").replace("'j1'", "'world'").replace("'j2'", "'floor'")
    arm = replace(SEVEN, model=xml(file), joints=("base", "world", "floor", *SEVEN.joints[3:]))
    monkeypatch.setitem(sys.modules, "my_arm", type(sys)("my_arm"))
    monkeypatch.setattr(sys.modules["my_arm"], "ARM", arm, raising=False)
    assert hrl_comfort.load("reach", robot="my_arm:ARM").reset().observation["joint_angles"].shape == (14,)


@pytest.mark.parametrize(
    "text", ["ARM = 1 +", "ARM = arm", "raise OSError('gone')", "import nothing_there", "ROBOT = 1"]
)
def test_a_module_of_an_arm_that_fails_on_import_gets_one_line(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"arm_{abs(hash(text))}"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=rf"robot\.name='{name}:ARM'.*(cannot be imported: .+|has no ARM)"):
        robot_named(f"{name}:ARM")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": partial(mujoco.MjModel.from_xml_path, "nowhere.xml")}, "its file does not compile: .*nowhere.xml"),
        ({"model": xml("<mujoco><worldbody><joint/></worldbody>")}, "its file does not compile: XML"),
        ({"model": xml(seven().replace("'j0'", "'arm/j0'")), "joints": ("arm/j0", *SEVEN.joints[1:])}, "has a slash"),
        ({"model": xml(seven().replace(LINK, INERTIA))},
         "the link of joint 'j0' has no shape; people would pass through it"),
        ({"model": xml(seven().replace("body name='base'", "frame pos='0 0 .7'").replace("</body></w", "</frame></w"))},
         "joint 'j0' is 0.8 m from the file's origin; put its link into a body"),
        ({"joints": ("j0", "elbow")}, "no joint 'elbow' in the file; it has j0, j1, j2, j3, j4, j5, j6"),
        ({"tool": "hand"}, "no site 'hand' in the file; it has tool"),
        ({"home_deg": (0.0,) * 6}, "must have a number for each of"),
        ({"joints": ("j0", "j1", "j3", "j2", "j4", "j5", "j6")}, "joint 'j3' does not follow the one before"),
        (
            {"joints": tuple(f"j{i}" for i in range(6)), **dict.fromkeys(("home_deg", "torque_nm", "speed_deg_s"), ())},
            "must have a number for each",
        ),
        ({"model": xml(seven("slide"))}, "joint 'j6' is not a hinge"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_such_arm_gets_one_line(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=f"robot.name='seven': .*{message}"):
        replace(SEVEN, **changes).build()


def test_a_robot_that_does_not_fit_gets_one_line(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"has 6 angles; robot.name=my_arm:SEVEN has 7 joints"):
        hrl_comfort.load("reach", robot=module, **{"robot.home_deg": [0] * 6})
    with pytest.raises(ConfigError, match="is of type str; it must be a Robot, such as MjcfArm"):
        robot_named("os:sep")
    monkeypatch.setattr(franka, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"needs the files of gymnasium-robotics: pip install --no-deps"):
        hrl_comfort.load("reach", robot="franka")
