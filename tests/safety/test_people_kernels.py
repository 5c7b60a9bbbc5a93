"""The kernels by which people meet an arm agree with their numpy definition in every bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.humans.arms import drawn_back
from hrl_comfort.safety.pair_kernels import nearest_part
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.workcell import Scene, scene_of
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.people import Crowd, stop_at_contact
from tests.safety import meeting


@pytest.mark.parametrize("rows", [1, 1000])
def test_people_who_walk_into_arms_are_held_as_defined(rows: int) -> None:
    rng, config = np.random.default_rng(rows), compose_environment("train", ["task=pick", "human=worker"])
    scene = scene_of(config)
    separation, human = Separation(scene), config.human
    places = rng.uniform(-0.9, 0.9, (rows, 2))
    before = humans.begin(human, places, rng.random((rows, humans.TRAITS)))
    before = replace(
        before, yaw=rng.uniform(-3, 3, rows), limbs=np.where(rng.random((rows, 1, 1)) < 0.7, before.limbs, np.nan)
    )
    walk = replace(
        before, position=places + rng.normal(0, 0.03, places.shape), step=before.step + 1, yaw=before.yaw + 0.01
    )
    crowd = Crowd((before,), *_bodies(scene, separation, before))
    now = separation.encounter(scene.home + rng.uniform(-1, 1, (rows, len(scene.home))), crowd.limbs)
    leaving = rng.random(rows) < 0.7
    found, way = stop_at_contact(scene, separation, now, crowd, [walk.copy()], [lambda _: leaving])
    held, limbs, ends, most = meeting.stopped(
        scene, separation.arm, separation.person, now.pose.ends, now.person, before, walk.copy(), leaving
    )
    for name, value in vars(held).items():
        np.testing.assert_array_equal(getattr(found.walks[0], name), value, err_msg=name)
    np.testing.assert_array_equal(found.limbs, limbs)
    np.testing.assert_array_equal(found.ends, ends)
    assert way == most
    stays = (held.step == before.step) & (held.retreat > 0)
    moved = stays & ~np.isclose(held.limbs, before.limbs, equal_nan=True).all(axis=(1, 2))
    assert rows == 1 or (stays.sum() > 50 and moved.sum() > 10 and (stays & ~moved).sum() > 10)


def test_the_nearest_part_of_people_is_as_defined() -> None:
    scene = scene_of(compose_environment("train", ["task=pick"]))
    separation, rng = Separation(scene), np.random.default_rng(0)
    ends = separation.arm.pose(rng.uniform(-3, 3, (64, 6))).ends
    limbs = rng.normal(size=(3, len(separation.person.radius), 2, 64))
    unknown = limbs.copy()
    unknown[:, 1, 0, :1] = np.nan
    for each in (limbs, ends[:, : limbs.shape[1]].copy(), unknown, limbs[..., :0]):
        at = ends[..., : each.shape[-1]].copy()
        found = nearest_part(at, each, separation.arm.radius, separation.person.radius)
        for mine, theirs in zip(found, meeting.nearest_part(separation.arm, at, separation.person, each), strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_limbs_are_drawn_back_as_defined() -> None:
    rng, n = np.random.default_rng(0), len(LIMBS)
    limbs, yaw, away = rng.normal(size=(n, 6, 3)), rng.uniform(-3, 3, n), rng.normal(size=(n, 3))
    defined = meeting.drawn_back(limbs, yaw, np.arange(n), away)
    for index in range(n):
        found = drawn_back(limbs[index], np.cos(yaw)[index], np.sin(yaw)[index], index, away[index])
        np.testing.assert_array_equal(found, defined[index])


def _bodies(scene: Scene, separation: Separation, walk: humans.Walk) -> tuple[np.ndarray, np.ndarray]:
    """Return the limbs of people and the ends of their capsules."""
    limbs = limbs_of(scene, walk)
    return limbs, separation.person.ends(limbs)
