"""Draw docs/images/cell.png: an episode of the scripted expert's cycle, its tool path as dots.

hrl-comfort evaluate task=cycle policy=expert episodes=8 record=true output=/tmp/expert
MUJOCO_GL=egl python docs/images/draw_cell.py /tmp/expert docs/images/cell.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import imageio.v3 as imageio
import mujoco
import numpy as np

from hrl_comfort.config.compose import compose
from hrl_comfort.files.tables import read_table
from hrl_comfort.scene import LIMBS, build_scene, limb_poses

EPISODE, STAGE, SHARE = 1, 1, 0.65
"""Drawn where this share of the stage (1: the ball is carried) has gone by."""
WIDTH, HEIGHT = 1000, 620
COLOURS = ((0.15, 0.45, 0.9, 1), (1.0, 0.5, 0.1, 1), (0.3, 0.65, 0.3, 1))
"""Of the path's dots: to the ball, with the ball, home."""


def draw(folder: Path, output: Path) -> None:
    """Draw one recorded episode of `folder` to `output`."""
    rows = read_table(folder / "paths.csv")
    path = rows[rows["episode"] == EPISODE].reset_index(drop=True)
    config = compose("train")
    scene = build_scene(config.robot, config.cell, substeps=2)
    model, data = scene.model, mujoco.MjData(scene.model)
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    model.vis.quality.offsamples = 8

    carried = np.flatnonzero(path["stage"] == STAGE)
    now = int(carried[int(SHARE * (len(carried) - 1))])
    data.qpos[:] = [path[f"q{i}"][now] for i in range(6)]
    x, y, yaw = path["human_x"][now], path["human_y"][now], path["human_yaw"][now]
    limbs = limb_poses(x, y, yaw, 1.2, 0.35, scene.floor_z)
    data.mocap_pos[: len(LIMBS)], data.mocap_quat[: len(LIMBS)] = limbs[:, :3], limbs[:, 3:]
    data.mocap_pos[scene.mocap.index("orange_ball")] = [path[f"tcp_{axis}"][now] for axis in "xyz"]
    mujoco.mj_forward(model, data)

    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.05, 0.12, 0.15)
    camera.distance, camera.azimuth, camera.elevation = 2.9, 62, -22
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera)
        for i in range(len(rows)):
            dot = renderer.scene.geoms[renderer.scene.ngeom]
            place = np.array([path[f"tcp_{axis}"][i] for axis in "xyz"])
            colour = np.array(COLOURS[min(int(path["stage"][i]), 2)], dtype=np.float32)
            size, turn = np.full(3, 0.008), np.eye(3).ravel()
            mujoco.mjv_initGeom(dot, mujoco.mjtGeom.mjGEOM_SPHERE, size, place, turn, colour)
            renderer.scene.ngeom += 1
        imageio.imwrite(output, renderer.render())


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
