"""Kitting: orders that are due and fetched, decisions that show jobs, exact copies and the oracle that tries them."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from hrl_comfort.benchmarks.tops import WORDS
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy import look_ahead as looking
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Top
from hrl_comfort.hierarchy.executor import ExecutedStep, OptionExecutor, execute
from hrl_comfort.hierarchy.look_ahead import LookAhead
from hrl_comfort.hierarchy.observation import meta_observation, observation_dim
from hrl_comfort.hierarchy.tops import due, free, greedy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.objects import renewed
from hrl_comfort.tasks import State
from hrl_comfort.tasks.kitting import KITTING, fetched, missed

CELLS = {"bench": "ur3e", "station": "ur10e"}


def kitting(*words: str, cell: str = "bench") -> EvaluateConfig:
    here = [f"cell={cell}", f"robot={CELLS[cell]}", "split=validation", "output=unused"]
    found = compose("evaluate", [*WORDS, *here, *words])
    assert isinstance(found, EvaluateConfig)
    return found


def made(config: EvaluateConfig, rows: int) -> tuple[Engine, OptionExecutor, State]:
    engine = Engine(environment(config), rows, 0)
    executor, _ = make_executor(config, None, engine, 0)
    return engine, executor, engine.reset()


def at_home(state: State) -> State:
    """Return the state with nobody near."""
    return state.with_(humans_pos=torch.full_like(state.humans_pos, 50.0))


@pytest.mark.parametrize("cell", CELLS)
def test_there_is_an_order_of_each_kind_in_several_areas_and_each_belongs_elsewhere(cell: str) -> None:
    config = kitting("task.max_episode_steps=1500", "human=none", cell=cell)
    engine, executor, state = made(config, 2)
    assert state.kinds.tolist() == [list(range(6))] * 2
    kinds = config.cell.objects.values()
    assert len({each.arrives_at for each in kinds}) >= 3 and all(each.arrives_at != each.belongs_at for each in kinds)
    assert ((state.due >= 20) & (state.due <= 40)).all() and len(state.due.unique()) > 6
    steps = list(execute(engine, executor, Top("due", due)))
    last = steps[-1].result.state
    assert (KITTING.released(last.stage) >= 2).all(), "direct skills work in this cell"
    assert not any(bool(step.result.failed.any()) for step in steps)


def test_an_order_that_becomes_due_is_missed_once_and_another_is_open() -> None:
    state = at_home(made(kitting(), 2)[2])
    before = state.with_(due=torch.full_like(state.due, 30.0), placed=torch.tensor([[True] + [False] * 5] * 2))
    just, late = (before.with_(steps=torch.full_like(state.steps, steps)) for steps in (1499, 1500))
    assert missed(just, late).tolist() == [5.0, 5.0] and missed(late, late).tolist() == [0.0, 0.0]
    after = renewed(late, torch.full_like(state.due, 25.0), KITTING)
    assert after.due[0].tolist() == [30.0] + [55.0] * 5, "one that was placed in time stays closed"
    assert torch.equal(after.placed, before.placed)
    assert torch.equal(renewed(just, torch.full_like(state.due, 25.0), KITTING).due, just.due)


def test_orders_that_are_missed_are_counted_by_the_minute() -> None:
    config = kitting("meta_controller=idle", "task.due_s=[1,3]", "task.max_episode_steps=250", "episodes=2")
    for episode in rollout(config).episodes:
        count = (episode.measures["orders_missed_per_min"] or 0.0) * 250 * 0.02 / 60
        assert count == pytest.approx(round(count), abs=1e-3) and 6 <= count <= 30, "6 orders, each of 1 to 3 s"
        assert episode.measures["avoidable_discomfort_per_min"] == episode.measures["objects_per_min"] == 0.0


def test_people_who_stand_at_a_place_fetch_what_was_placed_there() -> None:
    state = made(kitting(), 1)[2]
    placed = torch.tensor([[True, True, False, False, False, False]])
    there = state.object_places[:, :1, :2] + torch.tensor([0.4, 0.0])
    standing = state.with_(placed=placed, humans_pos=there, humans_vel=torch.zeros_like(there))
    assert fetched(standing).tolist() == [[True, False, False, False, False, False]]
    assert not fetched(standing.with_(humans_vel=torch.full_like(there, 0.5))).any()
    after = renewed(standing, torch.full_like(state.due, 25.0), KITTING)
    assert after.placed.tolist() == [[False, True, False, False, False, False]]
    assert float(after.due[0, 0]) == 25.0 and torch.equal(after.due[:, 1:], state.due[:, 1:])


def test_where_the_order_that_is_next_was_filled_the_arm_picks_for_an_open_one() -> None:
    state = at_home(made(kitting(), 2)[2])
    placed = torch.tensor([[True, True] + [False] * 4, [True] * 6])
    after = renewed(state.with_(placed=placed), state.due, KITTING)
    assert after.target.tolist() == [2, 0]


@pytest.mark.parametrize("waits", ["null", "1"])
def test_with_every_order_filled_there_is_nothing_but_to_wait(waits: str) -> None:
    _, executor, state = made(kitting("meta_controller=cautious", f"meta_controller.max_waits={waits}"), 1)
    executor.option[:] = executor.table.option[executor.table.names.index("wait")]
    executor.attempt[:] = 1
    later = state.with_(placed=torch.ones_like(state.placed), steps=torch.full_like(state.steps, 40))
    mask = executor.available(later)
    assert [executor.table.names[index] for index in mask[0].nonzero()] == ["wait"]


def test_a_cell_needs_an_order_of_each_kind() -> None:
    with pytest.raises(ConfigError, match=r"one of each kind; with these cell.objects choose task.objects=2"):
        kitting("cell=paper", "task.objects=3")
    assert kitting("cell=paper").task.objects == 2


def test_jobs_show_how_near_people_are_to_both_ends_how_that_changes_and_when_orders_are_due() -> None:
    _, executor, state = made(kitting(), 1)
    place = state.objects[:, :1, :2]
    moving = state.with_(
        humans_pos=place + torch.tensor([1.0, 0.0]), humans_vel=torch.tensor([[[-0.5, 0.0]]]).double(),
        steps=torch.tensor([100]),
    )  # fmt: skip
    jobs = executor.decision(moving).jobs
    assert jobs.gap.shape == jobs.closing.shape == (1, 6, 2, 1)
    assert jobs.gap[0, 0, 0, 0] == pytest.approx(1.0) and jobs.closing[0, 0, 0, 0] == pytest.approx(0.5)
    assert torch.allclose(jobs.left, state.due - 2.0) and bool(jobs.open.all())
    seen = meta_observation(moving, 10, "jobs")
    assert seen.shape == (1, observation_dim("jobs", 6)) and bool(seen.isfinite().all())
    assert seen[0, -12 * 6 :].reshape(6, 12)[0, 9] == pytest.approx(0.5)


def test_due_takes_the_order_due_soonest_of_those_that_people_are_away_from_and_that_can_be_filled() -> None:
    _, executor, state = made(kitting(), 4)
    times = torch.tensor([30.0, 20.0, 25.0, 28.0, 26.0, 27.0]).double().expand(4, -1).clone()
    times[1, 1] = 2.0  # too late
    people = torch.full_like(state.humans_pos, 50.0)
    people[2] = torch.tensor([0.35, 0.75])  # at the station of the area on the left
    asked = state.with_(due=times, humans_pos=people)
    names = [executor.table.names[index] for index in due(executor.decision(asked))]
    assert names[:3] == ["pick_2", "pick_3", "pick_6"]
    nothing = executor.decision(asked.with_(due=torch.full_like(times, math.inf)))
    assert all(executor.table.names[index].startswith("pick") for index in due(nothing))


def test_greedy_takes_the_shortest_way_and_one_that_people_will_be_away_from() -> None:
    _, executor, state = made(kitting(), 4)
    soon, still = torch.full_like(state.due, 30.0), torch.zeros_like(state.humans_vel)
    asked = at_home(state).with_(due=soon, humans_vel=still)
    jobs = executor.decision(asked).jobs
    ways = [jobs.ends[:, :, 0] - asked.tcp_pos[:, None], jobs.ends[:, :, 1] - jobs.ends[:, :, 0]]
    shortest = sum(way.norm(dim=-1) for way in ways).argmin(dim=1)  # type: ignore[union-attr]
    rows = torch.arange(4)
    first = greedy(executor.decision(asked))
    assert [executor.table.names[index] for index in first] == [f"pick_{index + 1}" for index in shortest]
    beside = jobs.ends[rows, shortest, 0, None, :2] + torch.tensor([0.5, 0.0])
    late = soon.clone()
    late[rows, shortest] = 2.0
    leaving = torch.tensor([1.5, 0.0]).expand_as(still)
    assert (greedy(executor.decision(asked.with_(humans_pos=beside))) != first).all()
    assert (greedy(executor.decision(asked.with_(humans_pos=beside, humans_vel=leaving))) == first).all()
    assert (greedy(executor.decision(asked.with_(due=late))) != first).all()


def reward_and_runs(steps: list[ExecutedStep]) -> tuple[torch.Tensor, list[str]]:
    paid = torch.stack([torch.where(step.active, step.result.reward, 0.0) for step in steps]).sum(dim=0)
    return paid, sorted(str(run) for step in steps for run in step.runs)


def test_cells_that_wait_for_one_another_work_the_same_shift() -> None:
    found: list[Any] = []
    for together in (False, True):
        engine, executor, _ = made(kitting("task.max_episode_steps=400"), 3)
        found.append(reward_and_runs([*execute(engine, executor, Top("free", free, together=together))]))
    assert torch.allclose(found[0][0], found[1][0]) and found[0][1] == found[1][1]


def test_copies_go_on_as_the_cells_would() -> None:
    allowed = ("safety.margin_m=0.1", "safety.delay_s=0.3", "safety.lag_s=0.23", "safety.latency_s=0.2")
    engine, executor, _ = made(kitting("randomise=sim_to_real", "safety.bound=worst", *allowed), 2)
    going = execute(engine, executor, Top("free", free))
    for _ in range(25):
        next(going)
    rows = torch.tensor([1, 0, 1])
    others = engine.copies(rows)
    copied = executor.copies(others.episodes, rows)
    for _ in range(10):
        assert engine.episodes.state is not None and others.episodes.state is not None
        mine = engine.step(executor.act(engine.episodes.state).numpy())
        its = others.step(copied.act(others.episodes.state).numpy())
    for name, value in mine.state.fields().items():
        assert torch.equal(value[rows], its.state.fields()[name]) or value.isnan().any(), name


def test_values_of_the_oracle_are_what_the_options_are_worth(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 10.0)
    engine, executor, state = made(kitting("task.max_episode_steps=500"), 1)
    values = LookAhead(engine, executor).values(executor.decision(state))[0]
    best = int(values.argmax())
    able = [name for name, value in zip(executor.table.names, values.tolist(), strict=True) if value > -math.inf]
    assert able == [*(f"pick_{index}" for index in range(1, 7)), "wait"] and float(values[best]) > 0
    first = [best]

    def choose(decision: Any) -> torch.Tensor:
        return torch.tensor([first.pop()]) if first else due(decision)

    paid, _ = reward_and_runs([*execute(engine, executor, Top("the best", choose))])
    assert float(paid[0]) == pytest.approx(float(values[best]))


def test_every_top_is_told_its_regret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 4.0)
    found = rollout(kitting("regret=true", "episodes=2", "task.max_episode_steps=300", "meta_controller=random"))
    regrets = [line["regret"] for line in found.options]
    assert all(each >= 0 for each in regrets) and max(regrets) > 0
    of_first = sum(line["regret"] for line in found.options if line["episode"] == found.episodes[0].episode)
    assert found.episodes[0].measures["regret_per_min"] == pytest.approx(of_first * 10)
    with pytest.raises(ConfigError, match="regret=true judges the choices of a meta-controller"):
        compose("evaluate", ["regret=true", "policy=expert"])


def test_a_run_is_the_same_whether_or_not_its_choices_are_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 2.0)
    words = ("episodes=3", "task.max_episode_steps=300", "meta_controller=random", "policies.place=random")
    plain, judged = (rollout(kitting(*words, f"regret={judging}")) for judging in ("false", "true"))
    assert plain.table.drop(columns="regret_per_min").equals(judged.table.drop(columns="regret_per_min"))
    runs = [[{name: value for name, value in line.items() if name != "regret"} for line in found.options]
            for found in (plain, judged)]  # fmt: skip
    assert runs[0] == runs[1] and len({line["option"] for line in runs[0]}) > 2
