"""Fields of State about what people did before: how long they have stood, and which way they last walked."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.hierarchy.jobs import jobs_of
from hrl_comfort.hierarchy.observation import met, turns
from hrl_comfort.humans.walk import WALKING_M_S
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State
from tests.humans.test_people import configured

KITTING = ("task=kitting", "cell=bench", "reward=kitting", "comfort=kitting")


def cells(human: str) -> tuple[Engine, State]:
    engine = Engine(configured(*KITTING, f"human={human}"), 4, 0)
    return engine, engine.reset()


@pytest.mark.parametrize("human", ["fetcher", "pair"])
def test_time_stood_begins_anew_when_someone_walks_and_the_side_is_that_of_their_last_walk(human: str) -> None:
    engine, state = cells(human)
    stood, side = torch.zeros_like(state.humans_yaw), torch.zeros_like(state.humans_yaw)
    seen = set()
    for _ in range(300):
        assert torch.allclose(state.humans_stood, stood) and torch.equal(state.humans_side, side)
        result = engine.step(np.zeros((4, 6)))
        lasted = (result.decision_steps * CONTROL_STEP_S)[:, None]
        before, after, state = state.humans_pos, result.state.humans_pos, result.state
        walks = (after - before).norm(dim=-1) / lasted > WALKING_M_S
        bearing = torch.atan2(after[..., 1], after[..., 0]) - torch.atan2(before[..., 1], before[..., 0])
        stood = torch.where(walks, 0.0, stood + lasted)
        side = torch.where(walks, bearing.sin().sign(), side)
        seen |= set(side.flatten().tolist())
    assert seen >= {1.0, -1.0} and bool((stood > 1.0).any())


def test_an_episode_begins_with_people_who_have_not_walked() -> None:
    engine, _ = cells("fetcher")
    for _ in range(100):
        engine.step(np.zeros((4, 6)))
    state = engine.reset(np.array([1, 2]))
    assert (state.humans_side[[1, 2]] == 0).all() and (state.humans_stood[[1, 2]] == 0).all()
    assert (state.humans_side[[0, 3]] != 0).all()


def test_a_controller_observes_who_comes_to_a_job_and_how_far_the_robot_has_to_turn() -> None:
    _, state = cells("fetcher")
    at = state.objects[:, :1, :2]
    behind = torch.stack([at[..., 1], -at[..., 0]], dim=-1)  # a quarter turn before the object, counter-clockwise
    for side in (1.0, -1.0, 0.0):
        beside = state.with_(
            humans_pos=behind,
            humans_side=torch.full((4, 1), side).double(),
            humans_stood=torch.full((4, 1), 5.0).double(),
        )
        found = met(beside, jobs_of(beside))[:, 0]
        expected = torch.tensor([side, 0.0, 5.0 / 20.0]).double().expand(4, 3)
        torch.testing.assert_close(found[:, [0, 2, 4]], expected)
    opposite = torch.cat([-at[:, 0], torch.full((4, 1), 0.3).double()], dim=-1)
    there = state.with_(tcp_pos=opposite)
    found = turns(there, jobs_of(there))
    torch.testing.assert_close(found[:, 0, 0], torch.ones(4).double())
    assert bool(((found >= 0) & (found <= 1)).all())
    place = torch.atan2(*state.object_places[:, 0, :2].flip(-1).unbind(-1)) - torch.atan2(*at[:, 0].flip(-1).unbind(-1))
    torch.testing.assert_close((found[:, 0, 1] * math.pi).cos(), place.cos())
