"""Arms of people are no faster than people, and draw back from where the robot touches them."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans import body
from hrl_comfort.humans.arms import BACK_M_S, FASTEST_M_S, SPAN_M, TOLERANCE_M, drawn_back
from hrl_comfort.humans.steering import POSTURE
from hrl_comfort.scene.human import LIMBS
from tests.humans.around import around, begin_retreat

ROWS = 64


def ends(walk: humans.Walk) -> np.ndarray:
    """Return the elbows and hands (n, 4, 3) m from the shoulders, in the person's frame."""
    elbows = body.UPPER_ARM_M * walk.limbs[:, 2:4]
    return np.concatenate([elbows, elbows + body.FOREARM_M * walk.limbs[:, 4:]], axis=1)


@pytest.mark.parametrize("name", ["worker", "fetcher"])
def test_elbows_and_hands_are_as_fast_as_the_motion_of_the_person_leaves_them(name: str) -> None:
    config, rng = compose("train", [f"human={name}"]).human, np.random.default_rng(0)
    walk = humans.begin(config, rng.uniform(-1.5, 1.5, (ROWS, 2)), rng.random((ROWS, humans.TRAITS)))
    motions, discs = humans.Motions(config), humans.around(np.array([[0.4, 0.4], [0.4, -0.4]]), 0.35, ROWS)
    seen, fastest = around(np.zeros((ROWS, 2)), discs), 0.0
    for step in range(1500):
        before, walk = ends(walk), motions.advance(walk, rng.random((ROWS, humans.NOISE)), seen)
        speed = np.linalg.norm(ends(walk) - before, axis=-1).max(axis=1) / CONTROL_STEP_S
        pace = np.linalg.norm(walk.velocity[:, :2], axis=1) + SPAN_M * np.abs(walk.velocity[:, 2])
        assert (speed <= np.maximum(FASTEST_M_S - pace, 0.0) + 2 * TOLERANCE_M / CONTROL_STEP_S).all()
        fastest = max(fastest, speed.max())
        if step % 300 == 150:  # some as they reach out
            walk = begin_retreat(walk, np.flatnonzero(rng.random(ROWS) < 0.5))
    assert fastest > 0.9


def test_a_touched_arm_goes_away_and_the_other_limbs_stay() -> None:
    limbs, away = np.repeat(POSTURE[None], len(LIMBS), axis=0), np.array([0.0, 0.6, 0.8])
    yaw = np.full(len(LIMBS), np.pi / 2)  # their left is along -x, and ahead along y
    turns = np.cos(yaw), np.sin(yaw)
    moved = np.stack([drawn_back(limbs[k], turns[0][k], turns[1][k], k, away) for k in range(len(LIMBS))])
    hands, before = (body.hands(each) for each in (moved, limbs))
    ahead = (hands - before) @ [0.6, 0.0, 0.8]
    for index, limb in enumerate(LIMBS):
        for side, name in enumerate(("left", "right")):
            goes = limb in (f"{name}_upper_arm", f"{name}_forearm")
            way = np.linalg.norm(hands[index, side] - before[index, side])
            assert (ahead[index, side] > 0.0 and way <= BACK_M_S * CONTROL_STEP_S) if goes else way == 0.0
