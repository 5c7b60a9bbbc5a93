"""People who touch the arm step back from it, wait and go on, within the bounds of their motion."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.files.run_config import environment
from hrl_comfort.humans import body
from hrl_comfort.humans.retreat import RETREAT_STEPS, STAYING
from hrl_comfort.safety.separation import Encounter, Separation
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.people import stop_at_contact
from tests.humans.around import around, begin_retreat

SPAWN = np.array([[0.8, 0.1], [-0.3, 0.7]])
NOWHERE = humans.around(np.zeros((0, 2)), 0.35, 2)


def arm() -> tuple[np.ndarray, np.ndarray]:
    """Return one point 0.3 m before each person, and at rest."""
    points = np.concatenate([SPAWN * (1 - 0.3 / np.linalg.norm(SPAWN, axis=1, keepdims=True)), np.ones((2, 1))], axis=1)
    return points[:, None], np.zeros((2, 1, 3))


def away(walk: humans.Walk) -> np.ndarray:
    return np.linalg.norm(walk.position - arm()[0][:, 0, :2], axis=1)


@pytest.mark.parametrize("name", ["approach", "patrol", "worker", "reactive", "mixture"])
def test_who_touches_the_arm_steps_back_half_a_metre(name):
    config = compose("train", [f"human={name}"]).human
    walk = begin_retreat(humans.begin(config, SPAWN), np.array([0, 1]))
    on = partial(humans.advance, config, seen=around(arm()[0][:, 0, :2], NOWHERE, arm))
    farthest, velocity = away(walk), [walk.velocity[:, :2]]
    for _ in range(RETREAT_STEPS):
        walk = on(walk, noise=np.full((2, humans.NOISE), 0.5))
        assert (away(walk) >= farthest - 1e-9).all()
        farthest = away(walk)
        velocity.append(walk.velocity[:, :2])
    assert (np.abs(farthest - 0.3 - 0.5) < 0.1).all()
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max() <= 2.0 * CONTROL_STEP_S + 1e-9
    assert not walk.retreat.any()


@pytest.mark.parametrize("sideways", [False, True])
def test_who_touches_the_arm_with_a_reaching_hand_gets_free(sideways):
    said = ["task=pick", "human=worker", "robot.rating=collaborative", "task.terminate_on=unsafe_contact"]
    env = environment(compose("train", said))
    engine = Engine(env, 1, 0)
    scene, separation = engine.scene, Separation(engine.scene)
    rng, n = np.random.default_rng(0), 2048
    angles = scene.home + rng.uniform(-1.5, 1.5, (n, len(scene.home)))
    walk = humans.begin(env.human, rng.uniform(-1, 1, (n, 2)), rng.random((n, humans.TRAITS)))
    hands = np.array([[0.4, 0.1, 1.15], [0.4, -0.1, 1.15]]) + rng.uniform(-0.2, 0.2, (n, 2, 3))
    walk = replace(walk, yaw=rng.uniform(-3, 3, n), limbs=body.reaching(hands), memory=rng.uniform(0.1, 1.1, (n, 3)))
    gap = separation.gap(angles, limbs_of(scene, walk))
    near = np.flatnonzero((gap > 0.0) & (gap < 0.1))
    angles, walk = angles[near], walk.rows(near)
    points = separation.arm.points(angles, np.zeros_like(angles))
    offset = points[0][..., :2] - walk.position[:, None]
    towards = offset[np.arange(len(near)), np.linalg.norm(offset, axis=-1).argmin(axis=1)]
    if sideways:  # a forearm may hook behind the arm
        towards = rng.normal(0, 0.5, towards.shape)
    now = separation.encounter(angles, limbs_of(scene, walk))

    leaves = [lambda walk: np.ones(len(walk.yaw), dtype=bool)]

    def stopped(ahead: humans.Walk) -> tuple[humans.Walk, Encounter]:
        crowd, _ = stop_at_contact(scene, separation, now, engine.episodes.people.crowd([walk]), [ahead], leaves)
        return crowd.walks[0], separation.encounter(angles, crowd.limbs)

    for _ in range(50):
        pressing = replace(walk, position=walk.position + 0.01 * towards)
        walk, now = stopped(pressing)
    touching = now.apart.min(axis=0) <= 0.0
    assert touching.sum() > 20
    noise, nowhere = np.full((len(near), humans.NOISE), 0.5), humans.around(np.zeros((0, 2)), 0.35, len(near))
    for _ in range(RETREAT_STEPS):
        ahead = humans.advance(env.human, walk, noise, around(np.zeros((len(near), 2)), nowhere, lambda: points))
        walk, now = stopped(ahead)
    assert (now.apart.min(axis=0)[touching] > 0.0).all()


@pytest.mark.parametrize("name", [*STAYING[:1], "still"])
def test_others_stay(name):
    config = compose("train", [f"human={name}"]).human
    fresh = humans.begin(config, SPAWN)
    walks = [fresh, begin_retreat(fresh, np.array([0, 1]))]
    for _ in range(10):
        walks = [
            humans.advance(config, walk, np.full((2, humans.NOISE), 0.5), around(SPAWN, NOWHERE, arm)) for walk in walks
        ]
    np.testing.assert_array_equal(walks[0].position, walks[1].position)
