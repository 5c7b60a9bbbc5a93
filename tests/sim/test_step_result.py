"""The compiled judgement of a decision is that of the functions of stages and terms, in every bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import Rules
from hrl_comfort.tasks import SUBTASKS, State, Subtask, kernels, subtask

TASKS = [*(subtask(name) for name in SUBTASKS), subtask("sort", objects=3)]


def decision(rows: int, task: Subtask, seed: int) -> tuple[State, dict[str, Any], np.ndarray]:  # type: ignore[type-arg]
    """Return a state, the fields that change and time limits, all random, in which much is done, touched and late."""
    words = ["task=sort", "task.objects=3", "human=none"]
    state, rng = Engine(environment(compose("train", words)), rows, seed).reset(), np.random.default_rng(seed)
    rounds = len(task.stages) * (3 if task.repeats else 1) + 1
    truths = {name: rng.random((rows, 6)) < 0.1 for name in ("touching", "contact", "unsafe_contact")}
    truths |= {name: rng.random((rows, 6)) < 0.1 for name in ("table_collision", "self_collision")}
    begun = {name: torch.from_numpy(value[:, 0].copy()) for name, value in truths.items()}
    state = state.with_(
        **begun,
        stage=torch.from_numpy(rng.integers(rounds, size=rows)),
        target=torch.from_numpy(rng.integers(3, size=rows)),
        steps=torch.from_numpy(rng.integers(300, size=rows)),
        grasp_tolerance=torch.full((rows,), 0.3, dtype=torch.float64),
        place_tolerance=torch.full((rows,), 0.3, dtype=torch.float64),
        home_tolerance=torch.full((rows,), 0.3, dtype=torch.float64),
    )
    goals = torch.stack([state.target_object, state.target_place, state.points[:, 0]])
    near = goals[torch.from_numpy(rng.integers(3, size=rows)), torch.arange(rows)].numpy()
    moving = {
        **{name: np.ascontiguousarray(value[:, 1:]) for name, value in truths.items()},
        "tcp_pos": near[:, None] + rng.normal(size=(rows, 5, 3)) * 0.2,
        "joint_pos": state.joint_home.numpy()[:, None] + rng.normal(size=(rows, 5, 6)) * 0.2,
        "joint_vel": rng.normal(size=(rows, 5, 6)) * 0.4,
        "steps": state.steps.numpy()[:, None] + np.arange(1, 6),
    }
    return state, moving, rng.integers(100, 500, size=rows)


@pytest.mark.parametrize("rows", [1, 3, 64])
@pytest.mark.parametrize("task", TASKS, ids=lambda task: f"{task.name}{len(task.stages)}")
def test_compiled_rules_are_those_of_stages_and_terms(task: Subtask, rows: int) -> None:
    seen = np.zeros(3, dtype=bool)
    for seed in range(4 if rows < 64 else 1):
        rng = np.random.default_rng(seed)
        state, moving, limits = decision(rows, task, seed)
        weights = torch.from_numpy(rng.normal(size=len(task.rewards)) * (rng.random(len(task.rewards)) < 0.8))
        for at in (replace(task, arrival_speed=1.0), replace(task, terminate_on="unsafe_contact")):
            rules = Rules(at, weights)
            found, asked = (judge(state, moving, limits) for judge in (rules.judged, rules.asked))
            for mine, theirs in zip(found, asked, strict=True):  # rewards are sums, which a machine rounds in its way
                np.testing.assert_allclose(np.asarray(mine), np.asarray(theirs), rtol=0, atol=1e-12, strict=True)
            seen |= [(found[0] > state.stage.numpy()[:, None]).any(), found[1].any(), (found[2] < 4).any()]
    assert rows < 64 or seen.all()


def test_all_stages_and_terms_of_the_package_are_compiled_and_a_users_are_asked() -> None:
    task = subtask("cycle")
    for each in TASKS:
        assert kernels.compiled_stages(each) is not None
        named = zip(each.rewards, kernels.compiled_terms(each)[0], strict=True)
        assert {name for name, kind in named if kind == kernels.OTHER} <= {"return_shaping", "missed"}
    mine = replace(task.stages[0], done=lambda state: state.tcp_pos[..., 2] > 0.5)
    assert kernels.compiled_stages(replace(task, stages=(mine, *task.stages[1:]))) is None
    assert kernels.compiled_stages(subtask("cycle", hand=True)) is None
    paid = {**task.rewards, "step": lambda before, after: after.tcp_pos[..., 2]}
    assert kernels.compiled_terms(replace(task, rewards=paid))[0][[*paid].index("step")] == kernels.OTHER
