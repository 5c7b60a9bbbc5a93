"""Places and people of a taught frame are where they were measured, and points that tell no frame are refused."""

from __future__ import annotations

import socket
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, DeployConfig
from hrl_comfort.deploy.frame import Frame
from hrl_comfort.deploy.runner import settled
from hrl_comfort.humans.motions.live import pose_source
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.scene.workcell import build_scene

TURN = Rotation.from_euler("z", 90, degrees=True).as_matrix()


def config(frame: list[list[float]], *more: str) -> DeployConfig:
    found = compose("deploy", ["policy=expert", f"connection.frame_m={frame}", *more])
    assert isinstance(found, DeployConfig)
    return found


def test_places_and_poses_of_a_taught_frame_come_out_in_that_of_the_base(tmp_path: Path) -> None:
    origin = np.array([0.3, -0.2, 0.1])
    frame = [(origin + TURN @ point).tolist() for point in ((0, 0, 0), (0.4, 0, 0), (0.7, 0.2, 0))]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        place = f"udp://127.0.0.1:{sender.getsockname()[1]}"
        sender.close()
        asked = config(frame, "cell.places.ball_table.top_m=[0.5,0.1,0.2]", "human=live", f"human.file='{place}'")
        found = settled(asked)
        np.testing.assert_allclose(
            found.cell.places["ball_table"].top_m, [0.3 - 0.1, -0.2 + 0.5, 0.1 + 0.2], atol=1e-12
        )
        assert found.connection.frame_m is None and found.cell.base_height_m == asked.cell.base_height_m
        source = pose_source(place)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as tracker:
            tracker.sendto(b"0.5 0.1 0.25", ("127.0.0.1", int(place.rsplit(":", 1)[1])))
        np.testing.assert_allclose(source(), (0.2, 0.3, 0.25 + np.pi / 2), atol=1e-12)  # type: ignore[arg-type]
        pose_source.cache_clear()


def test_points_that_the_tool_was_taken_to_give_the_frame_that_they_came_from() -> None:
    asked = config([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    arm = ArmGeometry(build_scene(asked.robot, asked.cell, 10))
    points = arm.tool(np.random.default_rng(0).uniform(-2, 2, (3, 6)))
    points[:, 2] = 0.2
    points = points if np.cross(points[1] - points[0], points[2] - points[0])[2] > 0 else points[[0, 2, 1]]
    frame = Frame.taught(points.tolist())
    local = (points - frame.origin) @ frame.axes
    np.testing.assert_allclose(local[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(local[1, 1:], 0.0, atol=1e-12)
    assert local[1, 0] > 0 and local[2, 1] > 0 and abs(local[2, 2]) < 1e-12
    np.testing.assert_allclose([frame.point(each) for each in local.tolist()], points, atol=1e-12)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([[0, 0, 0], [0.05, 0, 0], [0, 1, 0]], "the second point must be 0.1 m or more from the first"),
        ([[0, 0, 0], [1, 0, 0], [0.5, 0.05, 0]], "the third as far from the line through both"),
        ([[0, 0, 0], [1, 0, 0], [0, -1, 0]], "z is 180 degrees off .* on the side of positive y"),
        ([[0, 0, 0], [1, 0, 0.1], [0, 1, 0]], r"z is 5.71 degrees off that of the robot's base, at most 2"),
    ],
)
def test_points_that_tell_no_upright_frame_are_refused(points: list[list[float]], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Frame.taught(points)


@pytest.mark.parametrize("frame", ["[[0,0,0],[1,0,0]]", "[[0,0,0],[1,0,0],[0,1]]", "[[0,0,0],[1,0,0],[0,1,x]]"])
def test_other_than_three_points_are_refused(frame: str) -> None:
    with pytest.raises(ConfigError, match=r"connection\.frame_m"):
        compose("deploy", ["policy=expert", f"connection.frame_m={frame}"])
