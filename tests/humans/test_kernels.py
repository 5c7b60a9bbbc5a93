"""People move by compiled kernels as the numpy functions that define them say, in every bit."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import HumanConfig
from hrl_comfort.humans import body
from hrl_comfort.humans.motions.kernels import social_force, strength
from hrl_comfort.humans.walk import KeepOut, Surroundings, Walk
from hrl_comfort.scene.human import limb_poses, walkers_limbs
from tests.humans.around import begin_retreat
from tests.humans.motions import FUNCTIONS, advance

Array = NDArray[np.float64]
ROWS = pytest.mark.parametrize("rows", [1, 3, 200])


class Numpy(np.ndarray):  # type: ignore[type-arg]
    """An array that is not numpy's own, so that no kernel takes it."""


def same(compiled: Any, defined: Any) -> None:
    np.testing.assert_array_equal(compiled, np.asarray(defined), strict=True)


def people(rng: np.random.Generator, rows: int) -> tuple[Walk, KeepOut]:
    """Return people who walk among discs, some of them inside."""
    walk = humans.begin(compose("train", ["human=patrol"]).human, rng.uniform(-1.5, 1.5, (rows, 2)))
    moved = walk.position + rng.normal(0, 0.3, (rows, 2))
    walk = replace(walk, velocity=rng.normal(0, 1, (rows, 3)), position=moved, yaw=rng.uniform(-9, 9, rows))
    return walk, KeepOut(rng.uniform(-1, 1, (rows, 4, 2)), 0.4)


def lively(name: str, acceleration: float | None) -> HumanConfig:
    config = compose("train", [f"human={name}", "human.bound_m=2"]).human
    return replace(config, speed_m_s=1.3, curiosity=0.7 if acceleration else 0.2, acceleration_m_s2=acceleration)


@ROWS
@pytest.mark.parametrize(
    ("name", "acceleration"),
    [*product(FUNCTIONS, (2.0,)), *product(("random_walk", "arc", "approach", "patrol"), (None,))],
)
def test_compiled_motions_are_those_of_numpy(rows: int, name: str, acceleration: float | None) -> None:
    config, rng = lively(name, acceleration), np.random.default_rng(rows)
    _, discs = people(rng, rows)
    walk = humans.begin(config, rng.uniform(-1.5, 1.5, (rows, 2)), rng.random((rows, humans.TRAITS)))
    stations, held = rng.uniform(-1.5, 1.5, (rows, 3, 2)), np.full(rows, -1)
    for step in range(300):
        points, moving = rng.normal(0, 0.5, (2, rows, 7, 3))
        points[:, 0] = np.concatenate([walk.position, np.ones((rows, 1))], axis=1)  # at them
        seen = Surroundings(points[:, -1, :2], discs, lambda: (points, moving), stations, held)  # noqa: B023
        if step % 100 == 50:
            walk = begin_retreat(walk, np.flatnonzero(rng.random(rows) < 0.5))
        noise = rng.random((rows, humans.NOISE))
        after, defined = humans.advance(config, walk, noise, seen), advance(config, walk, noise, seen)
        for field, value in vars(defined).items():
            np.testing.assert_allclose(getattr(after, field), value, rtol=0, atol=1e-12, strict=True, err_msg=field)
        walk = after


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
    compiled, defined = (limb_poses(each, y, yaw, phase, swing / 9, -0.75, limbs) for each in (x, x.view(Numpy)))
    np.testing.assert_allclose(compiled, np.asarray(defined), rtol=0, atol=1e-14, strict=True)


@ROWS
def test_limbs_of_walkers_swing_in_their_gait(rows: int) -> None:
    rng = np.random.default_rng(rows)
    walk = humans.begin(compose("train", ["human=mixture"]).human, rng.normal(size=(rows, 2)), rng.random((rows, 3)))
    walk = replace(walk, walked_m=rng.uniform(0, 9, rows), speed_m_s=rng.uniform(0, 2, rows))
    posed = limb_poses(*walk.position.T, walk.yaw, *humans.gait(walk), -0.75, walk.limbs)
    np.testing.assert_array_equal(walkers_limbs(walk, -0.75), posed, strict=True)


@ROWS
def test_arms_that_reach(rows: int) -> None:
    rng = np.random.default_rng(rows)
    for hands in (rng.normal(0, 1, (rows, 2, 3)) + body.SHOULDERS, np.tile(body.SHOULDERS, (rows, 1, 1)),
                  np.tile(body.HANGING, (rows, 1, 1))):  # fmt: skip
        same(*(body.reaching(each) for each in (hands, hands.view(Numpy))))


def test_no_force_is_stronger_than_is_looked_up_first() -> None:
    rng = np.random.default_rng(0)
    scale = 10.0 ** rng.uniform(-10, 1, (20000, 2, 1))
    scale[::7, 0] = 0.0  # at the place of the other
    for (ax, ay), (bx, by) in scale * rng.normal(size=(20000, 2, 2)):
        size = social_force(ax, ay, bx, by)[2]
        assert size == 0.0 or np.log(size) < strength(ax, ay, bx, by)
