"""Options of users stand beside those of the tasks, and what is wrong with one is said."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import gymnasium
import pytest
import torch
from torch import Tensor, nn

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig, EvaluateConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import environment
from hrl_comfort.gym import OPTION_IDS
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.decision import Decision
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.look_ahead import LookAhead
from hrl_comfort.hierarchy.options import Option, lasts
from hrl_comfort.hierarchy.tops import nearest
from hrl_comfort.policies.actor import Policy
from hrl_comfort.policies.remembering import Remembering
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State

SKILLS = ("policies.pick=expert", "policies.place=expert", "policies.return=expert")


def raise_arm(state: State) -> Tensor:
    action = torch.zeros_like(state.joint_pos)
    action[:, 1] = (5 * (state.joint_home - state.joint_pos)[:, 1]).clamp(-1.0, 1.0)
    return action


def at_start(state: State) -> Tensor:
    return state.steps == 0


RAISE = Option("raise", raise_arm, at_start, lasts(25))
PLACE = replace(RAISE, name="place")
WIDE = replace(RAISE, policy=lambda state: torch.zeros(len(state.stage), 9))
ENDLESS = replace(RAISE, policy=lambda state: torch.full_like(state.joint_pos, torch.nan))
ODD = replace(RAISE, initiation=lambda state: state.joint_pos > 0)
NEVER_OVER = replace(RAISE, termination=lambda state, begun: False)  # type: ignore[arg-type, return-value]


NEGATIVE = replace(RAISE, termination=lambda state, begun: torch.full((len(state.stage),), -2.0))
WHOLE = replace(RAISE, termination=lambda state, begun: torch.ones(len(state.stage), dtype=torch.int64))
UNSURE = replace(RAISE, initiation=lambda state: torch.full((len(state.stage),), torch.nan))
ENDED = replace(RAISE, time_limit=-1)
SPELLED = replace(RAISE, max_runs="2")  # type: ignore[arg-type]
BLIND = replace(RAISE, termination=lambda state: at_start(state))  # type: ignore[arg-type, misc]
NAMELESS = replace(RAISE, name=3)  # type: ignore[arg-type]


def made(scene: Scene, config: EnvConfig, seed: int) -> Option:
    return replace(RAISE, name=f"raise_{len(scene.joints)}")


class Counting(nn.Module):
    """Lifts the arm, and counts its decisions."""

    memory_dim = 1

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        return torch.zeros(len(memory), 6), memory + 1


def remembers(scene: Scene, config: EnvConfig, seed: int) -> Option:
    policy = Policy(Counting(), {"task": "sort", "observation_dim": 6})
    return replace(
        RAISE, name="remembers", policy=Remembering(policy, lambda s: s.joint_pos, config.task.action_repeat)
    )


def raised_first(decision: Decision) -> Tensor:
    index = len(decision.table) - 1
    return torch.where(decision.mask[:, index], index, nearest(decision))


def evaluation(option: str, *words: str, top: str = "raised_first") -> EvaluateConfig:
    config = compose("evaluate", [
        *SKILLS, f"meta_controller={__name__}:{top}", f"meta_controller.further_options=[{__name__}:{option}]",
        "task=sort", "task.objects=1", "human=none", "episodes=1", "output=unused", *words,
    ])  # fmt: skip
    assert isinstance(config, EvaluateConfig)
    return config


def executor_of(config: EvaluateConfig) -> OptionExecutor:
    return make_executor(config, None, Engine(environment(config), 1, 0), 0)[0]


@pytest.mark.parametrize("words", [[], ["task=cycle", "task.objects=1"]], ids=["sort", "chain"])
def test_a_top_starts_an_option_of_a_user_and_the_task_goes_on(words: list[str]) -> None:
    result = rollout(evaluation("RAISE", *words))
    ran = [(line["option"], line["cause"]) for line in result.options]
    assert ran[0] == ("raise", "done") and ran[1][0].startswith("pick") and bool(result.table["success"].all())
    assert next(line["end_step"] - line["start_step"] for line in result.options) == 25


def test_a_function_makes_an_option_for_the_scene() -> None:
    assert executor_of(evaluation("made")).table.names[-3:] == ["wait", "retreat", "raise_6"]


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("SKILLS", "is of type tuple; it must be a hrl_comfort.hierarchy.options.Option, or a function"),
        ("PLACE", "is named 'place', as another option; those are pick_1, place, return, wait, retreat"),
        ("missing", "has no missing"),
        ("raise_arm", r"failed: TypeError: raise_arm\(\) takes 1 positional argument but 3 were given"),
        ("NAMELESS", "is named 3; a name is a string that is not empty"),
        ("ENDED", "ENDED': time_limit=-1 must be a whole number above 0, or None"),
        ("SPELLED", "SPELLED': max_runs='2' must be a whole number above 0, or None"),
        ("BLIND", r"BLIND': termination must be a function of state, begun; its own are \(state\): too many"),
    ],
)
def test_what_is_no_option_is_refused(option: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        executor_of(evaluation(option))


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("WIDE", r"policy returned shape \(1, 9\); it must return a tensor of shape \(1, 6\)"),
        ("ENDLESS", "policy returned actions that are not finite"),
        ("ODD", r"initiation returned shape \(1, 6\); it must return a tensor of shape \(1,\)"),
        ("NEGATIVE", r"termination returned torch.float32, \[-2.0\]; it must return torch.bool, or floats in \[0, 1\]"),
        ("WHOLE", r"termination returned torch.int64, \[1\]; it must return torch.bool, or floats in \[0, 1\]"),
        ("UNSURE", "initiation returned torch.float32; it must return torch.bool"),
        ("NEVER_OVER", r"termination returned type bool; it must return a tensor of shape \(1,\)"),
    ],
)
def test_an_option_that_returns_something_else_is_told(option: str, said: str) -> None:
    with pytest.raises(ConfigError, match=f"^meta_controller.further_options: option 'raise': {said}$"):
        rollout(evaluation(option))


def test_an_option_whose_policy_remembers_is_saved_with_its_memory_and_not_tried_in_copies() -> None:
    own, config = [f"{__name__}:remembers"], evaluation("remembers")
    engine = Engine(environment(config), 1, 0)
    with pytest.raises(ConfigError, match=r"^the policy of remembers remembers, and cannot be tried in copies"):
        LookAhead(engine, make_executor(config, None, engine, 0)[0])
    quick = {"human": "none", "task.objects": 1, "task.max_episode_steps": 100}
    env: Any = gymnasium.make(OPTION_IDS["sort"], **quick, **{"meta_controller.further_options": own}).unwrapped
    env.reset(seed=0)
    env.step(env.names.index("remembers"))
    twin = copy.deepcopy(env)
    (mine,), (its,) = (each.decision().table.memories() for each in (env, twin))
    assert mine["after"].tolist() == its["after"].tolist() == [[5.0]]
    env.step(0)
    assert twin.decision().table.memories()[0]["step"].tolist() == its["step"].tolist()


def test_a_controller_that_reads_no_options_takes_none() -> None:
    own = f"meta_controller.further_options=[{__name__}:RAISE]"
    with pytest.raises(ConfigError, match=r"meta_controller\.further_options="):
        compose("evaluate", [*SKILLS, "meta_controller=idle", "task=sort", own])
