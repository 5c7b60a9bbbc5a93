"""The shift: objects keep arriving until time is up, and failures cost time alone."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.agents.tops.dqn import DQN
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EnvConfig, EvaluateConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import execute
from hrl_comfort.hierarchy.learned import save_controller
from hrl_comfort.hierarchy.observation import observation_dim
from hrl_comfort.hierarchy.options import OptionTable
from hrl_comfort.hierarchy.tops import TOPS
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.objects import go_on, rendered_positions
from hrl_comfort.tasks import subtask
from hrl_comfort.tasks.shift import SHIFT

OPTIONS = ("pick", "place", "return")
EXPERTS = [f"policies.{name}=expert" for name in OPTIONS]


def config(*overrides: str) -> EnvConfig:
    return environment(compose("train", ["task=shift", *overrides]))


def shift(*overrides: str) -> EvaluateConfig:
    chained = [] if "meta_controller=none" in overrides else EXPERTS
    asked = ["task=shift", "meta_controller=nearest", *chained, "split=validation", "episodes=2", *overrides]
    found = compose("evaluate", asked)
    assert isinstance(found, EvaluateConfig)
    return found


def rows(tmp_path: Path, *overrides: str) -> list[dict[str, str]]:
    folder = evaluate(shift(f"output='{tmp_path}'", *overrides))
    with (folder / "episodes.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_shift_lasts_its_time_and_objects_of_both_kinds_keep_arriving() -> None:
    asked = shift("human=none", "task.objects=2", "task.max_episode_steps=900")
    engine = Engine(environment(asked), 3, 0)
    executor, top = make_executor(asked, None, engine, 0)
    engine.reset()
    steps = list(execute(engine, executor, top))
    state = steps[-1].result.state
    assert (state.steps == 900).all() and steps[-1].result.truncated.all() and not steps[-1].result.terminated.any()
    placed = SHIFT.released(state.stage)
    assert (placed > 2).all(), "more than lay there at the beginning"
    picked = [
        run for step in steps for run in step.runs if run.option.startswith("pick") and run.termination == "success"
    ]
    assert len(picked) >= int(placed.sum())
    assert torch.stack([step.result.state.target_kind for step in steps]).unique().tolist() == [0, 1]


def arrivals(engine: Engine) -> torch.Tensor:
    """Return where objects arrive (N, B, kinds, 3)."""
    return torch.from_numpy(engine.episodes.draw.arrivals)


def test_an_object_arrives_where_the_placed_one_lay_once_the_arm_is_home() -> None:
    engine = Engine(config("human=none", "task.objects=2"), 2, 0)
    before = engine.reset().with_(
        stage=torch.tensor([2, 2]), target=torch.tensor([1, 1]), placed=torch.tensor([[False, True], [False, True]])
    )
    nothing, pink = torch.zeros(2, dtype=torch.bool), torch.ones(2, dtype=torch.int64)
    after = go_on(before.with_(stage=torch.tensor([3, 2])), before, nothing, pink, arrivals(engine), SHIFT)
    assert after.placed.tolist() == [[False, False], [False, True]]
    assert after.kinds[0, 1] == 1 and after.target[0] == 1
    assert torch.equal(after.target_place[0], after.kind_places[0, 1])
    assert torch.equal(after.target_object[0], before.objects[0, 1])
    assert (rendered_positions(after, SHIFT)[0] == after.objects[0].numpy()).all()


def test_a_failure_loses_the_object_in_the_gripper_and_nothing_else() -> None:
    engine = Engine(config("human=none"), 3, 0)
    before = engine.reset().with_(stage=torch.tensor([3, 4, 5]))  # picking, carrying, returning
    failed, pink = torch.ones(3, dtype=torch.bool), torch.ones(3, dtype=torch.int64)
    after = go_on(before, before, failed, pink, arrivals(engine), SHIFT)
    assert after.stage.tolist() == [3, 3, 5]
    assert after.kinds[1, 0] == 1 and torch.equal(after.target_place[1], after.kind_places[1, 1])
    assert torch.equal(after.kinds[[0, 2]], before.kinds[[0, 2]])


def test_a_failure_begins_once() -> None:
    state = Engine(config("human=none"), 2, 0).reset()
    hit = state.with_(table_collision=torch.tensor([True, False]))
    assert SHIFT.failed(state, hit).tolist() == [True, False]
    assert SHIFT.failed(hit, hit).tolist() == [False, False]


def test_an_arm_that_hits_something_is_brought_home_and_goes_on() -> None:
    asked = shift("human=none", "task.max_episode_steps=1500")
    engine = Engine(environment(asked), 2, 0)
    executor, top = make_executor(asked, None, engine, 0)
    falling = torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    falls = replace(executor.table.options[0], policy=lambda state: falling.expand(len(state.steps), 6))
    choices = [each if each.object is None else replace(each, option=falls) for each in executor.table]
    executor.table = OptionTable(choices)
    engine.reset()
    steps = list(execute(engine, executor, top))
    runs = [run for step in steps for run in step.runs if run.row == 0]
    failures = [index for index, run in enumerate(runs) if run.termination == "failure"]
    assert len(failures) >= 2, "it fails, goes home and fails again"
    assert all(run.option == "retreat" for run in (runs[index + 1] for index in failures[:-1]))
    assert int(steps[-1].result.state.steps[0]) == 1500


def test_terms_see_the_stages_of_a_round() -> None:
    state = Engine(config("human=none"), 3, 0).reset().with_(stage=torch.tensor([0, 1, 2]))
    later = state.with_(stage=state.stage + 6)
    for layout in ("default", "paper"):
        task = subtask("shift", layout)
        assert torch.equal(task.observe(state), task.observe(later))
    moved = state.with_(stage=state.stage + 1)
    for term in SHIFT.rewards.values():
        assert torch.equal(term(state, moved), term(later, moved.with_(stage=moved.stage + 6)))
    assert SHIFT.rewards["place"](later, later.with_(stage=later.stage + 1)).tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("controller", [*TOPS, "none"])
def test_every_meta_controller_works_a_shift_behind_the_shield(tmp_path: Path, controller: str) -> None:
    policies = []
    if controller == "learned":
        asked = shift()
        names = make_executor(asked, None, Engine(environment(asked), 1, 0), 0)[0].table.names
        agent = compose(
            "train_meta_controller", ["task=shift", "meta_controller_agent.hidden=[8]"]
        ).meta_controller_agent
        width = observation_dim(agent.observation, 4)
        spec = {"names": names, "levels": 10, "objects": 4, "max_waits": None}
        save_controller(tmp_path / "meta_controller.pt", DQN(agent, width, len(names)), agent, width, spec)
        policies = [f"policies.meta_controller='{tmp_path}'", "meta_controller.level_override=[]"]
    elif controller == "none":
        policies = ["policy=expert"]
    found = rows(
        tmp_path / "eval", f"meta_controller={controller}", *policies, "human=mixture", "safety=ssm",
        "robot.rating=collaborative", "comfort=conditioned", "task.max_episode_steps=600",
    )  # fmt: skip
    assert [(row["success"], row["steps"], row["unsafe_contact"]) for row in found] == [("True", "600", "False")] * 2
    assert all(float(row["objects_per_min"]) == int(row["objects_placed"]) / 0.2 for row in found)
    assert all(float(row["discomfort_per_min"]) >= 0 for row in found)


def test_contacts_of_a_shift_are_counted_and_it_goes_on(tmp_path: Path) -> None:
    walker = ("human=approach", "human.speed_m_s=1.0", "human.bound_m=5.0", "task.terminate_on=unsafe_contact")
    still = [f"policies.{name}=random" for name in OPTIONS]
    found = rows(tmp_path, *walker, *still, "task.max_episode_steps=1500", "episodes=4")
    assert all(row["steps"] == "1500" and row["success"] == "True" for row in found)
    contacts = [float(row["contacts_per_h"]) for row in found]
    assert max(contacts) > 3600 / 30, "more than one in half a minute"
    for row, many in zip(found, contacts, strict=True):
        assert (many > 0) == (row["contact"] == "True")
        assert float(row["unsafe_contacts_per_h"]) <= many
        assert (float(row["unsafe_contacts_per_h"]) > 0) == (row["unsafe_contact"] == "True")


def test_the_same_shift_comes_out_of_a_batch_of_any_size(tmp_path: Path) -> None:
    asked = ("human=patrol", "task.max_episode_steps=400")
    alone, three = rows(tmp_path / "a", *asked, "episodes=1"), rows(tmp_path / "b", *asked, "episodes=3")
    assert alone[0] == three[0]


def test_the_object_is_where_it_is_in_the_round_of_the_stage() -> None:
    count = len(SHIFT.stages)
    assert [SHIFT.location(stage) for stage in range(count, 2 * count)] == [stage.object for stage in SHIFT.stages]
