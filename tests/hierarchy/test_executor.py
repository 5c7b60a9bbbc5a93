"""Options, their chain and the one executor."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ComfortConfig, ConfigError
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import check_stages
from hrl_comfort.hierarchy.decision import Top
from hrl_comfort.hierarchy.executor import ExecutedStep, OptionExecutor, execute
from hrl_comfort.hierarchy.options import Choice, Option, OptionTable, chain, skill
from hrl_comfort.hierarchy.tops import in_order
from hrl_comfort.policies.load import make_policy
from hrl_comfort.sim.engine import Array, Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, subtask

IN_ORDER = Top("in_order", in_order)
COMFORT = environment(compose("train", ["task=cycle"])).comfort


def constant(value: float):
    return lambda state: torch.full((len(state.steps), 6), value, dtype=torch.float64)


def three(limit: int = 10) -> OptionTable:
    return chain([(subtask(n), constant(v)) for n, v in (("pick", 0.1), ("place", 0.2), ("return", 0.3))], limit)


@pytest.fixture(scope="module")
def state() -> State:
    return Engine(environment(compose("train", ["task=cycle", "human=none"])), 3, 0).reset()


def outcome(state: State, done: Tensor, success: Tensor, truncated: Tensor) -> StepResult:
    """Return the result of a decision; a failure is a contact with the table."""
    n = len(state.steps)
    harms = {name: np.zeros((n, 1), dtype=bool) for name in ("contact", "self_collision")}
    harms["table_collision"] = (done & ~truncated & ~success).numpy()[:, None]
    return StepResult(
        state=state,
        reward_terms=torch.zeros(n, 1),
        step_rewards=torch.zeros(n, 1),
        failed=done & ~truncated & ~success,
        success=success,
        terminated=done & ~truncated,
        truncated=truncated,
        decision_steps=torch.ones(n, dtype=torch.int64),
        before=state,
        moving=harms,
    )


def at(state: State, steps: list[int], stage: list[int]) -> State:
    return state.with_(steps=torch.tensor(steps), stage=torch.tensor(stage))


NO = torch.zeros(3, dtype=torch.bool)


def test_options_take_over_where_the_one_before_ends() -> None:
    def spans(table: OptionTable) -> list[tuple[str, int, int]]:
        return [(each.name, each.stages.first, each.stages.last) for each in table.options if each.stages]

    assert spans(three()) == [("pick", 0, 1), ("place", 1, 2), ("return", 2, 3)]
    two = chain([(subtask("pick_place"), constant(0)), (subtask("return"), constant(0))], 10)
    assert spans(two) == [("pick_place", 0, 2), ("return", 2, 3)]


def test_options_that_do_not_cover_the_task_are_refused() -> None:
    with pytest.raises(ConfigError, match="needs"):
        check_stages([subtask("pick"), subtask("place")], subtask("cycle"))


def test_an_option_sees_its_stages_counted_from_its_own(state: State) -> None:
    seen = []
    place = skill(subtask("place"), lambda s: seen.append(s.stage.tolist()) or s.joint_pos, None, first=1)
    OptionTable([place]).act(torch.zeros(3, dtype=torch.int64), at(state, [5, 5, 5], [1, 1, 1]), ~NO)
    assert seen == [[0, 0, 0]]


def played(
    results: list[StepResult],
    table: OptionTable,
    retries: int = 1,
    comfort: ComfortConfig = COMFORT,
    top: Top = IN_ORDER,
) -> tuple[list[Array], list[ExecutedStep]]:
    """Execute the options where decisions lead to `results`; return the actions and what was executed."""
    episodes = SimpleNamespace(rows=3, state=at(results[0].state, [0] * 3, [0] * 3), observed=lambda state: state)
    episodes.config, episodes.subtask = SimpleNamespace(comfort=comfort), subtask("cycle")
    actions, ahead = [], iter(results)

    def step(action: Array, rows: Array) -> StepResult:
        actions.append(action)
        result = next(ahead)
        episodes.state = result.state
        return result

    executor = OptionExecutor(table, episodes, retries)  # type: ignore[arg-type]
    engine = SimpleNamespace(episodes=episodes, num_envs=3, step=step)
    return actions, list(islice(execute(engine, executor, top), len(results)))  # type: ignore[arg-type]


def test_rows_run_different_options_and_report_how_each_ended(state: State) -> None:
    # Row 0 has picked, row 1 is under way, row 2 has collided.
    first = outcome(at(state, [5, 5, 4], [1, 0, 0]), torch.tensor([False, False, True]), NO, NO)
    actions, steps = played([first, outcome(first.state, NO, NO, NO)], three())
    assert (actions[0] == 0.1).all() and actions[1][:, 0].tolist() == [0.2, 0.1, 0.0]
    runs = steps[0].runs
    ends = [(r.row, r.option, r.termination, r.cause) for r in runs]
    assert ends == [(0, "pick", "success", "done"), (2, "pick", "failure", "hit table")]
    assert [(r.start_step, r.end_step) for r in runs] == [(0, 5), (0, 4)]
    assert [step.ended.tolist() for step in steps] == [[False, False, True], [False] * 3]


def test_an_option_out_of_time_is_tried_again_and_then_given_up(state: State) -> None:
    _, steps = played([outcome(at(state, [k] * 3, [0] * 3), NO, NO, NO) for k in (10, 20)], three())
    assert [step.ended.all() for step in steps] == [False, True]
    row = [(r.attempt, r.termination, r.cause) for step in steps for r in step.runs if r.row == 0]
    assert row == [(1, "preempted", "time limit"), (2, "preempted", "time limit")]


def executor_of(table: OptionTable, state: State) -> OptionExecutor:
    config = SimpleNamespace(comfort=COMFORT)
    episodes = SimpleNamespace(rows=3, state=state, observed=lambda state: state, config=config)
    episodes.subtask = subtask("cycle")
    return OptionExecutor(table, episodes, 1)  # type: ignore[arg-type]


def test_who_stands_still_runs_out_of_no_time(state: State) -> None:
    executor = executor_of(three(), at(state, [0] * 3, [0] * 3))
    executor.begin(~NO, torch.zeros(3, dtype=torch.int64))
    with executor.held(torch.tensor([1])):
        executor.ended(outcome(at(state, [10] * 3, [0] * 3), NO, NO, NO))
    assert executor.timeouts.tolist() == [1, 0, 1]


def test_an_option_that_the_end_of_an_episode_cut_short_leaves_the_next_free(state: State) -> None:
    home = Option("home", constant(0.4), lambda state: NO, lambda state, _: NO, recovers=True)
    table = OptionTable([*three(), Choice(home)])
    executor = executor_of(table, at(state, [0] * 3, [0] * 3))
    executor.begin(~NO, torch.zeros(3, dtype=torch.int64))
    executor.ended(outcome(at(state, [5] * 3, [0] * 3), ~NO, NO, ~NO))
    assert executor.available(at(state, [5] * 3, [0] * 3))[0].tolist() == [True, False, False, False], (
        "its value counts"
    )
    begun = at(state, [0] * 3, [0] * 3)
    assert executor.available(begun)[0].tolist() == [True, False, False, False]
    executor.begin(~NO, torch.zeros(3, dtype=torch.int64))
    assert executor.available(at(state, [1] * 3, [0] * 3))[0].tolist() == [True, False, False, False]


def test_a_lost_object_goes_back_to_the_pick_and_does_not_count_as_an_attempt(state: State) -> None:
    path = [([5, 5, 5], [1, 1, 1]), ([9, 9, 9], [0, 0, 0]), ([18, 18, 18], [1, 1, 1])]
    _, steps = played([outcome(at(state, *where), NO, NO, NO) for where in path], three(), retries=0)
    row = [(r.option, r.attempt, r.termination, r.cause) for step in steps for r in step.runs if r.row == 0]
    assert [each[:3] for each in row] == [("pick", 1, "success"), ("place", 1, "preempted"), ("pick", 1, "success")]
    assert [each[3] for each in row] == ["done", "object lost", "done"]
    assert not any(step.ended.any() for step in steps)


def test_an_options_time_grows_with_the_episodes_where_speed_counts(state: State) -> None:
    paid = replace(COMFORT, source="random", beta=1.0)
    levels = torch.tensor([1.0, 5.0, 10.0], dtype=torch.float64)
    decisions = (10, 19, 20, 99, 100)
    results = [outcome(at(state, [k] * 3, [0] * 3).with_(level=levels), NO, NO, NO) for k in decisions]
    _, steps = played(results, three(), retries=0, comfort=paid)
    given_up = {
        row: k for k, step in zip(decisions, steps, strict=True) for row in step.ended.nonzero().flatten().tolist()
    }
    assert given_up == {0: 100, 1: 20, 2: 10}


def test_a_finished_cycle_ends_with_success(state: State) -> None:
    yes = ~NO
    results = [outcome(at(state, [5 * stage] * 3, [stage] * 3), NO, NO, NO) for stage in (1, 2)]
    _, steps = played([*results, outcome(at(state, [15] * 3, [3] * 3), yes, yes, NO)], three(500))
    ends = [(r.option, r.termination) for step in steps for r in step.runs if r.row == 1]
    assert ends == [("pick", "success"), ("place", "success"), ("return", "success")]
    assert steps[-1].ended.all()


def test_an_option_that_the_end_of_the_episode_cuts_short_says_so(state: State) -> None:
    _, steps = played([outcome(at(state, [7] * 3, [0] * 3), ~NO, NO, ~NO)], three())
    assert {(r.termination, r.cause) for r in steps[0].runs} == {("preempted", "episode over")}


@pytest.mark.parametrize(
    ("name", "cause"), [("unsafe_contact", "unsafe contact"), ("self_collision", "self-collision")]
)
def test_in_a_task_that_goes_on_a_failure_is_what_has_just_begun(state: State, name: str, cause: str) -> None:
    """The arm leans on the table since before; in the last control step something else is touched."""
    leaning = state.with_(table_collision=~NO)
    harms = {each: np.zeros((3, 2), dtype=bool) for each in ("unsafe_contact", "self_collision")}
    moving = {**harms, "table_collision": np.ones((3, 2), dtype=bool), name: np.array([[False, True]] * 3)}
    result = replace(outcome(at(state, [7] * 3, [0] * 3), NO, NO, NO), failed=~NO, before=leaning, moving=moving)
    result = replace(result, decision_steps=torch.full((3,), 2))
    task = replace(subtask("cycle"), terminate_on="unsafe_contact", repeats=True)
    episodes = SimpleNamespace(rows=3, config=SimpleNamespace(comfort=COMFORT), subtask=task)
    executor = OptionExecutor(three(), episodes)  # type: ignore[arg-type]
    ended = executor.ended(result)
    assert {executor.run_of(row, ended, 7).cause for row in range(3)} == {cause}


def test_random_policy_is_seeded_and_bounded(state: State) -> None:
    config = environment(compose("train", ["task=pick"]))
    scene = Engine(config, 1, 0).scene
    draws = [make_policy("random", subtask("pick"), scene, config, 3)(state) for _ in range(2)]
    assert torch.equal(*draws) and draws[0].abs().max() <= 1 and draws[0].std() > 0.1


def test_a_missing_policy_is_named_in_one_line() -> None:
    config = environment(compose("train", ["task=pick"]))
    scene = Engine(config, 1, 0).scene
    with pytest.raises(ConfigError, match="'nowhere' is not there; give a run folder") as error:
        make_policy("nowhere", subtask("pick"), scene, config, 0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("division", ["three", "two", "one"])
def test_every_division_of_the_task_chains_to_the_whole_cycle(division: str) -> None:
    config = compose("evaluate", ["task=cycle", "meta_controller=nearest", f"division={division}", "episodes=2"])
    policies = dict.fromkeys(config.meta_controller.options, "expert")
    result = rollout(replace(config, policies=policies))
    assert [episode.success for episode in result.episodes] == [True, True]
    assert [run["option"] for run in result.options if run["episode"] == 0] == list(config.meta_controller.options)


def test_episodes_that_have_ended_cost_no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    config, task = environment(compose("train", ["task=cycle"])), subtask("cycle")
    engine = Engine(config, 6, 0)
    expert = make_policy("expert", task, engine.scene, config, 0)
    executor = OptionExecutor(OptionTable([skill(task, expert, config.task.max_episode_steps)]), engine.episodes)
    engine.reset()
    run, stepped = engine.physics.run, []

    def counted(control: Any, rows: Any) -> Any:
        stepped.append(len(control))
        return run(control, rows)

    monkeypatch.setattr(engine.physics, "run", counted)
    active = [int(step.active.sum()) for step in execute(engine, executor, IN_ORDER)]
    assert stepped == active and 0 < active[-1] < active[0] == 6
