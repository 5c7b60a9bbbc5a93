"""Cells with a hand and several objects are exact: resumed, shared out over processes, and copied to look ahead."""

from __future__ import annotations

import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EnvConfig, EvaluateConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy import look_ahead as looking
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Decision, Top
from hrl_comfort.hierarchy.executor import execute
from hrl_comfort.hierarchy.look_ahead import LookAhead
from hrl_comfort.hierarchy.tops import due
from hrl_comfort.policies.load import make_policy
from hrl_comfort.sim.engine import Engine
from tests.sim.test_processes import assert_same

SHIELDED = ("safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact", "split=validation")
WORLDS = {
    "sort": ("task=sort", "cell=grasp", "task.objects=2", "human=patrol"),
    "shift": ("task=shift", "cell=grasp", "task.objects=2", "human=patrol", "comfort=conditioned"),
    "kitting": ("task=kitting", "cell=bench_hand", "human=pair"),
}
SKILLS = tuple(f"policies.{name}=expert" for name in ("pick", "place", "return"))


def asked(world: str, *words: str) -> EvaluateConfig:
    found = compose("evaluate", [*WORLDS[world], *SHIELDED, "output=unused", *words])
    assert isinstance(found, EvaluateConfig)
    return found


class Cells:
    """Two cells of a world, worked by an expert of their own."""

    def __init__(self, config: EnvConfig, seed: int) -> None:
        self.engine = Engine(config, 2, seed)
        self.act = make_policy("expert", self.engine.episodes.subtask, self.engine.scene, config, 0)

    def step(self) -> dict[str, object]:
        """Run a decision; return what is known of it and of the cells after it."""
        state = self.engine.episodes.state
        assert state is not None
        result = self.engine.step(self.act(state).numpy())
        return {**vars(result), "physics": self.engine.physics_state, "observation": self.engine.observe()}

    def lose_first(self) -> None:
        """Put the first object of the first cell beside the table."""
        state, model = self.engine.episodes.state, self.engine.scene.model
        assert state is not None
        at = 1 + model.joint(self.engine.scene.loose[int(state.kinds[0, 0])]).qposadr[0]
        self.engine.physics.state[0, at : at + 3] = 0.98, 0.9, -0.4


@pytest.mark.parametrize("world", WORLDS)
def test_episodes_go_on_exactly_from_a_saved_state(world: str) -> None:
    config = environment(asked(world, "policy=expert", "meta_controller=none"))
    cells, others = Cells(config, 0), Cells(config, 1)
    cells.engine.reset()
    for _ in range(10):
        cells.step()
    others.engine.load_state_dict(cells.engine.state_dict())
    begun = False
    for decision in range(14):
        if decision == 2:
            cells.lose_first()
            others.lose_first()
        mine, its = cells.step(), others.step()
        for name, value in mine.items():
            assert_same(value, its[name])
        begun |= bool(mine["state"].object_lost.any() or mine["failed"].any())  # type: ignore[attr-defined]
    assert begun, "an object was lost, and in tasks that repeat another arrived"


@pytest.mark.parametrize("world", WORLDS)
def test_an_evaluation_is_that_of_one_process(world: str) -> None:
    words = (*SKILLS, "meta_controller=nearest", "task.max_episode_steps=120")
    one, two = (rollout(asked(world, *words, "episodes=2", "record=true", f"engine.processes={n}")) for n in (1, 2))
    assert one.table.equals(two.table)
    assert one.options == two.options and one.paths == two.paths


@pytest.mark.parametrize("world", WORLDS)
def test_an_oracle_foresees_what_an_option_is_worth_and_loses_nothing(
    world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 2.0)
    words = (*SKILLS, "meta_controller=oracle", "task.max_episode_steps=100")
    config = asked(world, *words, "episodes=1")
    engine = Engine(environment(config), 1, 0)
    executor, _ = make_executor(config, None, engine, 0)
    values = LookAhead(engine, executor).values(executor.decision(engine.reset()))[0]
    first = [int(values.argmax())]
    best = float(values.max())

    def choose(decision: Decision) -> torch.Tensor:
        return torch.tensor([first.pop()]) if first else due(decision)

    steps = [*execute(engine, executor, Top("the best", choose))]
    assert sum(float(step.result.reward[0]) for step in steps) == pytest.approx(best)
    judged = rollout(asked(world, *words, "episodes=1", "regret=true"))
    assert judged.options and all(line["regret"] == 0 for line in judged.options)
    plain = rollout(config)
    assert plain.table.drop(columns="regret_per_min").equals(judged.table.drop(columns="regret_per_min"))
