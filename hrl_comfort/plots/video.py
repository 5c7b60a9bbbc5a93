"""A recorded episode as a small mp4: the rows of paths.csv, drawn by MuJoCo without a screen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame, Series

from hrl_comfort.config import CONTROL_STEP_S, FAR_AWAY_M, CellConfig, RobotConfig
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.tables import Floats, column
from hrl_comfort.humans.walk import FULL_SWING_RAD, FULL_SWING_SPEED_M_S, SPEED_SMOOTHING, STRIDE_M
from hrl_comfort.scene import LIMBS, build_scene, limb_poses
from hrl_comfort.scene.camera import Camera
from hrl_comfort.tasks import Ball, subtask

FRAMES_PER_S = 25
ELEVATION_DEG, DISTANCE_M = -27.0, 2.9
ALONE_DEG = 75.0
"""Azimuth of the camera where nobody is there."""
APART_M, WITHIN_M = 0.5, 1.1
"""Person and tool so far apart across the view are seen well; so far to its side is still in the picture."""


def resample(path: DataFrame, frames_per_s: float = FRAMES_PER_S) -> dict[str, Floats]:
    """Return the columns (steps,) of a recorded episode at the times of the video's frames (frames,).

    Linear between control steps, yaw without its jumps; a stage is held until the next begins.
    """
    time = column(path, "step") * CONTROL_STEP_S
    frames = np.arange(time[0], time[-1] + 1e-9, 1 / frames_per_s)
    out = {}
    for name in path:
        values = column(path, name)
        if name == "stage":
            out[name] = values[np.searchsorted(time, frames + 1e-9, side="right") - 1]
        else:
            out[name] = np.interp(frames, time, np.unwrap(values) if name == "human_yaw" else values)
    return out


def gait(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the simulated phase and swing (steps,), rad, of a person who walks along x, y (steps,), m."""
    walked = np.hypot(*(np.diff(values, prepend=values[0]) for values in (x, y)))
    speed = Series(walked / CONTROL_STEP_S).ewm(alpha=SPEED_SMOOTHING, adjust=False).mean().to_numpy()
    swing = FULL_SWING_RAD * np.minimum(speed / FULL_SWING_SPEED_M_S, 1.0)
    return 2 * math.pi * np.cumsum(walked) / STRIDE_M, swing


def _with_gait(path: DataFrame) -> DataFrame:
    """Return a path with the gait; a human who is absent stands where absent things do."""
    path = path.fillna({"human_x": FAR_AWAY_M, "human_y": 0.0, "human_yaw": 0.0})
    phase, swing = gait(column(path, "human_x"), column(path, "human_y"))
    return path.assign(phase=phase, swing=swing)


def azimuth_deg(path: DataFrame) -> float:
    """Return where the camera looks: person and tool beside each other, the person not in front of the robot."""
    person, tool = (path[names].to_numpy(dtype=float) for names in (["human_x", "human_y"], ["tcp_x", "tcp_y"]))
    if not np.abs(person).max() < FAR_AWAY_M / 2:  # nobody there
        return ALONE_DEG
    angles = np.radians(np.arange(0.0, 360.0, 15.0))
    ahead, right = np.stack([np.cos(angles), np.sin(angles)]), np.stack([np.sin(angles), -np.cos(angles)])
    apart = np.minimum(np.abs((person - tool) @ right), APART_M).mean(axis=0)
    hidden = np.maximum(-(person @ ahead), 0.0).mean(axis=0)
    outside = np.maximum(np.abs(person @ right) - WITHIN_M, 0.0).mean(axis=0)
    return float(np.degrees(angles[np.argmax(apart - hidden - outside)]))


def frames(
    path: DataFrame,
    robot: RobotConfig,
    cell: CellConfig,
    task: str,
    colour: str,
    speed: float = 1.0,
    view_deg: float | None = None,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures (`scene.camera.HEIGHT`, WIDTH, 3) of one episode, FRAMES_PER_S / `speed` a second of its time.

    Args:
      path: the episode's rows of paths.csv.
      robot: the arm.
      cell: the cell.
      task: the subtask; it says what the stages are, and so where the ball is.
      colour: orange or pink.
      speed: 0.5 for a video at half speed.
      view_deg: azimuth of the camera; None is `azimuth_deg`.

    Raises:
      PicturesUnavailableError: there is no off-screen OpenGL.
    """
    scene = build_scene(robot, cell, substeps=2)
    model, data = scene.model, mujoco.MjData(scene.model)
    shown = resample(_with_gait(path), FRAMES_PER_S / speed)
    x, y, yaw, phase, swing = (shown[name] for name in ("human_x", "human_y", "human_yaw", "phase", "swing"))
    limbs = limb_poses(x, y, yaw, phase, swing, scene.floor_z)
    goals = {Ball.TABLE: cell.ball_m, Ball.DROP: cell.orange_drop_m if colour == "orange" else cell.pink_drop_m}
    joints = [model.joint(name).qposadr[0] for name in scene.joints]
    ball = scene.mocap.index(f"{colour}_ball")
    view_deg = azimuth_deg(path) if view_deg is None else view_deg
    with closing(Camera(model, view_deg, ELEVATION_DEG, DISTANCE_M)) as camera:
        for i in range(len(shown["step"])):
            data.qpos[joints] = [shown[f"q{j}"][i] for j in range(len(joints))]
            data.mocap_pos[: len(LIMBS)], data.mocap_quat[: len(LIMBS)] = limbs[i, :, :3], limbs[i, :, 3:]
            tool = [shown[f"tcp_{axis}"][i] for axis in "xyz"]
            where = subtask(task).ball(int(shown["stage"][i]))
            if where != Ball.NOWHERE:
                data.mocap_pos[ball] = goals.get(where, tool)
            mujoco.mj_forward(model, data)
            yield camera.picture(data)


def beside(episodes: Sequence[Iterator[NDArray[np.uint8]]]) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of several episodes beside each other; one that has ended stays on its last."""
    last: list[NDArray[np.uint8] | None] = [None] * len(episodes)
    for pictures in zip_longest(*episodes):
        last = [before if now is None else now for before, now in zip(last, pictures, strict=True)]
        yield np.concatenate([each for each in last if each is not None], axis=1)


def write_video(file: Path, pictures: Iterator[NDArray[np.uint8]]) -> Path:
    """Write pictures to an mp4 that browsers play, FRAMES_PER_S a second, and return its path."""
    import imageio.v2 as imageio

    with TemporaryDirectory() as folder:
        drawn = Path(folder) / "video.mp4"
        writer: Any = imageio.get_writer(
            drawn, fps=FRAMES_PER_S, codec="libx264", quality=5, macro_block_size=2, ffmpeg_log_level="error"
        )
        with writer:
            for picture in pictures:
                writer.append_data(picture)
        write_atomically(file, lambda out: out.write(drawn.read_bytes()))
    return file
