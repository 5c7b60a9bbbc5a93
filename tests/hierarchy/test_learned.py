"""The learned meta-controller: what it learns, and what is kept of it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.tops.dqn import DQN
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, MetaControllerTrainConfig
from hrl_comfort.config.hierarchy import META_OBSERVATIONS
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.files.run_config import save_config
from hrl_comfort.files.run_folder import find_runs
from hrl_comfort.hierarchy.learned import load_choice, save_controller
from hrl_comfort.hierarchy.observation import observation_dim
from hrl_comfort.training.controller_trainer import train_meta_controller
from tests.hierarchy.test_sort import EXPERTS


@pytest.mark.parametrize("layout", META_OBSERVATIONS)
def test_a_trained_controller_is_saved_and_sorts(tmp_path, layout: str) -> None:
    folder = tmp_path / "meta_controller"
    overrides = [
        "task.objects=2", "human=none", "engine.num_envs=4",
        "meta_controller_agent.options=24", "meta_controller_agent.warmup_options=8",
        "meta_controller_agent.batch_size=8", "meta_controller_agent.log_every=12", f"output={folder}",
        f"meta_controller_agent.observation={layout}",
        *(f"policies.{name}=expert" for name in EXPERTS),
    ]  # fmt: skip
    trained = compose("train_meta_controller", overrides)
    assert isinstance(trained, MetaControllerTrainConfig)
    train_meta_controller(trained)
    rows = (folder / "meta_controller_metrics.csv").read_text().splitlines()
    assert rows[0].startswith("options,updates,episodes") and len(rows) >= 3
    with pytest.raises(ConfigError, match="already holds a controller"):
        train_meta_controller(trained)
    assert [found.name for found in find_runs(tmp_path)] == ["meta_controller"]  # a report of its parent still works
    with pytest.raises(ConfigError, match=r"among \['pick_1'.*here there are \['wait'\] at 10"):
        load_choice(str(folder), 10, ["wait"])
    old = checkpoint.load(folder / "meta_controller.pt")
    with pytest.raises(ConfigError, match=r"was trained with meta_controller\.max_waits=null; here it is 0$"):
        load_choice(str(folder), 10, old["spec"]["names"], 0)
    names = old["spec"]["names"]
    without = {name: value for name, value in old["spec"].items() if name != "max_waits"}
    checkpoint.save(tmp_path / "before.pt", {**old, "spec": without})
    with pytest.raises(ConfigError, match=r"of an earlier version: its max_waits is missing or of a wrong type"):
        load_choice(str(tmp_path / "before.pt"), 10, names)
    checkpoint.save(tmp_path / "old.pt", {**old, "spec": {**old["spec"], "observation_dim": 38}})
    here = observation_dim(layout, 2)
    with pytest.raises(
        ConfigError, match=rf"^policies.meta_controller=\S+ was trained on 38 observations; here there are {here}"
    ):
        load_choice(str(tmp_path / "old.pt"), 10, names)
    checkpoint.save(tmp_path / "layout.pt", {**old, "spec": {**old["spec"], "observation": "x"}})
    with pytest.raises(ConfigError, match="is damaged: its observation is 'x', not default or jobs"):
        load_choice(str(tmp_path / "layout.pt"), 10, names)
    broken = {name: torch.full_like(value, torch.nan) for name, value in old["network"].items()}
    checkpoint.save(tmp_path / "nan.pt", {**old, "network": broken})
    with pytest.raises(ConfigError, match="is damaged: its weights are not all finite numbers"):
        load_choice(str(tmp_path / "nan.pt"), 10, names)
    checkpoint.save(tmp_path / "odd.pt", {**old, "spec": [1]})
    with pytest.raises(ConfigError, match="is not a trained controller"):
        load_choice(str(tmp_path / "odd.pt"), 10, names)
    result = rollout(
        compose(
            "evaluate",
            [
                "task=sort", "task.objects=2", "human=none", "meta_controller=learned", "episodes=2",
                "task.max_episode_steps=400",
                "comfort=sort", f"policies.meta_controller={folder}", *(f"policies.{name}=expert" for name in EXPERTS),
            ],
        )
    )  # fmt: skip
    assert len(result.episodes) == 2 and np.isfinite([e.return_ for e in result.episodes]).all()


def test_a_controller_is_taught_beside_the_people_of_its_skills_in_a_task_of_its_own(tmp_path) -> None:
    save_config(compose("train", ["task=pick", "human=arc", "reward=dense"]), tmp_path / "config.yaml")
    taught = compose("train_meta_controller", [f"policies.pick='{tmp_path}'"])
    assert isinstance(taught, MetaControllerTrainConfig)
    plain = compose("train_meta_controller")
    assert taught.human.motion == "arc"
    assert (taught.task, taught.reward, taught.comfort) == (plain.task, plain.reward, plain.comfort)


def test_a_controller_is_taught_behind_the_shield_of_its_skills(tmp_path) -> None:
    save_config(compose("train", ["task=pick", "safety=ssm", "task.max_step_deg=1.4"]), tmp_path / "config.yaml")
    policies = f"policies.pick='{tmp_path}'"
    taught, unshielded = (
        compose("train_meta_controller", [policies, *words]) for words in (["task=shift"], ["safety=none"])
    )
    assert isinstance(taught, MetaControllerTrainConfig) and isinstance(unshielded, MetaControllerTrainConfig)
    assert (taught.safety.kind, taught.task.max_step_deg, taught.task.name) == ("ssm", 1.4, "shift")
    assert unshielded.safety.kind == "none"


@pytest.mark.parametrize("word", ["robot=ur5e", "robot.name=ur5e"])
def test_another_robot_has_not_the_home_of_that_of_the_run(tmp_path, word: str) -> None:
    save_config(compose("train", ["task=pick", "robot.home_deg=[0,-90,90,0,90,0]"]), tmp_path / "config.yaml")
    same, other = (compose("evaluate", [f"policy='{tmp_path}'", *words]) for words in ([], [word]))
    assert isinstance(same, EvaluateConfig) and isinstance(other, EvaluateConfig)
    assert same.robot.home_deg == [0, -90, 90, 0, 90, 0] and other.robot.home_deg is None


def test_a_controller_learns_to_take_the_option_that_pays() -> None:
    """Two options, one pays 1 and one 0, at once and for good; a third cannot start."""
    agent = compose(
        "train_meta_controller",
        ["meta_controller_agent.batch_size=32", "meta_controller_agent.learning_rate=0.01"],
    ).meta_controller_agent
    learner = DQN(agent, 2, 3)
    mask = torch.tensor([[True, True, False]]).expand(64, 3)
    action = torch.arange(64) % 2
    after = {
        "observation": torch.ones(64, 2), "action_mask": mask, "reward": (action == 0).float()[:, None],
        "done": torch.ones(64, 1, dtype=torch.bool), "terminated": torch.ones(64, 1, dtype=torch.bool),
        "truncated": torch.zeros(64, 1, dtype=torch.bool),
    }  # fmt: skip
    now = {"observation": torch.ones(64, 2), "action_mask": mask, "action": action}
    steps = {"steps_to_next_obs": torch.full((64, 1), 20)}
    learner.observe(TensorDict({**now, **steps, "next": TensorDict(after, batch_size=[64])}, batch_size=[64]))
    for _ in range(200):
        learner.update()
    values = learner.network(TensorDict({"observation": torch.ones(1, 2), "action_mask": mask[:1]}, [1]))
    assert values["action_value"][0, :2].tolist() == pytest.approx([1.0, 0.0], abs=0.05)
    assert learner.act(TensorDict({"observation": torch.ones(1, 2), "action_mask": mask[:1]}, [1])).tolist() == [0]


def test_what_is_kept_of_a_controller_is_the_mean_of_its_networks(tmp_path) -> None:
    agent = compose(
        "train_meta_controller", ["meta_controller_agent.batch_size=4", "meta_controller_agent.ema_rate=0.25"]
    ).meta_controller_agent
    learner = DQN(agent, 1, 2)
    no, mask = torch.zeros(8, 1, dtype=torch.bool), torch.ones(8, 2, dtype=torch.bool)
    after = {
        "observation": torch.ones(8, 1), "action_mask": mask, "reward": torch.ones(8, 1), "done": ~no,
        "terminated": ~no, "truncated": no,
    }  # fmt: skip
    now = {"observation": torch.ones(8, 1), "action_mask": mask, "action": torch.arange(8) % 2}
    steps = {"steps_to_next_obs": torch.full((8, 1), 10)}
    learner.observe(TensorDict({**now, **steps, "next": TensorDict(after, batch_size=[8])}, batch_size=[8]))
    weights = []
    for _ in range(3):
        learner.update()
        weights.append({name: value.clone() for name, value in learner.network.state_dict().items()})
    save_controller(tmp_path / "meta_controller.pt", learner, agent, 1, {})
    kept = checkpoint.load(tmp_path / "meta_controller.pt")["network"]
    for name, value in kept.items():
        first, second, third = (weight[name] for weight in weights)
        torch.testing.assert_close(value, 0.75 * (0.75 * first + 0.25 * second) + 0.25 * third)


def test_what_an_option_leads_to_is_discounted_by_its_length_and_is_worth_what_can_start_there() -> None:
    """One state, an option of 10 control steps that pays 1 and leads back: V = 1 / (1 - gamma**10).

    The other one pays 50 and ends the episode, but cannot start after the first.
    """
    changes = ["batch_size=32", "learning_rate=0.01", "gamma=0.95", "tau=0.1", "hidden=[16]"]
    agent = compose(
        "train_meta_controller", [f"meta_controller_agent.{change}" for change in changes]
    ).meta_controller_agent
    learner = DQN(agent, 1, 2)
    one, mask = torch.ones(64, 1), torch.tensor([[True, False]]).expand(64, 2)
    action = torch.arange(64) % 2
    ends = (action == 1)[:, None]
    after = {
        "observation": one, "action_mask": mask, "reward": 1.0 + 49.0 * ends, "done": ends, "terminated": ends,
        "truncated": torch.zeros_like(ends),
    }  # fmt: skip
    now = {"observation": one, "action_mask": torch.ones_like(mask), "action": action}
    steps = {"steps_to_next_obs": torch.full((64, 1), 10)}
    learner.observe(TensorDict({**now, **steps, "next": TensorDict(after, batch_size=[64])}, batch_size=[64]))
    for _ in range(600):
        learner.update()
    values = learner.network(TensorDict({"observation": one[:1], "action_mask": torch.ones_like(mask[:1])}, [1]))
    assert values["action_value"][0].tolist() == pytest.approx([1 / (1 - 0.95**10), 50.0], rel=0.05)


@pytest.mark.parametrize("network", ["flat", "shared"])
@pytest.mark.parametrize("hidden", [[], [0], ["wide"]])
def test_a_controller_without_widths_gets_one_line(network: str, hidden: list[object], tmp_path: Path) -> None:
    spec = {
        "names": ["wait"], "levels": 1, "objects": 2, "max_waits": None, "observation": "default", "network": network,
        "observation_dim": observation_dim("default", 2), "hidden": hidden, "learner": "dqn",
    }  # fmt: skip
    checkpoint.save(tmp_path / "meta_controller.pt", {"network": {}, "spec": spec})
    told = rf"is damaged: its hidden is {re.escape(str(hidden))}, not one or more widths of 1 to 1000000$"
    with pytest.raises(ConfigError, match=told):
        load_choice(str(tmp_path), 1, ["wait"])
