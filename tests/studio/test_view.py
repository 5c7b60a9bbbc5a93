"""Meshes of the cell have the size and place of the MuJoCo geoms that they stand for."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra [studio] is not installed")

import viser

from hrl_comfort.composition.compose import compose
from hrl_comfort.humans.body import HIP_M
from hrl_comfort.humans.steering import CARRYING
from hrl_comfort.scene.ur import LINKS
from hrl_comfort.scene.workcell import build_scene
from hrl_comfort.studio.view import CellView, body_meshes, shape_mesh

SHAPE = mujoco.mjtGeom


@pytest.mark.parametrize(
    ("kind", "size", "half"),
    [
        (SHAPE.mjGEOM_SPHERE, (0.1, 0, 0), (0.1, 0.1, 0.1)),
        (SHAPE.mjGEOM_CAPSULE, (0.1, 0.3, 0), (0.1, 0.1, 0.4)),
        (SHAPE.mjGEOM_CYLINDER, (0.1, 0.3, 0), (0.1, 0.1, 0.3)),
        (SHAPE.mjGEOM_BOX, (0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
    ],
)
def test_a_mesh_is_centred_and_as_large_as_its_geom(kind: int, size: tuple, half: tuple) -> None:
    low, high = shape_mesh(kind, np.array(size, dtype=float)).bounds
    assert np.allclose(high, half, atol=0.005) and np.allclose(low, -high, atol=1e-6)


def test_a_kind_that_the_cell_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be shown"):
        shape_mesh(SHAPE.mjGEOM_HFIELD, np.ones(3))


def test_every_body_of_robot_person_and_cell_is_shown() -> None:
    config = compose("studio")
    model = build_scene(config.robot, config.cell, 2).model
    shown = {model.body(body).name for body in body_meshes(model)}
    limbs = {f"robot/{link}" for link in LINKS}
    assert {"trunk", "left_leg", "right_forearm", "pedestal", "place_ball_table", "object_1_orange"} <= shown
    assert len(limbs & shown) >= 5


def test_the_switch_shows_what_collides_in_place_of_the_looks() -> None:
    config = compose("studio")
    server = viser.ViserServer(port=0, verbose=False)
    try:
        view = CellView(server, build_scene(config.robot, config.cell, 2), "cell", (0.0, 0.0, 0.0))
        looks, shapes = view._shapes[False], view._shapes[True]
        assert len(looks) >= 25 and len(shapes) >= 20
        for shown in (False, True, False):
            view.show_collision_shapes(shown)
            assert {each.visible for each in shapes} == {shown} and {each.visible for each in looks} == {not shown}
    finally:
        server.stop()


def test_handles_at_the_hands_say_where_they_are_dragged_to() -> None:
    config = compose("studio")
    server, moved = viser.ViserServer(port=0, verbose=False), []
    try:
        view = CellView(server, build_scene(config.robot, config.cell, 2), "cell", (0.0, 0.0, 0.0))
        for _ in range(2):
            view.show_hands(CARRYING, moved.append)
        left, _ = view._handles
        assert np.allclose(left.position, CARRYING[0] - [0, 0, HIP_M])
        left.position = CARRYING[0] + [0.1, 0.0, 0.2 - HIP_M]
        with pytest.raises(StopIteration):  # the coroutine has run to its end
            left._impl_aux.update_cb[0](SimpleNamespace(target=left)).send(None)
        assert np.allclose(moved[-1] - CARRYING, [[0.1, 0.0, 0.2], [0.0, 0.0, 0.0]])
        view.show_hands(None, moved.append)
        assert not view._handles
    finally:
        server.stop()
