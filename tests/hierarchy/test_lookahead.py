"""Lookahead: copies that go on as the cells might, and a top that takes what is best in them on average."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hrl_comfort.config import ConfigError
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.hierarchy import look_ahead as looking
from hrl_comfort.hierarchy.decision import Top
from hrl_comfort.hierarchy.executor import execute
from hrl_comfort.hierarchy.look_ahead import LookAhead
from hrl_comfort.hierarchy.tops import due, free
from hrl_comfort.humans.motions.kernels import REACH_S
from tests.hierarchy.test_kitting import kitting, made


def test_copies_go_on_by_their_futures_and_begin_alike() -> None:
    engine, executor, _ = made(kitting("human=random_walk"), 2)
    going = execute(engine, executor, Top("free", free))
    for _ in range(10):
        next(going)
    before = engine.episodes.draw.noise.copy()
    rows, futures = torch.tensor([0, 0, 0, 1, 0]), torch.tensor([0, 0, 1, 0, 0])
    others = engine.copies(rows, futures)
    copied, drawn = executor.copies(others.episodes, rows), others.episodes.draw
    assert engine.episodes.state is not None and others.episodes.state is not None
    now = int(engine.episodes.state.steps[0])
    assert torch.equal(others.episodes.state.humans_pos, engine.episodes.state.humans_pos[rows])
    assert (drawn.noise[:3, :now] == before[0, :now]).all() and (drawn.noise[0, now:] != before[0, now:]).any()
    assert (engine.episodes.draw.noise == before).all(), "the cells themselves keep theirs"
    assert sorted(drawn.due[0].ravel()) == sorted(engine.episodes.draw.due[0].ravel())
    for _ in range(60):
        engine.step(executor.act(engine.episodes.state).numpy())
        state = others.step(copied.act(others.episodes.state).numpy()).state
    for name, value in state.fields().items():
        assert (torch.equal(value[0], value[1]) and torch.equal(value[0], value[4])) or value.isnan().any(), name
    assert not torch.equal(state.humans_pos[0], state.humans_pos[2])
    assert not torch.equal(state.humans_pos[0], engine.episodes.state.humans_pos[0])


def test_people_leave_their_stations_at_other_times_in_other_futures_unless_they_draw_their_hands_back() -> None:
    engine, executor, _ = made(kitting(), 16)
    going = execute(engine, executor, Top("free", free))
    for _ in range(80):
        next(going)
    rows, futures = torch.arange(16).repeat_interleave(3), torch.arange(3).repeat(16)
    walk, copied = engine.episodes.people.now.walks[0], engine.copies(rows, futures).episodes.people.now.walks[0]
    (here, stay), others = walk.memory[:, 1:].T, copied.memory[:, 2].reshape(16, 3)
    working = (here > 0) & (here + REACH_S < stay)
    assert 0 < working.sum() < 16, "some are on their way, or leave"
    assert (others[~working] == stay[~working, None]).all()
    assert (others[working] > here[working, None] + REACH_S).all() and (others[working] <= 1.2 * 6.0).all()
    assert all(len({*each}) == 3 for each in others[working])
    assert np.array_equal(copied.limbs, walk.limbs.repeat(3, axis=0), equal_nan=True), "nobody moves"


def test_values_are_means_over_futures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 6.0)
    engine, executor, state = made(kitting("task.max_episode_steps=500"), 1)
    decision = executor.decision(state)
    found = LookAhead(engine, executor, futures=2).values(decision)[0]
    rows, tried = torch.nonzero(decision.mask).unbind(dim=1)
    returns = torch.zeros(2, len(rows), dtype=torch.float64)
    for future in range(2):
        others = engine.copies(rows, torch.full((len(rows),), future))
        copied, first = executor.copies(others.episodes, rows), [tried]
        for step in execute(others, copied, Top("first", lambda asked: first.pop() if first else due(asked))):  # noqa: B023
            returns[future] += torch.where(step.result.state.steps <= 300, step.result.reward, 0.0) * step.active
    assert found[decision.mask[0]].tolist() == pytest.approx(returns.mean(dim=0).tolist())


def test_it_chooses_the_same_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 2.0)
    words = ("episodes=2", "task.max_episode_steps=300", "meta_controller=lookahead")
    first, again = (rollout(kitting(*words)).options for _ in range(2))
    assert first == again and len(first) > 2


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["human=recorded", "human.file=tests/humans/reach.bvh"], r"human\.motion=recorded: .* choose another motion"),
        (["comfort.source=changing", "comfort.level=null"], r"comfort\.source=changing: .* choose none, fixed, random"),
        (["disturbance=drop"], r"disturbance=drop: .* choose none"),
    ],
)
def test_what_it_would_know_ahead_is_refused(words: list[str], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        kitting("meta_controller=lookahead", *words)
