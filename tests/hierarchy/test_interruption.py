"""A controller that interrupts skills: one that is chosen again goes on, one that is left ends as interrupted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from hrl_comfort import options_of
from hrl_comfort.agents import checkpoint
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, MetaControllerTrainConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Decision, Top
from hrl_comfort.hierarchy.executor import TERMINATIONS, execute
from hrl_comfort.hierarchy.learned import load_choice
from hrl_comfort.hierarchy.look_ahead import Judged
from hrl_comfort.hierarchy.option_cells import OptionVector
from hrl_comfort.hierarchy.option_env import make_option_env
from hrl_comfort.hierarchy.options import Choice, Option, OptionTable, Termination, lasts, skill
from hrl_comfort.hierarchy.tops import in_order
from hrl_comfort.sim.engine import Engine
from hrl_comfort.studio.session import Session
from hrl_comfort.tasks import State, subtask
from hrl_comfort.tasks.return_home import RETURN_STAGE
from hrl_comfort.training.controller_trainer import train_meta_controller
from tests.hierarchy.test_executor import NO, at, constant, outcome, played

SKILLS = ("pick", "place", "return")
KEY = "meta_controller.interruption_steps"
QUICK: dict[str, Any] = {"task.max_episode_steps": 120, "human": "none", "task.objects": 2}


@pytest.fixture(scope="module")
def state() -> State:
    return Engine(environment(compose("train", ["task=cycle", "human=none"])), 3, 0).reset()


def two(after: int | None, limit: int) -> OptionTable:
    """Return a skill at two levels, which is interrupted `after` control steps."""
    pick = skill(subtask("pick"), constant(0.1), limit, interruption_steps=after)
    return OptionTable([Choice(pick), Choice(pick, level=3)])


def runs_of(state: State, table: OptionTable, ends: list[int], top: Top) -> list[tuple[Any, ...]]:
    """Return the runs in the first cell of three whose decisions end at the control steps `ends`."""
    _, steps = played([outcome(at(state, [k] * 3, [0] * 3), NO, NO, NO) for k in ends], table, retries=9, top=top)
    return [
        (run.option, run.attempt, run.start_step, run.end_step, run.termination, run.cause)
        for step in steps for run in step.runs if run.row == 0
    ]  # fmt: skip


def in_turn(*choices: int) -> tuple[Top, list[list[int]]]:
    """Return a top that makes these choices and then the last of them, and the control steps at which it does."""
    asked: list[list[int]] = []

    def choose(decision: Decision) -> Tensor:
        asked.append(decision.state.steps.tolist())
        return torch.full((3,), choices[min(len(asked), len(choices)) - 1])

    return Top("in_turn", choose), asked


def test_an_option_that_is_chosen_again_goes_on_as_one_and_its_limit_is_over_all_of_its_time(state: State) -> None:
    top, asked = in_turn(0)
    found = runs_of(state, two(after=10, limit=25), [5, 10, 15, 20, 25, 30, 35], top)
    assert found == [("pick", 1, 0, 25, "preempted", "time limit")]
    assert [steps[0] for steps in asked] == [0, 10, 20, 25], "interrupted at 10 and 20, preempted at 25"


def test_an_option_that_is_left_for_another_ends_as_interrupted_and_begins_anew_when_it_is_back(state: State) -> None:
    top, _ = in_turn(0, 0, 1, 0)
    found = runs_of(state, two(after=5, limit=20), [5, 10, 15, 20, 25, 30, 35, 40], top)
    assert found == [
        ("pick", 1, 0, 10, "interrupted", "interrupted"),
        ("pick_as_3", 1, 10, 15, "interrupted", "interrupted"),
        ("pick", 1, 15, 35, "preempted", "time limit"),
    ]


def test_an_option_that_ends_when_it_would_be_interrupted_has_ended(state: State) -> None:
    picked = outcome(at(state, [5] * 3, [1, 0, 0]), NO, NO, NO)
    executor = played([picked], two(after=5, limit=20))[1][0]
    assert [(run.row, run.termination) for run in executor.runs] == [(0, "success")]


def test_an_option_that_may_run_once_goes_on_in_that_run_and_cannot_begin_anew(state: State) -> None:
    once = replace(two(after=10, limit=25)[0].option, max_runs=1)
    table = OptionTable([once, Option("wait", constant(0.0), lambda state: ~NO, lasts(5))])
    top = Top("first", lambda decision: torch.where(decision.mask[:, 0], 0, 1))
    found = runs_of(state, table, [5, 10, 15, 20, 25, 30], top)
    assert found == [("pick", 1, 0, 25, "preempted", "time limit"), ("wait", 1, 25, 30, "success", "done")]


def test_options_without_the_key_are_never_interrupted(state: State) -> None:
    top, asked = in_turn(0, 1)
    assert runs_of(state, two(after=None, limit=100), [5, 50, 95], top) == [] and len(asked) == 1


def kitting(after: int | None, steps: int, top: str) -> EvaluateConfig:
    choices = {KEY: after, "task.max_episode_steps": steps, "meta_controller": top, "split": "validation"}
    return options_of("kitting", {**choices, "human": "none", "episodes": 2})


def test_episodes_of_a_top_that_always_goes_on_are_the_same_to_the_bit() -> None:
    plain, asked = (rollout(kitting(after, 400, "fixed")) for after in (None, 5))
    assert plain.table.equals(asked.table) and plain.options == asked.options
    assert len({run["option"] for run in plain.options}) > 2
    assert decisions(5) > 2 * decisions(None) > 0


def decisions(after: int | None) -> int:
    """Return the number of choices of the top of `kitting` in 200 control steps."""
    config, count = kitting(after, 200, "nearest"), 0
    engine = Engine(environment(config), 1, 0)
    executor, _ = make_executor(config, None, engine, 0)
    engine.reset()

    def choose(decision: Decision) -> Tensor:
        nonlocal count
        count += 1
        return in_order(decision)

    for _ in execute(engine, executor, Top("first", choose)):
        pass
    engine.close()
    return count


def test_an_interrupted_pick_can_give_way_and_what_is_carried_can_be_placed_or_held_still() -> None:
    config = kitting(5, 700, "nearest")
    engine = Engine(environment(config), 1, 0)
    executor, _ = make_executor(config, None, engine, 0)
    engine.reset()
    interrupted: dict[str, set[tuple[str, ...]]] = {}

    def choose(decision: Decision) -> Tensor:
        if bool(executor._interrupted):
            able = tuple(name for name, can in zip(decision.table.names, decision.mask[0], strict=True) if can)
            kind = executor.table.names[int(executor.option)].partition("_")[0]
            interrupted.setdefault(kind, set()).add(tuple(dict.fromkeys(name.partition("_")[0] for name in able)))
        return in_order(decision)

    for _ in execute(engine, executor, Top("first", choose)):
        pass
    engine.close()
    assert interrupted == {
        "pick": {("pick", "wait"), ("pick", "wait", "retreat")},
        "place": {("place", "wait")},
        "return": {("return", "retreat")},
    }


def test_an_arm_that_was_cut_short_goes_home_before_anything_else_however_often_that_is_interrupted() -> None:
    config = kitting(10, 300, "nearest")
    config = replace(config, meta_controller=replace(config.meta_controller, time_limit_steps=30))
    engine = Engine(environment(config), 1, 0)
    executor, _ = make_executor(config, None, engine, 0)
    engine.reset()
    asked: list[tuple[bool, set[str]]] = []

    def choose(decision: Decision) -> Tensor:
        able = {name for name, can in zip(decision.table.names, decision.mask[0], strict=True) if can}
        asked.append((bool(RETURN_STAGE.done(decision.state)), able))
        return in_order(decision)

    runs = [run for step in execute(engine, executor, Top("first", choose)) for run in step.runs]
    engine.close()
    kinds = [(run.option, run.termination) for run in runs[:2]]
    assert kinds == [("pick_1", "preempted"), ("retreat", "success")]
    home = [mask == {"retreat"} for _, mask in asked].index(True)
    back = next(number for number, (done, _) in enumerate(asked) if number > home and done)
    assert back - home > 1, "it is interrupted on its way"
    assert all(mask == {"retreat"} for _, mask in asked[home:back]) and "pick_2" in asked[back][1]


def test_an_interrupted_option_is_a_transition_of_its_own_discounted_by_its_own_time() -> None:
    gamma, choices = 0.99, {**QUICK, "reward": "sort", "comfort": "sort"}
    whole, parts = (
        make_option_env(options_of("sort", {**choices, KEY: after}), 1, seed=3, gamma=gamma) for after in (None, 5)
    )
    expected = whole.step(whole.reset().set("action", torch.tensor([0])))["next"]
    now, ran, earned, ends = parts.reset(), [], 0.0, []
    while sum(ran) < int(expected["steps_to_next_obs"]):
        after = parts.step(now.set("action", torch.tensor([0])))["next"]
        earned += gamma ** sum(ran) * float(after["reward"])
        ran.append(int(parts.transitions(after)["steps_to_next_obs"]))
        ends.append(TERMINATIONS[int(after["termination"])])
        now = after.clone()
    assert len(ran) > 2 and set(ran[:-1]) == {5} and sum(ran) == int(expected["steps_to_next_obs"])
    assert set(ends[:-1]) == {Termination.INTERRUPTED} and ends[-1] is TERMINATIONS[int(expected["termination"])]
    assert earned == pytest.approx(float(expected["reward"]), rel=1e-5)


def test_a_row_that_is_interrupted_is_saved_as_such_and_files_of_before_load() -> None:
    env, twin = (make_option_env(options_of("sort", {**QUICK, KEY: 10}), 1, seed=3) for _ in range(2))
    td = env.step(env.reset().set("action", torch.tensor([0])))["next"]
    twin.reset()
    twin.load_state_dict(env.state_dict())
    for each in (env, twin):
        each.step(td.clone().set("action", torch.tensor([0])))
        assert (int(each.executor.started), int(each.executor.decided)) == (0, 10)
    old = {name: each for name, each in env.executor.state_dict().items() if name not in ("decided", "_interrupted")}
    twin.executor.load_state_dict(old)
    assert torch.equal(twin.executor.decided, old["started"]) and not twin.executor._interrupted.any()


def test_an_episode_that_begins_after_an_interruption_begins_its_option() -> None:
    cells = OptionVector(options_of("sort", {**QUICK, KEY: 10}), 1)
    cells.reset(seed=3)
    *_, info = cells.step(np.array([0]))
    assert info["duration"].tolist() == [10]
    cells.reset(seed=4)
    cells.step(np.array([0]))
    executor = cells._cells.executor
    assert int(executor.started) == int(executor.decided) == 0 and int(executor.attempt) == 1


def test_the_regret_of_an_option_is_the_sum_over_the_choices_of_it() -> None:
    lost = [[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]]
    goes_on = iter([torch.tensor([False, False]), torch.tensor([True, False]), torch.tensor([False, False])])
    executor: Any = SimpleNamespace(option=torch.zeros(2), goes_on=lambda chosen: next(goes_on))
    values = iter([torch.stack([torch.tensor(each), torch.zeros(2)], dim=1).double() for each in lost])
    oracle: Any = SimpleNamespace(executor=executor, values=lambda decision: next(values))
    judged = Judged(Top("last", lambda decision: torch.ones(2, dtype=torch.int64)), oracle)
    decision: Any = SimpleNamespace(mask=torch.ones(2, 2, dtype=torch.bool), deciding=torch.ones(2, dtype=torch.bool))

    def regrets(cause: str) -> list[float]:
        return [judged.regret(SimpleNamespace(row=row, cause=cause)) for row in range(2)]  # type: ignore[arg-type]

    judged(decision)
    judged(decision)
    assert regrets("done") == [3.0, 2.0] and regrets("interrupted")[1] == 1.0
    judged(decision)
    assert regrets("interrupted") == [3.0, 2.0]


def test_the_studio_asks_the_controller_too_and_tells_of_the_run_that_it_left() -> None:
    words = ["task=sort", "task.objects=2", "meta_controller=nearest", "human=still", f"{KEY}=10"]
    session = Session(compose("studio", [*words, *(f"policies.{name}=random" for name in SKILLS)]))  # type: ignore[arg-type]
    first = session.option
    other = session.executor.table.position({"pick_1": "pick_2", "pick_2": "pick_1"}[first])
    session._top = Top("other", lambda decision: torch.tensor([other]))
    assert session.step().runs == []
    [run] = session.step().runs
    assert (run.option, run.cause, run.start_step, run.end_step) == (first, "interrupted", 0, 10)
    assert session.options.index(session.option) == other
    assert session.step().runs == session.step().runs == [], "it goes on"
    session.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([f"{KEY}=0"], r"interruption_steps=0 is outside"),
        ([f"{KEY}=-3"], r"interruption_steps=-3 is outside"),
        ([f"{KEY}=2.5"], r"interruption_steps"),
        (
            [f"{KEY}=5", "task=cycle"],
            r"^meta_controller\.\w+=5 is for .* in task=cycle; choose null$",
        ),
        ([f"{KEY}=5", "meta_controller=idle"], r"not for meta_controller=idle in task=kitting; choose null$"),
        ([f"{KEY}=5", "meta_controller=none"], r"not for meta_controller=none in task=kitting; choose null$"),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_in_one_line(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as error:
        compose("evaluate", ["task=kitting", "cell=bench", "human=fetcher", "meta_controller=due", *words])
    assert "\n" not in str(error.value)


def test_a_page_of_its_own_refuses_it() -> None:
    with pytest.raises(ConfigError, match=rf"^{KEY}=5 is for a controller"):
        compose("studio", ["task=cycle", "meta_controller=nearest", f"{KEY}=5", "export=page.html"])


def test_a_learned_controller_keeps_the_value_of_its_training(tmp_path: Path) -> None:
    folder, policies = tmp_path / "top", [f"policies.{name}=expert" for name in SKILLS]
    words = [
        "task.objects=2", "human=none", "engine.num_envs=2", "task.max_episode_steps=100", f"{KEY}=20",
        *(f"meta_controller_agent.{key}" for key in ("options=8", "warmup_options=4", "batch_size=4", "log_every=8")),
        "meta_controller.max_waits=3", "meta_controller.level_override=[2]", f"output={folder}",
    ]  # fmt: skip
    trained = compose("train_meta_controller", [*words, *policies])
    assert isinstance(trained, MetaControllerTrainConfig)
    train_meta_controller(trained)
    asked = [
        "task=sort",
        "task.objects=2",
        "meta_controller=learned",
        "comfort=sort",
        f"policies.meta_controller={folder}",
        *policies,
    ]
    for root in ("evaluate", "studio"):
        top = compose(root, asked).meta_controller  # type: ignore[attr-defined]
        assert (top.interruption_steps, top.max_waits, list(top.level_override)) == (20, 3, [2])
    rollout(compose("evaluate", [*asked, "episodes=1"]))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"trained with meta_controller\.interruption_steps=20; here it is null$"):
        rollout(compose("evaluate", [*asked, "episodes=1", f"{KEY}=null"]))  # type: ignore[arg-type]
    file = checkpoint.load(folder / "meta_controller.pt")
    names = file["spec"]["names"]
    before = {key: value for key, value in file["spec"].items() if key != "interruption_steps"}
    checkpoint.save(tmp_path / "before.pt", {**file, "spec": before})
    load_choice(str(tmp_path / "before.pt"), 10, names, 3, None)
    with pytest.raises(ConfigError, match=r"trained with meta_controller\.interruption_steps=null; here it is 20$"):
        load_choice(str(tmp_path / "before.pt"), 10, names, 3, 20)
    config = (folder / "config.yaml").read_text(encoding="utf-8")
    (folder / "config.yaml").write_text(config.replace("  interruption_steps: 20\n", ""), encoding="utf-8")
    assert compose("evaluate", asked).meta_controller.interruption_steps is None  # type: ignore[attr-defined]
