"""Returns over several options."""

from __future__ import annotations

import copy

import pytest
import torch
from tensordict import TensorDict

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.training.n_step import NStepReturns

GAMMA, ROWS, STEPS = 0.9, 5, 60


def ended(rows: torch.Tensor) -> TensorDict:
    """Return transitions of some environments, of which some end the episode."""
    count = len(rows)
    after = {"observation": torch.randn(count, 2), "reward": torch.randn(count, 1), "done": torch.rand(count, 1) < 0.15}
    found = {"observation": torch.randn(count, 2), "row": rows, "steps_to_next_obs": torch.randint(1, 5, (count, 1))}
    return TensorDict({**found, "next": TensorDict(after, [count])}, [count])


def told(row: int, first: TensorDict, last: TensorDict, reward: float, length: int) -> tuple[float, ...]:
    """Return what tells a joined transition from others."""
    seen = (each["observation"][0].item() for each in (first, last["next"]))
    return row, *seen, pytest.approx(reward, abs=1e-5), length, last["next", "done"].item()


@pytest.mark.parametrize("steps", [1, 2, 3, 5])
def test_each_transition_is_joined_with_those_that_follow_it_in_its_episode(steps: int) -> None:
    torch.manual_seed(steps)
    returns, found, expected = NStepReturns(steps, GAMMA, ROWS), [], []
    history: list[list[TensorDict]] = [[] for _ in range(ROWS)]
    for step in range(STEPS):
        transitions = ended(torch.nonzero(torch.rand(ROWS) < 0.6).squeeze(-1))
        for row, each in zip(transitions["row"].tolist(), transitions.unbind(0), strict=True):
            history[row].append(each.clone())
        found += returns(transitions).unbind(0)
        if step == STEPS // 2:  # as a training that goes on later
            state = copy.deepcopy(returns.state_dict())
            returns = NStepReturns(steps, GAMMA, ROWS)
            returns.load_state_dict(state)
    for row, those in enumerate(history):
        for start, first in enumerate(those):
            reward, length = 0.0, 0
            for number, last in enumerate(those[start : start + steps], start=1):
                reward += GAMMA**length * last["next", "reward"].item()
                length += int(last["steps_to_next_obs"])
                if number == steps or last["next", "done"].item():
                    expected.append(told(row, first, last, reward, length))
                    break
    made = [
        told(int(each["row"]), each, each, each["next", "reward"].item(), int(each["steps_to_next_obs"]))
        for each in found
    ]
    first = lambda each: each[:2]  # noqa: E731
    assert sorted(made, key=first) == sorted(expected, key=first) and len(expected) > STEPS


def test_ppo_takes_no_returns_over_several_options() -> None:
    with pytest.raises(
        ConfigError, match=r"^meta_controller_agent\.n_step=3 does not go with meta_controller_agent=ppo"
    ):
        compose("train_meta_controller", ["meta_controller_agent=ppo", "meta_controller_agent.n_step=3"])
