"""A policy with memory acts for any rows of any episodes, and remembers each by itself."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from torch import Tensor, nn

from hrl_comfort.config import ConfigError
from hrl_comfort.hierarchy.look_ahead import LookAhead
from hrl_comfort.hierarchy.options import Choice, Option, OptionTable
from hrl_comfort.policies.actor import Policy
from hrl_comfort.policies.remembering import MOST, Remembering
from hrl_comfort.tasks import State

REPEAT = 5


class Counting(nn.Module):
    """Its action is how often it has acted in the episode; it adds what it observes to its memory."""

    memory_dim = 2

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        after = memory + torch.cat([torch.ones(len(memory), 1), observation], dim=1)
        return after, after


def counting() -> Remembering:
    policy = Policy(Counting(), {"task": "pick", "observation_dim": 1})
    return Remembering(policy, lambda state: state.joint_pos, REPEAT)


def state(keys: list[int], steps: list[int]) -> State:
    return State.of(key=torch.tensor(keys), steps=torch.tensor(steps), joint_pos=torch.ones(len(keys), 1))


def test_each_episode_is_remembered_whichever_rows_act() -> None:
    act = counting()
    assert act(state([7, 8, 9], [0, 0, 0]))[:, 0].tolist() == [1, 1, 1]
    assert act(state([9, 7], [5, 5]))[:, 0].tolist() == [2, 2]
    assert act(state([7, 8, 9, 4], [10, 5, 10, 0])).tolist() == [[3, 3], [2, 2], [3, 3], [1, 1]]


def test_an_episode_begins_anew_after_a_pause_and_a_decision_can_be_asked_for_twice() -> None:
    act = counting()
    for step, wanted in ((0, 1), (5, 2), (5, 2), (8, 3), (20, 1), (25, 2), (0, 1)):
        assert act(state([3], [step]))[0, 0] == wanted, step


def test_what_is_remembered_goes_on_where_it_was_saved_and_the_oracle_refuses_it() -> None:
    act, again = counting(), counting()
    again.load_state_dict(act.state_dict())
    act(state([7, 8], [0, 0]))
    again.load_state_dict(act.state_dict())
    assert again(state([8, 7, 9], [5, 5, 0]))[:, 0].tolist() == [2, 2, 1]
    option = Option("pick", act, lambda state: state.key > 0, lambda state, _: state.key > 0)
    executor = SimpleNamespace(table=OptionTable([Choice(option)]), option=torch.zeros(1))
    with pytest.raises(ConfigError, match=r"^the policy of pick remembers, .*; give meta_controller another top"):
        LookAhead(SimpleNamespace(), executor)  # type: ignore[arg-type]


def test_the_first_decision_is_that_of_the_policy_alone_and_old_episodes_are_forgotten() -> None:
    act = counting()
    assert act._policy(torch.ones(2, 1)).tolist() == [[1, 1], [1, 1]]
    act(state([1], [0]))
    act(state(list(range(10, 10 + MOST)), [0] * MOST))
    act(state([10 + MOST], [0]))
    assert len(act._known) <= MOST + 1 and 1 not in act._known
