"""Controllers that choose the next option without learning, and what they are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.policies import with_policy
from hrl_comfort.config import ConfigError, EvaluateConfig, HierarchyTrainConfig, StudioConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Decision
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.sort import sorting_table
from hrl_comfort.hierarchy.tops import cautious, nearest
from hrl_comfort.sim.engine import Engine
from hrl_comfort.training.hierarchy_trainer import evaluations, option_config
from tests.hierarchy.test_sort import EXPERTS, META, STILL, config

KITTING = ("task=kitting", "cell=bench", "human=fetcher")


@pytest.fixture(scope="module")
def asked() -> Decision:
    engine = Engine(config(), 8, 0)
    state = engine.reset()
    options = sorting_table(META, STILL, engine.scene, engine.episodes.config, 0)
    return OptionExecutor(options, engine.episodes).decision(state)


def test_nearest_takes_the_nearest_object(asked: Decision) -> None:
    away = (asked.state.objects - asked.state.tcp_pos[:, None]).norm(dim=-1)
    assert torch.equal(nearest(asked), away.argmin(dim=1))


def test_cautious_waits_for_a_person_at_the_goal_but_not_for_ever(asked: Decision) -> None:
    here = asked.state.with_(humans_pos=asked.state.objects[:, :1, :2])
    wait, patient = asked.table.position("wait"), asked.mask.clone()
    assert (cautious(replace(asked, state=here)) == wait).all()
    patient[:, wait] = False
    assert (cautious(replace(asked, state=here, mask=patient)) != wait).all()


def test_cautious_waits_for_whoever_is_at_the_goal(asked: Decision) -> None:
    goal = asked.state.objects[:, 0, :2]
    for people in ([goal, goal + 9.0], [goal + 9.0, goal]):
        here = asked.state.with_(humans_pos=torch.stack(people, dim=1))
        assert (cautious(replace(asked, state=here)) == asked.table.position("wait")).all()


def test_cautious_waits_six_times_in_a_row_beside_a_person_who_stays() -> None:
    engine = Engine(config(), 2, 0)
    state, everyone = engine.reset(), torch.ones(2, dtype=torch.bool)
    chosen = compose("evaluate", ["task=sort", "meta_controller=cautious"])
    assert isinstance(chosen, EvaluateConfig)
    options = sorting_table(chosen.meta_controller, STILL, engine.scene, engine.episodes.config, 0)
    executor, waits = OptionExecutor(options, engine.episodes), []
    for count in range(8):
        beside = state.with_(humans_pos=state.objects[:, :1, :2], steps=torch.full((2,), 25 * count))
        engine.episodes.state = beside
        option = cautious(executor.decision(beside))
        executor.begin(everyone, option)
        waits.append((option == options.position("wait")).tolist())
    assert waits == [[True, True]] * 6 + [[False, False], [True, True]]


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("name", ["nearest", "cautious"])
def test_a_controller_that_learns_nothing_gives_every_skill_the_first_level_it_may(name: str, near: bool) -> None:
    engine = Engine(config("comfort=sort"), 8, 0)
    engine.reset()
    found = []
    for levels in ([], [6, 2]):
        words = [
            "task=sort", "comfort=sort", f"meta_controller={name}", f"meta_controller.level_override={levels}",
            *(f"policies.{skill}=random" for skill in STILL),
        ]  # fmt: skip
        executor, choose = make_executor(compose("evaluate", words), None, engine, 0)
        asked = executor.decision(engine.episodes.state)
        if near:
            asked = replace(asked, state=asked.state.with_(humans_pos=asked.state.objects[:, :1, :2]))
        found.append([executor.table.names[each] for each in choose(asked).tolist()])
    plain, told = found
    assert told == [each if each in ("wait", "retreat") else f"{each}_as_6" for each in plain]
    assert ("wait" in plain) == (name == "cautious")
    assert not near or name == "nearest" or set(plain) == {"wait"}


def test_a_controller_that_does_not_sort_is_refused() -> None:
    with pytest.raises(ConfigError, match="train meta_controller takes task=sort"):
        compose("train_meta_controller", ["task=cycle"])
    with pytest.raises(ConfigError, match=r"^meta_controller=cautious is for task=sort, .*an option to wait"):
        rollout(
            compose(
                "evaluate",
                [
                    "task=cycle",
                    "meta_controller=cautious",
                    "episodes=1",
                    *(f"policies.{n}=expert" for n in EXPERTS),
                ],
            )
        )


@pytest.mark.parametrize("word", ["meta_controller.max_waits=3", "meta_controller.level_override=[1]"])
def test_a_chain_refuses_what_is_for_sorting(word: str) -> None:
    skills = [f"policies.{name}=random" for name in STILL]
    with pytest.raises(ConfigError, match=r"^meta_controller\.\w+=\[?\d\]? is for task=sort, .*; choose "):
        rollout(compose("evaluate", ["task=cycle", "meta_controller=nearest", "episodes=1", word, *skills]))


@pytest.mark.parametrize(
    ("word", "off"),
    [
        ("level_override=[3]", r"\[\]"),
        ("max_waits=3", "null"),
        ("interruption_steps=3", "null"),
        ("order=[wait]", r"\[\]"),
    ],
)
@pytest.mark.parametrize("name", ["none", "idle"])
def test_where_no_skill_is_chosen_what_is_for_choices_is_refused(name: str, word: str, off: str) -> None:
    said = rf"^meta_controller\.{word.split('=')[0]}=\S+ is for .*, not for .*{name}.*; choose {off}$"
    with pytest.raises(ConfigError, match=said):
        compose("evaluate", [*KITTING, f"meta_controller={name}", f"meta_controller.{word}"])


def test_an_order_is_for_fixed_alone() -> None:
    words = [*KITTING, "meta_controller=nearest", "meta_controller.order=[wait]"]
    for name in ("due", "random", "own:Top"):
        with pytest.raises(
            ConfigError, match=rf"^meta_controller\.order=.* is for meta_controller=fixed, not for {name};"
        ):
            compose("evaluate", [*words, f"meta_controller.name={name}"])


def test_a_policy_alone_keeps_nothing_of_a_controller(tmp_path: Path) -> None:
    words = ["meta_controller=cautious", "meta_controller.interruption_steps=5", "meta_controller.level_override=[3]"]
    studio = compose("studio", [*KITTING, *words])
    assert isinstance(studio, StudioConfig)
    assert with_policy(studio, "expert").policy == "expert"
    for name in ("cautious", "learned"):
        trained = compose("train_hierarchy", [f"meta_controller={name}", f"output={tmp_path}"])
        assert isinstance(trained, HierarchyTrainConfig)
        options = [option_config(trained, option, tmp_path, "ik") for option in trained.meta_controller.options]
        alone, *_ = evaluations(trained, tmp_path, options)
        assert alone.policy == str(tmp_path) and alone.meta_controller == alone.meta_controller.alone()


def test_a_task_says_how_long_its_options_may_take_unless_the_controller_does() -> None:
    def limit(*overrides: str) -> int:
        config = compose("evaluate", ["meta_controller=nearest", *overrides])
        assert isinstance(config, EvaluateConfig)
        return config.meta_controller.time_limit_steps

    assert limit("task=sort") == 400 and limit("task=cycle") == 500
    assert limit("task=sort", "meta_controller.time_limit_steps=7") == 7
