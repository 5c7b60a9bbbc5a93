"""Every learner of tops keeps to one contract, built in or a user's: it learns, resumes, is kept and chooses."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives.value import GAE

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.learners import TOPS, make_learner
from hrl_comfort.agents.tops.ppo import PPO, advantages
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, MetaControllerAgentConfig, MetaControllerTrainConfig
from hrl_comfort.config.overrides import choices
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.hierarchy.learned import load_choice
from hrl_comfort.training.controller_trainer import ControllerTraining, train_meta_controller
from tests.stopping import stopping

OWN = """
import numpy as np
import torch

def still(observation):
    return np.zeros((len(observation), 6))

class Averages:
    '''The mean reward of each option, whatever is observed.'''

    def __init__(self, config, observation_dim, options, own):
        self.options, self.count = options, torch.zeros(options)
        self.policy = torch.nn.Linear(observation_dim, options)
        torch.nn.init.zeros_(self.policy.weight)
        torch.nn.init.zeros_(self.policy.bias)

    @torch.no_grad()
    def act(self, now, exploration):
        mask = now["action_mask"]
        best = self.policy(now["observation"]).masked_fill(~mask, -torch.inf).argmax(1)
        anything = torch.multinomial(mask.float(), 1).squeeze(1)
        return torch.where(torch.rand(len(best)) < exploration, anything, best)

    def observe(self, transitions):
        for action, reward in zip(transitions["action"], transitions["next", "reward"][:, 0]):
            self.count[action] += 1
            self.policy.bias.data[action] += (reward - self.policy.bias.data[action]) / self.count[action]

    def update(self):
        return {"loss": 0.0}

    def state_dict(self):
        return {"policy": self.policy.state_dict(), "count": self.count, "random": torch.get_rng_state()}

    def load_state_dict(self, state):
        self.policy.load_state_dict(state["policy"])
        self.count = state["count"]
        torch.set_rng_state(state["random"])

class Normed(Averages):
    def __init__(self, config, observation_dim, options, own):
        super().__init__(config, observation_dim, options, own)
        self.policy = torch.nn.Sequential(torch.nn.BatchNorm1d(observation_dim), self.policy)

    def act(self, now, exploration):
        return now["action_mask"].float().argmax(1)

    def observe(self, transitions):
        pass

class Last(Averages):
    def act(self, now, exploration):
        return torch.full((len(now),), now["action_mask"].shape[1] - 1)

class Wishful(Averages):
    def act(self, now, exploration):
        return now["action_mask"].float()
"""
EVERY = [*TOPS, "averages:Averages", "averages:Normed"]
SHORT = (
    "task.objects=2", "human=none", "task.max_episode_steps=200", "meta_controller.time_limit_steps=20",
    *(f"policies.{name}=averages:still" for name in ("pick", "place", "return")),
)  # fmt: skip
FEW = {"options": 48, "warmup_options": 8, "batch_size": 8, "log_every": 12, "hidden": "[16]"}
ROLLOUT = {"ppo": ("meta_controller_agent.own.rollout=16",)}


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "averages.py").write_text(OWN, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("averages", None)


def config_of(folder: Path, name: str, *overrides: str) -> MetaControllerTrainConfig:
    few = (f"meta_controller_agent.{key}={value}" for key, value in FEW.items())
    words = [f"meta_controller_agent={name}", "engine.num_envs=4", *SHORT, *few, *ROLLOUT.get(name, ()), *overrides]
    config = compose("train_meta_controller", [*words, f"output='{folder}'"])
    assert isinstance(config, MetaControllerTrainConfig)
    return config


def agent(name: str, **changes: Any) -> MetaControllerAgentConfig:
    return replace(config_of(Path(), name).meta_controller_agent, **changes)


def test_every_built_in_learner_is_a_choice_of_its_group() -> None:
    assert set(TOPS) <= set(choices("meta_controller_agent"))
    for name in TOPS:
        found = compose("train_meta_controller", [f"meta_controller_agent={name}"]).meta_controller_agent
        assert found.name == name and set(found.own) == {each.name for each in fields(TOPS[name].Keys)}


@pytest.mark.parametrize(("name", "n_step"), [*((name, 1) for name in EVERY), ("dqn", 3)])
def test_a_learner_of_tops_stops_goes_on_bit_for_bit_and_its_file_chooses(
    name: str, n_step: int, tmp_path: Path
) -> None:
    words = (f"meta_controller_agent.n_step={n_step}",)
    whole = train_meta_controller(config_of(tmp_path / "whole", name, *words))
    half, config = tmp_path / "half", config_of(tmp_path / "half", name, *words)
    with stopping(ControllerTraining, "step", lambda training: training.steps >= 30):
        train_meta_controller(config)
    train_meta_controller(replace(config, resume=str(half)))
    files = [checkpoint.load(folder / "meta_controller.pt") for folder in (half, whole)]
    for key, tensor in files[0]["network"].items():
        assert torch.equal(tensor, files[1]["network"][key]), key
    tables = [(folder / "meta_controller_metrics.csv").read_bytes() for folder in (half, whole)]
    assert tables[0] == tables[1]
    last = [*csv.DictReader(tables[1].decode().splitlines())][-1]
    assert int(last["updates"]) > 0 and math.isfinite(float(last["loss"]))
    ran = [float(value) for column, value in last.items() if column.startswith("share/")]
    assert len(ran) == len(files[1]["spec"]["names"]) and sum(ran) == pytest.approx(1.0)
    assert files[1]["spec"]["learner"] == name
    asked_for = [*SHORT, f"policies.meta_controller='{whole}'", "meta_controller=learned", "comfort=sort", "episodes=2"]
    asked = compose("evaluate", ["task=sort", *asked_for])
    ends = [[each.return_ for each in rollout(asked).episodes] for _ in range(2)]  # type: ignore[arg-type]
    assert ends[0] == ends[1] and len(ends[0]) == 2


@pytest.mark.parametrize("name", EVERY)
def test_a_learner_of_tops_finds_the_option_that_pays_and_never_one_that_cannot_start(name: str) -> None:
    """Option 0 pays 1 and option 1 nothing, at once and for good; option 2 cannot start."""
    torch.manual_seed(0)
    own = {"ppo": {"rollout": 64}, "discrete_sac": {"target_entropy": 0.05}}.get(name, {})
    made = make_learner("meta_controller_agent", agent(name, learning_rate=0.01, batch_size=32, own=own), 2, 3)
    rows, mask = 32, torch.tensor([[True, True, False]]).expand(32, 3)
    yes = torch.ones(rows, 1, dtype=torch.bool)
    now = TensorDict({"observation": torch.ones(rows, 2), "action_mask": mask, "deciding": yes}, [rows])
    for step in range(100):
        action = made.act(now, 1.0 if step < 4 else 0.0)
        assert action.max() < 2
        after = {
            "observation": torch.ones(rows, 2), "action_mask": mask, "reward": (action == 0).float()[:, None],
            "done": yes, "terminated": yes, "truncated": ~yes,
        }  # fmt: skip
        found = {
            "observation": now["observation"], "action_mask": mask, "action": action, "row": torch.arange(rows),
            "steps_to_next_obs": torch.full((rows, 1), 20), "next": TensorDict(after, [rows]),
        }  # fmt: skip
        made.observe(TensorDict(found, [rows]))
        terms = made.update()
        assert all(map(math.isfinite, terms.values()))
    chosen = torch.cat([made.act(now, 0.0) for _ in range(4)])
    assert (chosen == 0).float().mean() > 0.9


@pytest.mark.parametrize("name", ["dqn", "discrete_sac"])
def test_updates_that_are_due_before_the_first_returns_are_complete_wait(name: str, tmp_path: Path) -> None:
    words = ("meta_controller_agent.n_step=6", "meta_controller_agent.warmup_options=0")
    folder = train_meta_controller(config_of(tmp_path / "run", name, *words))
    last = [*csv.DictReader((folder / "meta_controller_metrics.csv").read_text().splitlines())][-1]
    assert int(last["options"]) >= FEW["options"] and 0 < int(last["updates"]) < FEW["options"]


def test_the_advantages_of_ppo_are_those_of_torchrl_and_rows_do_not_mix() -> None:
    length, gamma, lam = 12, 0.9, 0.8
    value, after, reward = torch.randn(3, length, 1)
    after[:-1] = value[1:]
    done = torch.zeros(length, 1, dtype=torch.bool)
    done[5] = True
    data = TensorDict(
        {
            "state_value": value,
            "next": {"state_value": after, "reward": reward, "done": done, "terminated": done},
        },
        batch_size=[length],
    )
    estimator = GAE(gamma=gamma, lmbda=lam, value_network=None, average_gae=False)
    expected = estimator(data)["advantage"]
    error = reward + gamma * after * ~done - value
    decay = gamma * lam * ~done
    torch.testing.assert_close(advantages(error, decay, torch.zeros(length, dtype=torch.int64)), expected)
    both = torch.arange(2).repeat(length)
    twice = advantages(error.repeat_interleave(2, 0), decay.repeat_interleave(2, 0), both)
    torch.testing.assert_close(twice[::2], expected)
    torch.testing.assert_close(twice[1::2], expected)


def test_ppo_discounts_an_option_by_its_length_and_remembers_how_likely_it_was() -> None:
    made = make_learner("meta_controller_agent", agent("ppo", gamma=0.9), 2, 3)
    assert isinstance(made, PPO)
    mask = torch.ones(2, 3, dtype=torch.bool)
    now = TensorDict({"observation": torch.randn(2, 2), "action_mask": mask, "deciding": torch.ones(2, 1) > 0}, [2])
    action = made.act(now, 0.5)
    logits = made.network.module[0].module(now["observation"])
    expected = (0.5 * logits.softmax(1) + 0.5 / 3).gather(1, action[:, None]).log().squeeze(1)
    torch.testing.assert_close(made._log_prob, expected.detach())
    made.act(now.set("deciding", torch.tensor([[True], [False]])), 0.0)
    torch.testing.assert_close(made._log_prob[1], expected[1].detach())
    flags = {name: torch.zeros(1, 1, dtype=torch.bool) for name in ("done", "terminated", "truncated")}
    after = {"observation": torch.randn(1, 2), "action_mask": mask[:1], "reward": torch.ones(1, 1), **flags}
    given = {**now[1:], "action": action[1:], "row": torch.tensor([1]), "steps_to_next_obs": torch.tensor([[7]])}
    batch = made.with_advantage(TensorDict({**given, "next": TensorDict(after, [1])}, [1]))
    wanted = 1 + 0.9**7 * made.critic(after["observation"])
    torch.testing.assert_close(batch["value_target"], wanted.detach())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["meta_controller_agent=averages:nobody"], r"meta_controller_agent\.name='averages:nobody': .*no nobody$"),
        (["meta_controller_agent=averages:Last"], r".*: act chose option \d+ in row 0, which cannot start; 0, 1"),
        (["meta_controller_agent=averages:Wishful"], r".*: act returned float32 of .*; .* int64 of shape \(4,\)"),
        (["meta_controller_agent=sac"], r"meta_controller_agent=sac is not a choice; choose one of discrete_sac, dqn,"),
        (["meta_controller_agent=ppo", "meta_controller_agent.own.clip=3"], r"meta_controller_agent\.own\.clip=3"),
    ],
)  # fmt: skip
def test_a_learner_of_tops_that_is_not_there_gets_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    def asked() -> None:
        train_meta_controller(config_of(tmp_path / "run", "dqn", *words))

    with pytest.raises(ConfigError, match=f"^{message}"):
        asked()


def test_a_file_whose_learner_is_gone_gets_one_line(tmp_path: Path) -> None:
    folder = train_meta_controller(config_of(tmp_path / "run", "averages:Averages"))
    state = checkpoint.load(folder / "meta_controller.pt")
    spec = state["spec"]
    for changes, message in (
        ({"learner": "dqn"}, r"is damaged: Error\(s\) in loading state_dict"),
        ({"agent": {**spec["agent"], "name": "gone:Averages"}}, r": .*'gone:Averages' cannot be imported"),
        ({"agent": None}, r": .*"),
    ):
        checkpoint.save(tmp_path / "odd.pt", {**state, "spec": {**spec, **changes}})
        with pytest.raises(ConfigError, match=f"^policies.meta_controller=.*{message}"):
            load_choice(str(tmp_path / "odd.pt"), 10, spec["names"])
