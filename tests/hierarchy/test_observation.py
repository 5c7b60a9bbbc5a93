"""The observation of the learned meta-controller."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import torch

from hrl_comfort.config.hierarchy import META_OBSERVATIONS
from hrl_comfort.hierarchy.observation import meta_observation, nearness, observation_dim
from hrl_comfort.sim.engine import Engine
from tests.hierarchy.test_sort import config


def test_the_learned_controllers_observation_is_finite_with_and_without_a_level() -> None:
    state = Engine(config(), 8, 0).reset()
    for level, layout in product((float("nan"), 3.0), META_OBSERVATIONS):
        seen = meta_observation(state.with_(level=torch.full((8,), level, dtype=torch.float64)), 10, layout)
        assert seen.shape == (8, observation_dim(layout, 4)) and bool(seen.isfinite().all())
    sizes = {layout: observation_dim(layout, 4) for layout in META_OBSERVATIONS}
    assert sizes == {"default": 18 + 9 * 4, "jobs": 15 + 12 * 4, "habits": 15 + 20 * 4}


def test_jobs_have_nearness_to_the_tool_in_the_place_of_position_and_facing() -> None:
    engine = Engine(config("human=patrol"), 8, 0)
    state = engine.reset()
    mirrored = 2 * state.tcp_pos[:, None, :2] - state.humans_seen
    there = state.with_(humans_seen=mirrored, humans_yaw=state.humans_yaw + 1.0)
    first_object = observation_dim("jobs", 0)
    seen, other = (meta_observation(each, 10, "jobs")[:, :first_object] for each in (state, there))
    torch.testing.assert_close(seen, other)
    assert not torch.allclose(meta_observation(state, 10)[:, :4], meta_observation(there, 10)[:, :4])


def test_nearness_is_one_at_the_tool_and_has_no_direction() -> None:
    state = Engine(config("human=patrol"), 8, 0).reset()
    there = [state.tcp_pos[:, None, :2] + torch.tensor(xy) for xy in ([0.0, 0.0], [0.3, 0.0], [0.0, -0.3], [0.0, 2.0])]
    at, left, right, away = (nearness(state.with_(humans_seen=each)) for each in there)
    torch.testing.assert_close(left, right)
    for near, value in ((at, 1.0), (left, 1 - 0.3 / 1.2), (away, 0.0)):
        torch.testing.assert_close(near, torch.full((8, 1), value).double())


TRACKER = ("randomise.person_noise_m=[0.02,0.02]", "randomise.person_rate_hz=[10,10]")


@pytest.mark.parametrize(
    ("overrides", "shown"),
    [((), True), (TRACKER, True), (("human.clipping=full", *TRACKER), False)],
)
def test_the_learned_controller_sees_where_people_face_unless_they_are_clipped(
    overrides: tuple[str, ...], shown: bool
) -> None:
    engine = Engine(config("human=patrol", *overrides), 8, 0)
    engine.reset()
    state = engine.step(np.zeros((8, 6))).state
    facing = torch.cat([state.humans_yaw.cos(), state.humans_yaw.sin()], dim=-1).float() * shown
    assert torch.equal(meta_observation(state, 10)[:, 2:4], facing)
