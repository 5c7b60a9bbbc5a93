"""Claims that would be false if a baseline were not the algorithm that it is named after."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from hrl_comfort.agents.baselines.end_to_end import EndToEnd
from hrl_comfort.agents.baselines.held import Held
from hrl_comfort.agents.baselines.hiro import HIRO
from hrl_comfort.agents.baselines.option_critic import NONE, OptionCritic
from hrl_comfort.agents.baselines.turns import seldom
from hrl_comfort.agents.learners import make_learner
from hrl_comfort.agents.networks import Actor
from hrl_comfort.config import ConfigError
from tests.agents.test_sac import agent

D, A, N = 5, 2, 3


def made(name: str, **own: Any) -> Any:
    torch.manual_seed(0)
    return make_learner("agent", agent(name=name, own=own, normalise=False, learning_rate=1e-2), D, A)


def step(
    learner: Any, before: Tensor, after: Tensor, done: Tensor | None = None, reward: float = 0.0,
    shown: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """Let a learner act at `before` (N, D), and observe that `after` followed; return its actions.

    In the rows `shown` (N,) bool they are taken for those of a demonstrator.
    """
    action = learner.act(TensorDict({"observation": before}), 0.0)
    none = torch.zeros(len(before), 1, dtype=torch.bool)
    then = {
        "observation": after,
        "reward": torch.full((len(before), 1), reward),
        "terminated": none if done is None else done[:, None],
        "done": none if done is None else done[:, None],
    }
    seen = {
        "observation": before,
        "action": action,
        "steps_to_next_obs": torch.full((len(before), 1), 2),
        "demonstrated": none[:, 0] if shown is None else shown,
        "next": TensorDict(then, batch_size=[len(before)]),
    }
    learner.observe(TensorDict(seen, batch_size=[len(before)]))
    return action


def towards_goals(actor: Actor, size: int) -> None:
    """Make the mode of an actor half of the last numbers that it sees, the goal."""
    with torch.no_grad():
        for weight in actor.parameters():
            weight.zero_()
        for column in range(A):
            for layer in range(3):
                inputs = size - A + column if layer == 0 else column
                actor.body[2 * layer].weight[column, inputs] = 0.5 if layer == 2 else 1.0
            for layer in (0, 1):  # beside ReLUs, the negative part
                inputs = size - A + column if layer == 0 else A + column
                actor.body[2 * layer].weight[A + column, inputs] = -1.0 if layer == 0 else 1.0
            actor.body[4].weight[column, A + column] = -0.5


def test_hiro_holds_a_goal_moves_it_with_the_observation_and_rewards_closeness() -> None:
    learner = made("hiro", goals=[1, 3], reach=0.5, every=3)
    assert isinstance(learner, HIRO)
    path = [torch.randn(N, D) for _ in range(5)]
    goals = []
    for before, after in pairwise(path):
        step(learner, before, after)
        goals.append(learner._goal.clone())
    lower = learner.lower.buffer.storage[: 4 * N].unflatten(0, (4, N))
    set_first = lower["observation"][0, :, D:]
    moved = set_first - (path[1] - path[0])[:, [1, 3]] / 0.5
    torch.testing.assert_close(lower["next", "observation"][0, :, D:], moved)
    torch.testing.assert_close(lower["observation"][1, :, D:], moved)
    torch.testing.assert_close(lower["next", "reward"][0], -moved.norm(dim=1, keepdim=True))
    left = set_first - (path[3] - path[0])[:, [1, 3]] / 0.5
    torch.testing.assert_close(lower["next", "observation"][2, :, D:], left)
    assert not torch.equal(lower["observation"][3, :, D:], left)  # three decisions are over: another goal


def test_hiros_upper_policy_sees_what_a_goal_earned_discounted_and_ends_with_the_episode() -> None:
    learner = made("hiro", goals=[0], reach=1.0, every=3)
    path, gamma = [torch.randn(N, D) for _ in range(4)], learner.config.gamma
    for index in range(3):
        step(learner, path[index], path[index + 1], torch.tensor([index == 1, False, False]), reward=1.0)
    upper = learner.upper.buffer.storage[: len(learner.upper.buffer)]
    assert upper["count"][:, 0].tolist() == [2, 3, 3] and upper["steps_to_next_obs"][:, 0].tolist() == [4, 6, 6]
    earned = [1 + gamma**2, *[1 + gamma**2 + gamma**4] * 2]
    torch.testing.assert_close(upper["next", "reward"][:, 0], torch.tensor(earned))
    assert upper["next", "terminated"][:, 0].tolist() == [True, False, False]
    lower = learner.lower.buffer.storage[: 3 * N]
    assert not lower["next", "terminated"].any()  # its rewards are negative: it would learn to end the episode
    torch.testing.assert_close(upper["change"][1], (path[3] - path[0])[1, :1])
    assert learner._count.tolist() == [1, 0, 0]  # the first environment began again at the third decision


def test_the_relabelled_goal_is_the_likeliest_candidate() -> None:
    learner = made("hiro", goals=[0, 1], reach=1.0, every=4, candidates=10)
    towards_goals(learner.lower.actor, D + A)
    seen, meant = torch.zeros(6, 4, D), torch.rand(6, 2) * 1.2 - 0.6
    batch = TensorDict(
        {
            "seen": seen,
            "acted": torch.tanh(0.5 * meant)[:, None].expand(-1, 4, -1).clone(),
            "count": torch.tensor([[4], [4], [4], [2], [2], [2]]),
            "change": meant.clone(),
            "action": -meant,
        },
        batch_size=[6],
    )
    batch["acted"][3:, 2:] = 5.0  # left from before, and not of this goal
    torch.testing.assert_close(learner.upper.likeliest(batch), meant)
    batch["change"], batch["action"] = -meant, meant.clone()
    torch.testing.assert_close(learner.upper.likeliest(batch), meant)
    found = torch.stack([meant, -meant, meant + 0.1], dim=1)
    assert (learner.upper.log_likelihood(batch, found).argmax(1) == 0).all()


def test_hiro_takes_what_a_demonstrator_reached_for_its_goal() -> None:
    learner = made("hiro", goals=[1, 3], reach=0.5, every=3)
    path, shown, actions = [torch.randn(N, D) for _ in range(4)], torch.tensor([True, False, False]), []
    for index in range(3):
        done = torch.tensor([False, False, index == 1])
        actions.append(step(learner, path[index], path[index + 1], done, shown=shown))
    lower = learner.lower.buffer.storage[: len(learner.lower.buffer)]
    mine = lower[lower["demonstrated"]]
    assert len(lower) == 3 * N and len(mine) == 3, "those of the demonstrator once, when its goal is over"
    ways = torch.stack([(path[3] - path[index])[0, [1, 3]] / 0.5 for index in range(4)])
    torch.testing.assert_close(mine["observation"][:, D:], ways[:3])
    torch.testing.assert_close(mine["next", "observation"][:, D:], ways[1:])
    torch.testing.assert_close(mine["next", "observation"][:, :D], torch.stack([each[0] for each in path[1:]]))
    torch.testing.assert_close(mine["next", "reward"][:, 0], -ways[1:].norm(dim=1))
    torch.testing.assert_close(mine["action"], torch.stack([each[0] for each in actions]))
    upper = learner.upper.buffer.storage[: len(learner.upper.buffer)]
    assert upper["demonstrated"].tolist() == [False, True, False]
    torch.testing.assert_close(upper["action"][1], ways[0].clamp(-1, 1))
    learner.upper.buffer.storage[:]["action"][1] = 0.25  # whatever is likeliest
    sampled = learner.upper.sample()
    assert (sampled["action"][sampled["demonstrated"]] == 0.25).all() and sampled["demonstrated"].any()


def test_what_is_counted_in_updates_ends_as_soon_for_a_learner_that_takes_turns() -> None:
    rare = seldom(replace(agent(), critic_warmup_updates=2000, ema_rate=5e-4, updates_per_policy_step=0.25), 10)
    assert (rare.critic_warmup_updates, rare.ema_rate, rare.updates_per_policy_step) == (200, 5e-3, 0.025)
    assert seldom(replace(agent(), ema_rate=0.5), 10).ema_rate == 1.0


def test_hiros_columns_are_those_of_the_observation() -> None:
    with pytest.raises(ConfigError, match=r"^agent\.own\.goals=\[1, 5\]: the observation has columns 0 to 4$"):
        made("hiro", goals=[1, 5])
    with pytest.raises(ConfigError, match=r"goals=\[1, 1\] contains an entry twice"):
        made("hiro", goals=[1, 1])


def test_hiros_saved_policy_keeps_its_goal_for_as_long_as_in_training() -> None:
    learner = made("hiro", goals=[0, 1], reach=1.0, every=3)
    learner.policy.eval()
    memory, goals, path = torch.zeros(N, learner.policy.memory_dim), [], [torch.randn(N, D) for _ in range(4)]
    for observation in path:
        action, memory = learner.policy(observation, memory)
        goals.append(memory[:, 1:3])
        wanted = learner.lower.average.mode(torch.cat([observation, goals[-1]], dim=1))
        torch.testing.assert_close(action, wanted)
    for index in (1, 2):
        torch.testing.assert_close(goals[index], goals[0] - (path[index] - path[0])[:, :2])
    torch.testing.assert_close(goals[3], learner.upper.average.mode(path[3]))


def gradient_of_terminations(in_force: int) -> float:
    """Return the slope of the termination loss in the logit of the option in force, where option 1 is the better."""
    learner = made("option_critic", options=2, deliberation_cost=0.05)
    assert isinstance(learner, OptionCritic)
    logits = torch.zeros(1, 2, requires_grad=True)
    learner.loss.terminations = _Given(logits)
    learner.loss.option_values = lambda tensordict: torch.tensor([[1.0, 2.0]])
    option = torch.eye(2)[[in_force]]
    observation = torch.cat([torch.randn(1, D), option], dim=1)
    batch = TensorDict(
        {
            "observation": observation,
            "action": torch.zeros(1, A),
            "steps_to_next_obs": torch.ones(1, 1),
            "next": {"observation": observation, "reward": torch.zeros(1, 1), "terminated": torch.tensor([[False]])},
        },
        batch_size=[1],
    )
    learner.loss(batch)["loss_termination"].backward()
    assert logits.grad is not None
    return float(logits.grad[0, in_force])


class _Given(torch.nn.Module):
    def __init__(self, logits: Tensor) -> None:
        super().__init__()
        self.logits = logits

    def forward(self, seen: Tensor) -> Tensor:
        return self.logits.expand(len(seen), -1)


def test_a_worse_option_learns_to_end_and_the_best_to_go_on() -> None:
    assert gradient_of_terminations(0) < 0 < gradient_of_terminations(1)


def test_the_target_is_the_value_of_arriving_with_an_option() -> None:
    loss = made("option_critic", options=2).loss
    loss.option_values = lambda tensordict: torch.tensor([[1.0, 3.0]]).expand(3, -1)
    loss.terminations = _Given(torch.tensor([[0.25, 0.75]]).logit())
    in_force = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    observation = torch.cat([torch.randn(3, D), in_force], dim=1)
    after = {
        "observation": observation,
        "reward": torch.full((3, 1), 0.5),
        "terminated": torch.tensor([[False], [False], [True]]),
    }
    batch = TensorDict(
        {
            "observation": observation,
            "action": torch.rand(3, A),
            "steps_to_next_obs": torch.full((3, 1), 2),
            "next": after,
        },
        batch_size=[3],
    )
    arriving = torch.tensor([0.75 * 1.0 + 0.25 * 3.0, 3.0, 0.0])  # (1 - beta) Q(in force) + beta Q(best)
    wanted = 0.5 + loss.gamma**2 * arriving
    value = loss.qvalue_network(observation, batch["action"])
    torch.testing.assert_close(loss(batch)["loss_qvalue"], (value - wanted).square().sum(0).mean())


def test_an_option_is_chosen_by_the_values_that_are_learned() -> None:
    learner = made("option_critic", options=4, exploration=0.0)
    for index in range(20):
        step(learner, torch.randn(N, D), torch.randn(N, D), torch.tensor([False, False, index % 3 == 0]), reward=1.0)
    for _ in range(30):
        learner.update()
    learner.targets.load_state_dict(learner.critics.state_dict())
    learner.average.load_state_dict(learner.actor.state_dict())
    batch = learner.sample()
    seen = batch["next", "observation"][:, :D]
    learned = learner.loss.option_values(batch)
    with torch.no_grad():
        learner.log_alpha += 3.0  # the worth of entropy, which is no part of them
    torch.testing.assert_close(learner.loss.option_values(batch), learned)
    chosen = learned.argmax(1)
    assert len(chosen.unique()) > 1
    assert torch.equal(learner.policy(seen, torch.zeros(len(seen), 4))[1].argmax(1), chosen)
    learner.act(TensorDict({"observation": seen}), 0.0)
    assert torch.equal(learner._option, chosen)


def test_an_option_stays_until_it_ends_and_another_begins_with_the_episode() -> None:
    learner = made("option_critic", options=3, exploration=1.0)
    learner.terminations[-1].bias.data.fill_(-50.0)  # no option ends
    path = [torch.randn(N, D) for _ in range(6)]
    step(learner, path[0], path[1])
    first = learner._option.clone()
    assert (first != NONE).all()
    for index in range(1, 4):
        step(learner, path[index], path[index + 1])
        assert torch.equal(learner._option, first)
    step(learner, path[4], path[5], torch.tensor([True, False, False]))
    assert learner._option[0] == NONE and torch.equal(learner._option[1:], first[1:])
    stored = learner.buffer.storage[: 5 * N]["option"].view(5, N)
    assert torch.equal(stored, first.expand(5, -1))
    learner.terminations[-1].bias.data.fill_(50.0)  # each ends at once
    chosen = set()
    for _ in range(10):
        learner.act(TensorDict({"observation": path[0]}), 0.0)
        chosen.add(tuple(learner._option.tolist()))
    assert len(chosen) > 3


def test_held_exploration_lasts_and_ends_with_the_episode() -> None:
    learner = made("held", hold=4)
    assert isinstance(learner, Held)
    now = torch.randn(N, D)
    actions = torch.stack(
        [step(learner, now, now, torch.tensor([index == 1, False, False])) for index in range(8)]
    )  # fmt: skip
    same = (actions[1:] == actions[:-1]).all(-1)
    assert same[:, 1].tolist() == same[:, 2].tolist() == [True, True, True, False, True, True, True]
    assert same[:, 0].tolist() == [True, False, True, True, True, False, True]
    uniform = torch.stack([learner.act(TensorDict({"observation": now}), 1.0) for _ in range(8)])
    assert uniform.abs().max() <= 1 and 2 <= len(uniform[:, 1].unique(dim=0)) <= 3


def test_skills_learn_end_to_end_each_from_its_stage_and_from_what_the_next_one_expects() -> None:
    learner = made("end_to_end", skills=["pick", "place"], stages=[3, 4])
    assert isinstance(learner, EndToEnd)
    stage = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    following = torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    seen, after = torch.randn(N, D - 2), torch.randn(N, D - 2)
    pick, place = learner.parts.values()
    whole = torch.cat([seen, stage], dim=1)
    step(learner, whole, torch.cat([after, following], dim=1), torch.tensor([False, False, True]), reward=1.0)
    stored = pick.buffer.storage[:2]
    torch.testing.assert_close(stored["observation"], seen[:2])
    assert stored["next", "terminated"][:, 0].tolist() == [False, True]
    for _ in range(2):  # as place expects it now, and once place has learned
        batch, then = pick.sample(), place.actor.mode(after[1:2])
        expected = learner.config.gamma**2 * place.targets(after[1:2], then).amin(0).detach()
        passes = batch["next", "terminated"][:, 0]
        assert passes.any() and not passes.all()
        torch.testing.assert_close(batch["next", "reward"][:, 0], 1 + passes * expected)
        with torch.no_grad():
            place.targets.biases[-1] += 5.0
    assert len(place.buffer) == 1 and place.buffer.storage[:1]["next", "terminated"].item()
    wanted = torch.cat([pick.average.mode(seen[:2]), place.average.mode(seen[2:])])
    torch.testing.assert_close(learner.policy(whole), wanted)
    for _ in range(4):
        learner.update()
    assert [part.updates for part in learner.parts.values()] == [2, 2]


def test_the_stages_have_a_column_for_each_skill() -> None:
    for stages in ([3, 5], [2, 3, 4]):
        with pytest.raises(
            ConfigError, match=r"^agent\.own\.stages=\[.*\] must be columns from 0 to 4, one a round for "
        ):
            made("end_to_end", skills=["pick", "place"], stages=stages)


def test_skills_act_in_their_stages_of_every_round() -> None:
    learner = made("end_to_end", skills=["pick", "place"], stages=[1, 2, 3, 4])
    stage, seen = learner.policy.split(torch.cat([torch.arange(4.0)[:, None], torch.eye(4)], dim=1))
    assert stage.tolist() == [0, 1, 0, 1] and seen[:, 0].tolist() == [0, 1, 2, 3]
