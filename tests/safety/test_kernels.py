"""Compiled kernels and the numpy functions that define them agree in every bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel, plain
from hrl_comfort.composition.compose import compose
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.safety.geometry import ArmPose, farthest, gaps
from hrl_comfort.safety.separation import Encounter, Separation
from hrl_comfort.safety.shield import Motion, Shield
from hrl_comfort.scene.workcell import build_scene

Array = NDArray[np.float64]
RATED = ["task=pick", "robot.rating=collaborative", "safety=ssm", "human=mixture", "task.terminate_on=unsafe_contact"]


class Numpy(np.ndarray):  # type: ignore[type-arg]
    """An array that is not numpy's own, so that no kernel takes it."""


def both(function: Callable[..., Any], *arrays: Array) -> None:
    """Assert that `function` returns the same bits of arrays that kernels take and of those that they do not."""
    compiled, defined = function(*arrays), function(*(array.view(Numpy) for array in arrays))
    assert plain(*arrays) and not plain(arrays[0].view(Numpy))
    for mine, theirs in zip(*map(parts, (compiled, defined)), strict=True):
        np.testing.assert_array_equal(mine, np.asarray(theirs), strict=True)


def parts(found: Any) -> list[Array]:
    return [*vars(found).values()] if is_dataclass(found) else [*found] if isinstance(found, tuple) else [found]


@pytest.fixture(scope="module")
def separation() -> Separation:
    config = compose("train", ["task=pick"])
    return Separation(build_scene(config.robot, config.cell, config.engine.substeps))


@pytest.fixture(params=[1, 3, 64])
def rows(request) -> int:
    return request.param


def people(rng: np.random.Generator, rows: int) -> Array:
    limbs = rng.normal(size=(rows, 7, 7))
    limbs[..., 3:] /= np.linalg.norm(limbs[..., 3:], axis=-1, keepdims=True)
    return limbs


def test_poses_and_speeds_of_the_arm(separation: Separation, rows: int) -> None:
    rng = np.random.default_rng(rows)
    angles, velocity = rng.uniform(-4, 4, (2, rows, 6))
    for at in (angles, np.zeros_like(angles), np.full_like(angles, np.pi / 2)):
        both(separation.arm.pose, at)
        pose = separation.arm.pose(at)
        for moving in (velocity, np.zeros_like(velocity)):
            both(separation.arm.points, at, moving)
            both(separation.arm.bending, moving)
            both(lambda *given: separation.arm.speeds(ArmPose(*given[:3]), given[3]), *vars(pose).values(), moving)


def test_arrays_in_another_order_are_the_same(separation: Separation) -> None:
    rng = np.random.default_rng(0)
    joints, limbs = rng.uniform(-3, 3, (12, 5)).T, people(rng, 10)[::2]
    assert not joints.flags.c_contiguous and not limbs.flags.c_contiguous
    both(separation.arm.pose, joints[:, :6])
    both(separation.person.ends, limbs)


def test_distances_of_capsules_that_cross_touch_lie_in_line_or_are_points(separation: Separation, rows: int) -> None:
    rng = np.random.default_rng(rows)
    ends, limbs = separation.arm.pose(rng.uniform(-3, 3, (rows, 6))).ends, separation.person.ends(people(rng, rows))
    both(separation.person.ends, people(rng, rows))

    def apart(first: Array, second: Array) -> Array:
        return gaps(separation.arm, first, separation.person, second)

    both(apart, ends, limbs)
    both(farthest, limbs, rng.normal(size=limbs.shape))
    both(farthest, limbs, limbs)
    both(apart, ends, np.zeros_like(limbs))
    both(apart, np.zeros_like(ends), np.zeros_like(limbs))
    both(apart, ends, np.ascontiguousarray(ends[:, : limbs.shape[1]]))
    both(apart, ends, np.ascontiguousarray(ends[:, : limbs.shape[1]] + 1e-7))


def test_braking_and_limits_of_a_rated_arm(rows: int) -> None:
    rating, rng = rating_of(compose("train", RATED).robot), np.random.default_rng(rows)
    low, high = np.full(6, -1.0), np.full(6, 1.0)
    for scale in (0.0, 0.01, 1.0, 20.0):
        angles, before, wanted = rng.uniform(-1.1, 1.1, (rows, 6)), *rng.normal(0, scale, (2, rows, 6))
        both(rating.brake, wanted)
        both(rating.follow, before, wanted)
        both(rating.follow, wanted, wanted)
        for at in (angles, np.ones_like(angles)):
            both(lambda *given: rating.within(low, high, *given), at, wanted)
            both(lambda *given: rating.keeps(low, high, *given), at, wanted)


@pytest.mark.parametrize("bound", ["worst", "observed"])
def test_what_the_shield_holds_for_safe(separation: Separation, rows: int, bound: str) -> None:
    config, rng = compose("train", [*RATED, f"safety.bound={bound}"]), np.random.default_rng(rows)
    shield = Shield(separation, rating_of(config.robot), config.safety, rows)
    found = []
    for scale in (0.0, 0.1, 1.0):
        velocity, speeds = rng.normal(0, scale, (rows, 6)), np.abs(rng.normal(0, scale, (10, rows)))
        room, moving = rng.uniform(-0.1, 2.0, (10, rows)), np.abs(rng.normal(0, scale / 2, (10, rows)))
        pace = rng.uniform(0, 2, rows)
        both(shield._safe, velocity, speeds, room, moving, pace)
        both(shield._safe, velocity, speeds, np.full_like(room, 3.0), moving, pace)
        found += [*shield._safe(velocity, speeds, room, moving, pace)]
    assert len(set(found)) == 2, "some are safe, some are not"


def test_the_share_that_the_shield_passes(separation: Separation) -> None:
    rows, rng, config = 64, np.random.default_rng(0), compose("train", RATED)
    angles, (before, wanted) = rng.uniform(-3, 3, (rows, 6)), rng.normal(0, 0.5, (2, rows, 6))
    pose, person = separation.arm.pose(angles), rng.normal(0, 0.01, (3, 8, 2, rows))
    now = Encounter(pose, person, rng.uniform(0.0, 1.5, (10, 1)) + rng.uniform(0.0, 0.1, (10, rows)))
    motion = Motion(np.zeros((10, rows)), np.zeros((10, rows)))

    def passed(before: Array, wanted: Array) -> Array:
        shield = Shield(separation, rating_of(config.robot), config.safety, rows)
        velocity, share = shield.step(now, motion, pose, before, wanted)
        return np.concatenate([velocity, share[:, None]], axis=1)

    both(passed, before, wanted)
    assert len(set(passed(before, wanted)[:, -1])) > 3, "none of it, some of it, all of it"


def test_a_function_that_cannot_be_kept_is_compiled_all_the_same() -> None:
    found: dict[str, Any] = {}
    exec("def twice(value):\n    return 2 * value", found)  # from no file: there is no folder for its machine code
    assert kernel(found["twice"])(21.0) == 42.0
