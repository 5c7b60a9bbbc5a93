"""Looks change pictures alone: neither what is simulated nor what the shield reads."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.safety.geometry import _capsules
from hrl_comfort.scene import LIMBS, Scene, build_scene, limb_poses
from hrl_comfort.scene.camera import Camera
from hrl_comfort.scene.looks import COLLISION_GROUP, dressed, parts
from hrl_comfort.scene.looks.arms import ARMS, ARMS_LICENCE, FOLDER
from hrl_comfort.scene.ur import LINKS, UR_ARMS

CLOSE_M = 0.05
"""From what collides to the farthest point of an arm's looks: the corners of its base and the ends of its joints."""


def built(robot: str = "ur3e") -> Scene:
    config = compose("train")
    return build_scene(replace(config.robot, name=robot), config.cell, 2)


def test_the_simulated_cell_has_no_looks() -> None:
    model = built().model
    assert model.nmesh == 0 and (model.geom_group != COLLISION_GROUP).all()


def test_a_dressed_cell_moves_and_collides_as_the_simulated_one() -> None:
    scene = built()
    models = [scene.model, dressed(scene).model]
    rows = [mujoco.MjData(model) for model in models]
    generator = np.random.default_rng(0)
    limbs = limb_poses(0.35, 0.2, 0.0, 0.3, 0.2, scene.floor_z)  # within the arm's reach
    touched = 0
    for data in rows:
        data.mocap_pos[: len(LIMBS)], data.mocap_quat[: len(LIMBS)] = limbs[:, :3], limbs[:, 3:]
    for _ in range(300):
        target = scene.home + generator.normal(scale=0.6, size=6)
        for model, data in zip(models, rows, strict=True):
            data.ctrl[:] = target
            mujoco.mj_step(model, data)
        touched += int(rows[0].ncon > 0)
        assert all(
            np.array_equal(getattr(rows[0], name), getattr(rows[1], name)) for name in ("qpos", "qvel", "sensordata")
        )
    assert touched


@pytest.mark.parametrize("robot", UR_ARMS)
def test_the_shield_reads_the_same_capsules_with_looks(robot: str) -> None:
    scene = built(robot)
    found = []
    for model in (scene.model, dressed(scene).model):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        found.append(_capsules(model, data))
    assert len(found[0]) == len(found[1])
    for (body, ends, radius), (other, others, wide) in zip(*found, strict=True):
        assert body == other and radius == wide and np.array_equal(ends, others)


@pytest.mark.parametrize("robot", ARMS)
def test_an_arm_looks_where_it_collides(robot: str) -> None:
    scene = built(robot)
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.home
    mujoco.mj_kinematics(model, data)
    arm = [geom for geom in range(model.ngeom) if model.geom(geom).name.startswith("robot/")]
    for part in parts(scene):
        if part.body.removeprefix("robot/") not in ("base", *LINKS):
            continue
        body = data.body(part.body)
        points = body.xpos + part.vertices @ body.xmat.reshape(3, 3).T
        gaps = np.min([gap(data, geom, points) for geom in arm], axis=0)
        assert gaps.max() < CLOSE_M, part.body


def gap(data: mujoco.MjData, geom: int, points: np.ndarray) -> np.ndarray:
    """Return how far points (n, 3) are outside a capsule, (n,) m."""
    radius, half = data.model.geom_size[geom][:2]
    axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    along = np.clip((points - data.geom_xpos[geom]) @ axis, -half, half)
    return np.linalg.norm(points - data.geom_xpos[geom] - along[:, None] * axis, axis=1) - radius


def test_closed_parts_are_seen_from_outside() -> None:
    scene = built("ur10e")  # it has no meshes of its links: all parts are made here
    for part in parts(scene):
        a, b, c = np.moveaxis((part.vertices - part.vertices.mean(axis=0))[part.faces], 1, 0)
        assert np.einsum("fi,fi->", a, np.cross(b, c)) > 0, part.body


def test_every_limb_is_dressed_and_an_arm_without_meshes_stays_as_it_collides() -> None:
    assert set(LIMBS) <= {part.body for part in parts(built())}
    model = dressed(built("ur10e")).model
    assert model.geom("robot/forearm").group != COLLISION_GROUP
    assert dressed(built()).model.geom("robot/forearm").group == COLLISION_GROUP


def test_the_meshes_are_small_and_come_with_their_licence() -> None:
    files = [FOLDER / f"{robot}.npz" for robot in ARMS]
    assert sum(file.stat().st_size for file in files) < 2e6
    text = ARMS_LICENCE.read_text(encoding="utf-8")
    assert "MIT License" in text and "ROS Industrial Consortium" in text


def test_a_picture_shows_the_looks() -> None:
    scenes = [built(), dressed(built())]
    pictures = []
    for scene in scenes:
        data = mujoco.MjData(scene.model)
        data.qpos[:] = scene.home
        mujoco.mj_forward(scene.model, data)
        camera = Camera(scene.model, 60.0, -20.0, 1.5)
        pictures.append(camera.picture(data).astype(float))
        camera.close()
    assert np.abs(pictures[0] - pictures[1]).mean() > 5
