"""Options and the scripted meta-controller."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, MetaControllerConfig
from hrl_comfort.config.compose import compose, environment
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.hierarchy.controllers import Scripted, chain, single
from hrl_comfort.hierarchy.options import Option, act
from hrl_comfort.hierarchy.play import play
from hrl_comfort.policies.load import make_policy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, subtask

COMFORT = environment(compose("train", ["task=cycle"])).comfort


def meta(**changes: Any) -> MetaControllerConfig:
    config = MetaControllerConfig(
        name="scripted",
        options=["pick", "place", "return"],
        time_limit_steps=10,
        retries=1,
        level_override=[],
    )
    return replace(config, **changes)


def constant(value: float):
    return lambda state: torch.full((len(state.steps), 6), value, dtype=torch.float64)


def three() -> list[Option]:
    return chain([Option(n, subtask(n), constant(v)) for n, v in (("pick", 0.1), ("place", 0.2), ("return", 0.3))])


@pytest.fixture(scope="module")
def state() -> State:
    return Engine(environment(compose("train", ["task=cycle", "human=none"])), 3, 0).reset()


def outcome(state: State, done: Tensor, success: Tensor, truncated: Tensor) -> StepResult:
    n = len(state.steps)
    return StepResult(
        state=state,
        reward_terms=torch.zeros(n, 1),
        step_rewards=torch.zeros(n, 1),
        success=success,
        terminated=done & ~truncated,
        truncated=truncated,
        valid=torch.ones(n, 1, dtype=torch.bool),
        instants=state,
    )


def at(state: State, steps: list[int], stage: list[int]) -> State:
    return state.with_(steps=torch.tensor(steps), stage=torch.tensor(stage))


NO = torch.zeros(3, dtype=torch.bool)


def test_options_take_over_where_the_one_before_ends() -> None:
    spans = [(option.name, option.first, option.last) for option in three()]
    assert spans == [("pick", 0, 1), ("place", 1, 2), ("return", 2, 3)]
    two = chain([Option("pick_place", subtask("pick_place"), constant(0)), three()[2]])
    assert [(o.first, o.last) for o in two] == [(0, 2), (2, 3)]


def test_options_that_do_not_cover_the_task_are_refused() -> None:
    with pytest.raises(ConfigError, match="needs"):
        Scripted(meta(), subtask("cycle"), three()[:2], COMFORT)


def test_an_option_sees_its_stages_counted_from_its_own(state: State) -> None:
    seen = []
    place = Option("place", subtask("place"), lambda s: seen.append(s.stage.tolist()) or s.joint_pos, first=1)
    act([place], torch.zeros(3, dtype=torch.int64), at(state, [5, 5, 5], [1, 1, 1]), ~NO)
    assert seen == [[0, 0, 0]]


def test_rows_run_different_options_and_report_how_each_ended(state: State) -> None:
    controller = Scripted(meta(), subtask("cycle"), three(), COMFORT)
    controller.begin(3)
    assert torch.equal(controller.act(state), torch.full((3, 6), 0.1, dtype=torch.float64))
    # Row 0 has picked, row 1 is under way, row 2 has collided.
    first = outcome(at(state, [5, 5, 4], [1, 0, 0]), torch.tensor([False, False, True]), NO, NO)
    assert not controller.observe(first).any()
    action = controller.act(first.state)
    assert action[:, 0].tolist() == [0.2, 0.1, 0.0]
    assert [(r.row, r.option, r.termination) for r in controller.runs] == [
        (0, "pick", "success"),
        (2, "pick", "failure"),
    ]
    assert [(r.start_step, r.end_step) for r in controller.runs] == [(0, 5), (0, 4)]


def test_an_option_out_of_time_is_tried_again_and_then_given_up(state: State) -> None:
    controller = Scripted(meta(), subtask("cycle"), three(), COMFORT)
    controller.begin(3)
    assert not controller.observe(outcome(at(state, [10, 10, 10], [0, 0, 0]), NO, NO, NO)).any()
    assert controller.observe(outcome(at(state, [20, 20, 20], [0, 0, 0]), NO, NO, NO)).all()
    row = [(r.attempt, r.termination) for r in controller.runs if r.row == 0]
    assert row == [(1, "preempted"), (2, "preempted")]


def test_an_options_time_grows_with_the_episodes_where_speed_counts(state: State) -> None:
    paid = replace(COMFORT, source="random", beta=1.0)
    controller = Scripted(meta(retries=0), subtask("cycle"), three(), paid)
    controller.begin(3)
    levels = torch.tensor([1.0, 5.0, 10.0], dtype=torch.float64)
    given_up = {}
    for steps in (10, 19, 20, 99, 100):
        now = at(state, [steps] * 3, [0] * 3).with_(level=levels)
        for row in torch.nonzero(controller.observe(outcome(now, NO, NO, NO))).flatten().tolist():
            given_up[row] = steps
    assert given_up == {0: 100, 1: 20, 2: 10}


def test_a_finished_cycle_ends_with_success(state: State) -> None:
    controller = Scripted(meta(time_limit_steps=500), subtask("cycle"), three(), COMFORT)
    controller.begin(3)
    yes = ~NO
    for stage in (1, 2):
        controller.observe(outcome(at(state, [5 * stage] * 3, [stage] * 3), NO, NO, NO))
    controller.observe(outcome(at(state, [15] * 3, [3] * 3), yes, yes, NO))
    terminal_states = [(r.option, r.termination) for r in controller.runs if r.row == 1]
    assert terminal_states == [("pick", "success"), ("place", "success"), ("return", "success")]
    assert (controller.act(state) == 0).all()


def test_a_lone_policy_is_one_option_for_the_whole_task(state: State) -> None:
    task = subtask("cycle")
    controller = single(task, Option("cycle", task, constant(0.5)), 1500, COMFORT)
    controller.begin(3)
    assert torch.equal(controller.act(state), torch.full((3, 6), 0.5, dtype=torch.float64))


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
    config = compose("evaluate", ["task=cycle", "meta_controller=scripted", f"division={division}", "episodes=2"])
    policies = dict.fromkeys(config.meta_controller.options, "expert")
    result = rollout(replace(config, policies=policies))
    assert [episode.success for episode in result.episodes] == [True, True]
    assert [run["option"] for run in result.options if run["episode"] == 0] == list(config.meta_controller.options)


def test_episodes_that_have_ended_cost_no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    config, task = environment(compose("train", ["task=cycle"])), subtask("cycle")
    engine = Engine(config, 6, 0)
    expert = make_policy("expert", task, engine.scene, config, 0)
    controller = single(task, Option(task.name, task, expert), config.task.max_episode_steps, config.comfort)
    engine.reset()
    run, stepped = engine._run, []

    def counted(physics: Any, control: Any) -> Any:
        stepped.append(len(physics))
        return run(physics, control)

    monkeypatch.setattr(engine, "_run", counted)
    active = [int(moment.active.sum()) for moment in play(engine, controller)]
    assert stepped == active and 0 < active[-1] < active[0] == 6
