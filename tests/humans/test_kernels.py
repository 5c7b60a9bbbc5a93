"""People move by compiled kernels as the numpy functions that define them say, in every bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.humans import body, steering
from hrl_comfort.humans.walk import KeepOut, Surroundings, Walk
from hrl_comfort.scene.human import limb_poses

Array = NDArray[np.float64]
ROWS = pytest.mark.parametrize("rows", [1, 3, 200])


class Numpy(np.ndarray):  # type: ignore[type-arg]
    """An array that is not numpy's own, so that no kernel takes it."""


def same(compiled: Any, defined: Any) -> None:
    np.testing.assert_array_equal(compiled, np.asarray(defined), strict=True)


def no_arm() -> tuple[Array, Array]:
    raise AssertionError("steering does not ask for the arm")


def people(rng: np.random.Generator, rows: int) -> tuple[Walk, KeepOut]:
    """Return people who walk among discs, some of them inside."""
    walk = humans.begin(compose("train", ["human=patrol"]).human, rng.uniform(-1.5, 1.5, (rows, 2)))
    moved = walk.position + rng.normal(0, 0.3, (rows, 2))
    walk = replace(walk, velocity=rng.normal(0, 1, (rows, 3)), position=moved, yaw=rng.uniform(-9, 9, rows))
    return walk, KeepOut(rng.uniform(-1, 1, (rows, 4, 2)), 0.4)


@ROWS
def test_steps_and_turns(rows: int) -> None:
    rng, config = np.random.default_rng(rows), compose("train", ["human=reactive"]).human
    for scale in (0.0, 0.5, 3.0):
        walk, discs = people(rng, rows)
        wanted = rng.normal(0, scale, (rows, 2))
        for around in (None, Surroundings(wanted, discs, no_arm, discs.centres, np.full(rows, -1))):
            same(*(steering.step(walk, each, config, around) for each in (wanted, wanted.view(Numpy))))
        for heading in (rng.uniform(-20, 20, rows), walk.yaw, walk.yaw + np.pi):
            same(*(steering.turn(walk, each) for each in (heading, heading.view(Numpy))))


@ROWS
def test_bounds_and_discs_of_a_step(rows: int) -> None:
    rng = np.random.default_rng(rows)
    walk, discs = people(rng, rows)
    none = KeepOut(np.empty((rows, 0, 2)), 0.0)
    for proposed in (walk.position + rng.normal(0, 0.5, (rows, 2)), walk.position, walk.spawn, discs.centres[:, 0]):
        for keep_out in (discs, none):
            held, defined = (humans._held(each, walk, keep_out, 0.4) for each in (proposed, proposed.view(Numpy)))
            same(held, defined)
        yaw = rng.uniform(-9, 9, rows)
        for mine, theirs in zip(humans._gone(held, yaw, walk), humans._gone(held, yaw.view(Numpy), walk), strict=True):
            same(mine, theirs)


@ROWS
@pytest.mark.parametrize("given", [0.0, 0.5, 1.0])
def test_poses_of_limbs_of_which_some_are_given(rows: int, given: float) -> None:
    rng = np.random.default_rng(rows)
    x, y, yaw, phase, swing = rng.uniform(-7, 7, (5, rows))
    limbs = rng.normal(size=(rows, 6, 3))
    limbs /= np.linalg.norm(limbs, axis=-1, keepdims=True)
    limbs[rng.random((rows, 6)) < 0.1] = 0.0, 0.0, 1.0  # straight up
    limbs[rng.random((rows, 6)) >= given] = np.nan
    limbs[rng.random(rows) < 0.3] = np.nan
    same(*(limb_poses(each, y, yaw, phase, swing / 9, -0.75, limbs) for each in (x, x.view(Numpy))))


@ROWS
def test_arms_that_reach(rows: int) -> None:
    rng = np.random.default_rng(rows)
    for hands in (rng.normal(0, 1, (rows, 2, 3)) + body.SHOULDERS, np.tile(body.SHOULDERS, (rows, 1, 1)),
                  np.tile(body.HANGING, (rows, 1, 1))):  # fmt: skip
        same(*(body.reaching(each) for each in (hands, hands.view(Numpy))))
