"""Damaged files of policies and controllers get one line; the others give finite actions and choices."""

from __future__ import annotations

import copy
import io
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.tops.dqn import DQN
from hrl_comfort.composition.compose import compose
from hrl_comfort.hierarchy.decision import Decision
from hrl_comfort.hierarchy.learned import load_choice, save_controller
from hrl_comfort.hierarchy.observation import observation_dim
from hrl_comfort.hierarchy.options import Option, OptionTable, lasts
from hrl_comfort.policies.actor import load_policy
from tests.agents.test_checkpoint import write_policy
from tests.generating import CHANGES, COMFORT, ROWS, Change, changed, inputs, random_state, tried


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("policy") / "policy.pt"
    write_policy(file)
    return file


def acted(file: Path) -> torch.Tensor:
    return load_policy(file)(torch.linspace(-10, 10, 12).reshape(3, 4))


@inputs(0.08)
@given(changes=CHANGES)
def test_no_damaged_policy_file_crashes_and_what_is_loaded_acts_in_finite_numbers(
    changes: list[Change], policy: Path, fresh: Callable[[bytes], Path]
) -> None:
    file = fresh(changed(policy.read_bytes(), changes))
    action = tried(lambda: acted(file))
    assert action is None or action.isfinite().all()


THINGS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 9),
    st.just(10**12),
    st.floats(),
    st.text(max_size=3),
    st.lists(st.integers(-1, 9), max_size=3),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
    st.sampled_from([math.nan, math.inf, -1.0, 1e30, 1e38, 1e300]).map(
        lambda value: torch.full((4,), value, dtype=torch.float64)
    ),
    st.lists(st.integers(0, 9), max_size=3).map(torch.zeros),
)


def paths(tree: Any) -> list[tuple[str, ...]]:
    """Return where something can be put into nested dicts."""
    found: list[tuple[str, ...]] = []
    for key, value in tree.items():
        found += (
            [(key,), *((key, *rest) for rest in paths(value) if isinstance(value, dict))]
            if isinstance(value, dict)
            else [(key,)]
        )
    return found


def with_something_else(
    content: dict[str, Any], which: int, thing: Any, gone: bool, scale: float, fresh: Callable[[bytes], Path]
) -> Path:
    """Return a file of `content` where one thing is gone, of other size, or something else."""
    state = copy.deepcopy(content)
    *above, last = paths(state)[which % len(paths(state))]
    tree = state
    for name in above:
        tree = tree[name]
    if gone:
        del tree[last]
    elif isinstance(tree[last], torch.Tensor) and scale != 1:
        tree[last] = tree[last] * scale
    else:
        tree[last] = thing
    file = io.BytesIO()
    torch.save(state, file)
    return fresh(file.getvalue())


CHANGED = {
    "which": st.integers(0, 100), "thing": THINGS, "gone": st.booleans(),
    "scale": st.sampled_from([1, 1e20, -1e38]),
}  # fmt: skip


@inputs(0.05)
@given(**CHANGED)
def test_no_policy_file_with_other_things_in_it_crashes(
    which: int, thing: Any, gone: bool, scale: float, policy: Path, fresh: Callable[[bytes], Path]
) -> None:
    file = with_something_else(checkpoint.load(policy), which, thing, gone, scale, fresh)
    action = tried(lambda: acted(file))
    assert action is None or action.isfinite().all()


OPTIONS = ["pick_1", "place", "return", "wait", "retreat"]
TABLE = OptionTable([Option(name, lambda s: s.joint_pos, lambda s: s.steps >= 0, lasts(1)) for name in OPTIONS])


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    agent = replace(compose("train_meta_controller").meta_controller_agent, hidden=[4], buffer_size=1, batch_size=1)
    file = tmp_path_factory.mktemp("controller") / "meta_controller.pt"
    width = observation_dim(agent.observation, 1)
    spec = {"levels": COMFORT.levels, "objects": 1, "names": OPTIONS, "max_waits": None}
    torch.manual_seed(0)
    save_controller(file, DQN(agent, width, len(OPTIONS)), agent, width, spec)
    return checkpoint.load(file)


@inputs(0.05)
@given(**CHANGED)
def test_no_controllers_file_with_other_things_in_it_crashes_and_what_is_loaded_chooses_what_can_start(
    which: int,
    thing: Any,
    gone: bool,
    scale: float,
    controller: dict[str, Any],
    fresh: Callable[[bytes], Path],
) -> None:
    file = with_something_else(controller, which, thing, gone, scale, fresh)
    rng = np.random.default_rng(which)
    mask = torch.from_numpy(rng.random((ROWS, len(OPTIONS))) < 0.5)
    mask[:, OPTIONS.index("wait")] = True
    decision = Decision(random_state(rng, (-3, 1)), TABLE, mask, torch.ones(ROWS, dtype=torch.bool), 10)
    chosen = tried(lambda: load_choice(str(file), COMFORT.levels, OPTIONS)(decision))
    assert chosen is None or mask[torch.arange(ROWS), chosen].all()
