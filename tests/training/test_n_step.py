"""Returns over several choices."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.training.n_step import NStepReturns

GAMMA, ROWS, STEPS = 0.9, 5, 60


def transitions_of(rows: torch.Tensor) -> TensorDict:
    """Return a transition of each of some environments; some end the episode, as terminated or for want of time."""
    count = len(rows)
    terminated, truncated = torch.rand(2, count, 1) < 0.1
    after = {
        "observation": torch.randn(count, 2), "action_mask": torch.rand(count, 3) < 0.5,
        "reward": torch.randn(count, 1), "terminated": terminated, "truncated": truncated,
        "done": terminated | truncated,
    }  # fmt: skip
    found = {
        "observation": torch.randn(count, 2), "action_mask": torch.rand(count, 3) < 0.5, "row": rows,
        "action": torch.randint(3, (count,)), "steps_to_next_obs": torch.randint(1, 5, (count, 1)),
    }  # fmt: skip
    return TensorDict({**found, "next": TensorDict(after, [count])}, [count])


def joined(first: TensorDict, last: TensorDict, reward: float, length: int) -> list[Any]:
    """Return the row, and all that a joined transition holds: of the first, of the last, and of all."""
    begins = [first[name].tolist() for name in ("observation", "action_mask", "action")]
    ends = [last["next", name].tolist() for name in ("observation", "action_mask", "terminated", "truncated", "done")]
    return [int(first["row"]), begins, ends, pytest.approx(reward, abs=1e-5), length]


@pytest.mark.parametrize("steps", [1, 2, 3, 5])
def test_each_transition_is_joined_with_those_that_follow_it_in_its_episode(steps: int) -> None:
    torch.manual_seed(steps)
    returns, found, expected = NStepReturns(steps, GAMMA, ROWS), [], []
    history: list[list[TensorDict]] = [[] for _ in range(ROWS)]
    for step in range(STEPS):
        transitions = transitions_of(torch.nonzero(torch.rand(ROWS) < 0.6).squeeze(-1))
        for row, each in zip(transitions["row"].tolist(), transitions.unbind(0), strict=True):
            history[row].append(each.clone())
        found += returns(transitions).unbind(0)
        if step == STEPS // 2:  # as a training that goes on later
            state = copy.deepcopy(returns.state_dict())
            returns = NStepReturns(steps, GAMMA, ROWS)
            returns.load_state_dict(state)
    for those in history:
        for start, first in enumerate(those):
            reward, length = 0.0, 0
            for number, last in enumerate(those[start : start + steps], start=1):
                reward += GAMMA**length * last["next", "reward"].item()
                length += int(last["steps_to_next_obs"])
                if number == steps or last["next", "done"].item():
                    expected.append(joined(first, last, reward, length))
                    break
    made = [joined(each, each, each["next", "reward"].item(), int(each["steps_to_next_obs"])) for each in found]
    first_of = lambda each: each[:2]  # noqa: E731
    assert sorted(made, key=first_of) == sorted(expected, key=first_of) and len(expected) > STEPS
    assert {(*each[2][2], *each[2][3]) for each in expected} >= {(True, False), (False, True), (False, False)}


def test_ppo_takes_no_returns_over_several_choices() -> None:
    with pytest.raises(
        ConfigError, match=r"^meta_controller_agent\.n_step=3 does not go with meta_controller_agent=ppo"
    ):
        compose("train_meta_controller", ["meta_controller_agent=ppo", "meta_controller_agent.n_step=3"])
