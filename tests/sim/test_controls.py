"""Control vectors are packed by a kernel as they are by numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.instants import chosen, ended_early
from hrl_comfort.scene import kernels
from hrl_comfort.scene.workcell import Scene, scene_of
from hrl_comfort.sim.controls import pack_controls

Array = NDArray[np.float64]


def packed(
    scene: Scene, targets: Array, limbs: Array, layout: Array, objects: Array, kinds: NDArray[np.int64], points: Array
) -> Array:
    n, steps, joints = len(targets), len(limbs) // len(targets), targets.shape[-1]
    poses = np.zeros((n, targets.shape[1], len(scene.mocap), 7))
    poses[..., :1], poses[..., 3] = FAR_AWAY_M, 1.0
    poses[:, :, : len(scene.limbs)] = np.repeat(limbs.reshape(n, steps, -1, 7), targets.shape[1] // steps, axis=1)
    poses[:, :, len(scene.limbs) : scene.first_prop] = layout[:, None]
    for row in range(n):
        for index in range(points.shape[1]):
            poses[row, :, scene.first_prop + index, :3] = points[row, index]
        for index, kind in enumerate(kinds[row] if not points.shape[1] else ()):
            poses[row, :, scene.first_prop + scene.object_prop(index, kind), :3] = objects[row, index]
    parts = targets, poses[..., :3].reshape(*poses.shape[:2], -1), poses[..., 3:].reshape(*poses.shape[:2], -1)
    assert joints == len(scene.joints)
    return np.concatenate(parts, axis=2)


@pytest.mark.parametrize(("said", "points"), [("task=sort", 0), ("task=pick", 0), ("task=point_to_point", 2)])
@pytest.mark.parametrize("steps", [1, 3])
def test_controls(said: str, points: int, steps: int) -> None:
    config, rng, n = compose_environment("train", [said, "human=pair"]), np.random.default_rng(0), 5
    scene, count = scene_of(config), config.task.objects
    given = (
        rng.normal(size=(n, 2 * steps, len(scene.joints))),
        rng.normal(size=(n * steps, len(scene.limbs), 7)),
        rng.normal(size=(n, len(scene.furniture), 7)),
        rng.normal(size=(n, count, 3)),
        rng.integers(len(config.cell.objects), size=(n, count)),
        rng.normal(size=(n, points, 3)),
    )
    np.testing.assert_array_equal(pack_controls(scene, *given), packed(scene, *given))


def test_sensors_that_read_something_are_felt() -> None:
    readings = np.random.default_rng(0).integers(3, size=(50, 6)) // 2 * 1.0
    readings[0, 2] = np.nan
    np.testing.assert_array_equal(kernels.felt(readings, 2, 5), readings[:, 2:5].any(axis=1), strict=True)


def test_rows_are_as_at_the_instant_at_which_they_ended() -> None:
    rng = np.random.default_rng(0)
    for last in ([3, 3, 3, 3], [3, 0, 1, 1], [0, 0, 0, 0]):
        each, at = list(rng.normal(size=(4, 4, 2))), np.array(last)
        early = ended_early(at, 4)
        np.testing.assert_array_equal(chosen(each, early), np.stack(each)[at, np.arange(4)])
        over = [np.ascontiguousarray(value.T) for value in each]
        np.testing.assert_array_equal(chosen(over, early, rows_last=True).T, chosen(each, early))
