"""An arm with the calibration of its controller's file is where its kinematics say; other files are refused."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hrl_comfort.config import CellConfig, ConfigError, RobotConfig
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.calibration import read_deltas
from hrl_comfort.scene.ur import TOOL_LENGTH_M, UR3E, UR_ARMS, link_poses
from hrl_comfort.scene.workcell import Scene, build_scene
from tests.scene.kinematics import forward_kinematics
from tests.scene.test_scene import CELL

Array = NDArray[np.float64]
KEYS = ("theta", "a", "d", "alpha")


def written(path: Path, deltas: Array, more: str = "calibration_status = 2 # 2 == Linearised") -> str:
    """Write deltas (4, 6) as a controller does; return the path."""
    lines = [f"delta_{key} = {values.tolist()}" for key, values in zip(KEYS, deltas, strict=True)]
    path.write_text("\n".join(["[mounting]", *lines, "joint_checksum = [ 0xb630883c, 0xb61f6e2e ]", more]))
    return str(path)


def scene(calibration: str | None, robot: str = "ur3e", cell: CellConfig = CELL) -> Scene:
    return build_scene(RobotConfig(robot, None, "paper", calibration), cell, 2)


def chain(links: list[Array], joints: Array) -> Array:
    """Return the pose (4, 4) after `links` (4, 4) each, turned by `joints` (6,) rad before them."""
    pose = np.eye(4)
    for link, angle in zip(links, joints, strict=True):
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("z", angle).as_matrix()
        pose = pose @ link
    return pose


def perturbed(rng: np.random.Generator) -> list[Array]:
    """Return the links of a UR3e, each of the first five turned by up to 1 mrad and moved by up to 1 mm."""
    links = []
    for index, (place, turn, _) in enumerate(link_poses(UR3E)):
        link, size = np.eye(4), 1e-3 * (index < 5)
        link[:3, :3] = turn @ Rotation.from_rotvec(size * rng.uniform(-1, 1, 3)).as_matrix()
        link[:3, 3] = place + size * rng.uniform(-1, 1, 3)
        links.append(link)
    return links


def dh(links: list[Array]) -> Array:
    """Return theta, a, d and alpha (4, 6) of links whose last one needs no more than theta and d.

    Common normals of successive axes, as in the convention of Denavit and Hartenberg.
    """
    found, frame, pose = np.zeros((4, 6)), np.eye(4), np.eye(4)
    for index, link in enumerate(links):
        pose = pose @ link
        z, x = frame[:3, 2], frame[:3, 0]
        axis, point = pose[:3, 2], pose[:3, 3]
        if index < 5:
            normal = np.cross(z, axis)
            normal /= np.linalg.norm(normal) * np.sign(normal @ pose[:3, 0])
            along, a, back = np.linalg.solve(np.stack([z, normal, -axis], axis=1), point - frame[:3, 3])
            foot, alpha = point + back * axis, np.arctan2(np.cross(z, axis) @ normal, z @ axis)
        else:
            normal, foot, a, alpha, along = pose[:3, 0], point, 0.0, 0.0, (point - frame[:3, 3]) @ z
        found[:, index] = np.arctan2(np.cross(x, normal) @ z, x @ normal), a, along, alpha
        frame = np.eye(4)
        frame[:3] = np.stack([normal, np.cross(axis, normal), axis, foot], axis=1)
    return found


def test_a_calibrated_arm_is_where_its_kinematics_say(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    links = perturbed(rng)
    nominal = np.array([np.zeros(6), UR3E.a_m, UR3E.d_m, UR3E.alpha_rad])
    deltas = dh(links) - nominal
    assert np.abs(deltas[2]).max() > 30.0  # parallel axes: metres, as in files of controllers
    path = written(tmp_path / "calibration.conf", deltas)
    cell = scene(path)
    data, geometry = mujoco.MjData(cell.model), ArmGeometry(cell)
    for angles in rng.uniform(-np.pi, np.pi, (50, 6)):
        expected = chain(links, angles)
        data.qpos[:] = angles
        mujoco.mj_kinematics(cell.model, data)
        site = data.site("robot/flange")
        tool = expected[:3, 3] + TOOL_LENGTH_M * expected[:3, 2]
        np.testing.assert_allclose(site.xpos, expected[:3, 3], atol=1e-9)
        np.testing.assert_allclose(site.xmat.reshape(3, 3), expected[:3, :3], atol=1e-9)
        np.testing.assert_allclose(geometry.tool(angles[None])[0], tool, atol=1e-9)
    gaps = np.linalg.norm(cell.model.body_pos - scene(None).model.body_pos, axis=1)
    assert 1e-4 < gaps.max() < 5e-3


@pytest.mark.parametrize("name", UR_ARMS)
def test_small_deltas_of_every_joint_move_the_flange_as_they_say(name: str, tmp_path: Path) -> None:
    deltas = np.random.default_rng(1).uniform(-1e-3, 1e-3, (4, 6))
    deltas[3, 1:3] = 0.0  # of parallel axes
    cell = scene(written(tmp_path / "calibration.conf", deltas), name)
    model = UR_ARMS[name]
    theta, a, d, alpha = deltas + np.array([np.zeros(6), model.a_m, model.d_m, model.alpha_rad])
    angles = np.random.default_rng(2).uniform(-np.pi, np.pi, 6)
    links = []
    for k in range(6):
        link = np.eye(4)
        link[:3, :3] = Rotation.from_euler("ZX", (theta[k], alpha[k])).as_matrix()
        link[:3, 3] = a[k] * np.cos(theta[k]), a[k] * np.sin(theta[k]), d[k]
        links.append(link)
    data = mujoco.MjData(cell.model)
    data.qpos[:] = angles
    mujoco.mj_kinematics(cell.model, data)
    np.testing.assert_allclose(data.site("robot/flange").xpos, chain(links, angles)[:3, 3], atol=1e-12)
    away = data.site("robot/flange").xpos - forward_kinematics(model, angles)[:3, 3]
    assert np.linalg.norm(away) > 1e-4


def test_zero_deltas_are_the_nominal_arm(tmp_path: Path) -> None:
    assert scene(written(tmp_path / "calibration.conf", np.zeros((4, 6)))).xml == scene(None).xml


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (("[mounting]", "[other]"), r"has no section \[mounting\]: it must be a calibration.conf"),
        (("[mounting]", "\0\xff"), r"cannot be read: "),
        (("delta_a = [", "delta_b = ["), r"delta_a is None; it must be a list of 6 finite numbers"),
        (("delta_a = [0.0, ", "delta_a = ["), r"delta_a is .*; it must be a list of 6 finite numbers"),
        (("delta_a = [0.0, ", "delta_a = [1e999, "), r"delta_a is .*; it must be a list of 6 finite numbers"),
        (("delta_a = [0.0, ", "delta_a = [nonsense, "), r"delta_a is .*; it must be a list of 6 finite numbers"),
        (("delta_a = [0.0, ", "delta_a = [0.2, "), r"moves the link of shoulder_pan by 200 mm and 0 degrees; no ur3e"),
        (("status = 2", "status = 0"), r"calibration_status is 0; a calibrated arm has 2"),
    ],
)
def test_a_damaged_file_is_one_line(damage: tuple[str, str], said: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.conf"
    written(path, np.zeros((4, 6)))
    path.write_text(path.read_text().replace(*damage))
    with pytest.raises(ConfigError, match=said) as error:
        scene(str(path))
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def test_no_file_and_no_ur_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        read_deltas(str(tmp_path / "none.conf"))
    with pytest.raises(ConfigError, match=r"is for robot.name=ur3e, ur5e, ur10e; robot.name is jaco"):
        scene(written(tmp_path / "calibration.conf", np.zeros((4, 6))), "jaco")
