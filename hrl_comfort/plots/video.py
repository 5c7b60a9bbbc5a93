"""A recorded episode as a small mp4: the rows of paths.csv, drawn by MuJoCo without a screen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.plots.clip import set_pose
from hrl_comfort.plots.tape import Take
from hrl_comfort.scene.camera import Camera
from hrl_comfort.scene.looks import dressed

FRAMES_PER_S = 25
ELEVATION_DEG, DISTANCE_M = -27.0, 2.9
ALONE_DEG = 75.0
"""Azimuth of the camera where nobody is there."""
APART_M, WITHIN_M = 0.5, 1.1
"""Person and tool so far apart across the view are seen well; so far to its side is still in the picture."""


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
    take: Take, speed: float = 1.0, view_deg: float | None = None, begin_s: float = 0.0, end_s: float | None = None
) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures (`scene.camera.HEIGHT`, WIDTH, 3) of a take, FRAMES_PER_S / `speed` a second of its time.

    Args:
      take: what is drawn.
      speed: 0.5 for a video at half speed.
      view_deg: azimuth of the camera; None is `azimuth_deg`.
      begin_s: time in the take at which the pictures begin.
      end_s: time at which they end; None is the end of the take.

    Raises:
      PicturesUnavailableError: there is no off-screen OpenGL.
    """
    scene = dressed(take.tape.scene)
    clip, data = take.clip, mujoco.MjData(scene.model)
    view_deg = azimuth_deg(take.path) if view_deg is None else view_deg
    with closing(Camera(scene.model, view_deg, ELEVATION_DEG, DISTANCE_M)) as camera:
        end_s = clip.duration_s if end_s is None else min(end_s, clip.duration_s)
        for time_s in np.arange(begin_s, end_s + 1e-9, speed / FRAMES_PER_S):
            set_pose(data, scene, clip.frame(time_s))
            mujoco.mj_forward(scene.model, data)
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
