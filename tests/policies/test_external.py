"""Policies made elsewhere act through the same evaluation as ours, and say in one line what does not fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3
import torch
from pandas.testing import assert_frame_equal

import hrl_comfort
from hrl_comfort.agents.networks import Actor, Normaliser
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_config import environment
from hrl_comfort.files.tables import read_table
from hrl_comfort.policies.actor import ActorPolicy, load_policy
from hrl_comfort.policies.external import ObservationPolicy
from hrl_comfort.policies.load import observed_by, on_standard_observations
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import subtask
from tests.agents.test_checkpoint import write_policy

MODULE = """
import numpy as np

def wave(observation):
    return np.sin(3 * observation[:, :6])

def narrow(observation):
    return np.zeros((len(observation), 5))

def unbatched(observation):
    return np.zeros(6)

def undefined(observation):
    return np.full((len(observation), 6), np.nan)

class Still:
    def __call__(self, observation):
        return [[0.0] * 6] * len(observation)

number = 3
def ragged(seen):
    return [[0.0] * 6, [0.0]]
def pair(one, two):
    return ragged(one)
class Needing:
    def __init__(self, needed):
        pass
"""
SHORT = {"task.max_episode_steps": 30}
WIDTH = 36


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working directory, which holds the module `somebody`."""
    (tmp_path / "somebody.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(__import__("sys").modules, "somebody", raising=False)
    return tmp_path


def command(*overrides: str) -> Any:
    config = compose("evaluate", ["episodes=2", "task.max_episode_steps=30", *overrides])
    assert isinstance(config, EvaluateConfig)
    return evaluate(config)


def test_a_function_of_a_module_a_callable_and_the_command_give_the_same_episodes(elsewhere: Path) -> None:
    folder = command("policy=somebody:wave", "levels=[1,10]")
    assert folder == Path("runs/evaluate/pick/somebody_wave")
    written = read_table(folder / "episodes.csv")
    named = hrl_comfort.evaluate("somebody:wave", episodes=2, levels=[1, 10], **SHORT)
    assert_frame_equal(written, named)
    given = hrl_comfort.evaluate(lambda seen: np.sin(3 * seen[:, :6]), episodes=2, levels=[1, 10], **SHORT)
    assert_frame_equal(named.drop(columns="policy"), given.drop(columns="policy"))
    assert set(named.policy) == {"somebody:wave"} and list(named.comfort_level) == [1, 1, 10, 10]


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("somebody:narrow", r"returned shape \(2, 5\); actions have shape \(2, 6\)"),
        ("somebody:unbatched", r"returned shape \(6,\); actions have shape \(2, 6\)"),
        ("somebody:undefined", "returned actions that are not finite"),
        ("somebody:ragged", "returned list without a shape"),
        ("somebody:pair", r"must be a function of observation; its own are \(one, two\): missing a required argument"),
        ("somebody:Needing", "is a class that cannot be made without arguments: .*missing 1 required"),
        ("somebody:number", "is of type int; it must be callable"),
        ("somebody:nothing", "somebody.py has no nothing"),
        ("nobody:act", "cannot be imported: No module named 'nobody'"),
        ("sb3:absent.zip", "'absent.zip' is not there"),
        ("sb3:somebody.py", "is not a readable file of Stable-Baselines3: File is not a zip file"),
        ("absent", "is not there; give a run folder, .*package.module:callable, sb3:FILE.zip"),
    ],
)
def test_a_policy_that_does_not_fit_gets_one_line(policy: str, message: str, elsewhere: Path) -> None:
    with pytest.raises(ConfigError, match=f"^policy='{policy}'.* ?{message}"):
        hrl_comfort.evaluate(policy, episodes=2, **SHORT)


def test_a_callable_sees_the_standard_observation_and_the_level_last() -> None:
    seen = []

    def act(observation: np.ndarray) -> np.ndarray:
        seen.append(observation.copy())
        return np.zeros((len(observation), 6))

    hrl_comfort.evaluate(act, episodes=2, **SHORT)
    assert {each.shape for each in seen} == {(2, WIDTH)} and seen[0].dtype == np.float32
    seen.clear()
    hrl_comfort.evaluate(act, episodes=2, levels=[1, 10], **SHORT)
    assert {(each.shape, *each[:, -1]) for each in seen} == {((2, WIDTH + 1), 0.0, 0.0), ((2, WIDTH + 1), 1.0, 1.0)}


def test_a_chain_takes_policies_from_anywhere(elsewhere: Path) -> None:
    sources = ["policies.pick=somebody:wave", "policies.place=somebody:Still", "policies.return=random"]
    folder = command("task=cycle", "meta_controller=nearest", *sources)
    episodes = read_table(folder / "episodes.csv")
    assert episodes is not None and len(episodes) == 2


class Spaces(gymnasium.Env):
    """An environment that is never stepped: its spaces alone make the networks."""

    def __init__(self, width: int = WIDTH, actions: int = 6) -> None:
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (width,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (actions,), np.float32)


def saved(name: str, env: gymnasium.Env, file: Path, **settings: Any) -> Any:
    small = {"policy_kwargs": {"net_arch": [8]}, "device": "cpu", **settings}
    model = getattr(stable_baselines3, name)("MlpPolicy", env, **small)
    model.save(file)
    return model


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("SAC", {"buffer_size": 1}), ("SAC", {"buffer_size": 1, "use_sde": True}), ("TD3", {"buffer_size": 1}),
        ("PPO", {}), ("PPO", {"use_sde": True}),
    ],
)  # fmt: skip
def test_a_file_of_stable_baselines3_acts_as_the_model_that_was_saved(
    name: str, settings: dict[str, Any], tmp_path: Path
) -> None:
    model = saved(name, Spaces(), tmp_path / "model.zip", **settings)
    policy = hrl_comfort.load_policy(f"sb3:{tmp_path}/model.zip")
    observation = np.random.default_rng(0).normal(size=(5, WIDTH)).astype(np.float32)
    expected = model.predict(observation, deterministic=True)[0]
    np.testing.assert_allclose(policy(observation), expected, atol=1e-6)
    np.testing.assert_allclose(policy(observation[0]), expected[0], atol=1e-6)


def test_a_file_of_stable_baselines3_says_which_spaces_it_takes(tmp_path: Path) -> None:
    file = tmp_path / "model.zip"
    saved("PPO", Spaces(WIDTH + 1), file)
    parts = "joint_angles 12, .*human 2, .*goal_offset 4"
    with pytest.raises(ConfigError, match=f"takes observations of 37 numbers; task.name=pick gives 36: {parts}"):
        hrl_comfort.evaluate(f"sb3:{file}", episodes=1, **SHORT)
    saved("PPO", Spaces(actions=7), file)
    with pytest.raises(ConfigError, match=r"gives actions of 7 numbers; .* robot.name=ur3e takes 6"):
        hrl_comfort.evaluate(f"sb3:{file}", episodes=1, **SHORT)
    saved("DQN", gymnasium.make("CartPole-v1"), file, buffer_size=1)
    with pytest.raises(ConfigError, match="both must be boxes of one dimension"):
        hrl_comfort.load_policy(f"sb3:{file}")


def test_a_loaded_policy_acts_as_its_file_on_one_observation_or_many(tmp_path: Path) -> None:
    write_policy(tmp_path / "policy.pt")
    policy, actor = hrl_comfort.load_policy(tmp_path / "policy.pt"), load_policy(tmp_path / "policy.pt")
    observation = torch.randn(3, 4)
    np.testing.assert_array_equal(policy(observation), actor(observation).double().numpy())
    np.testing.assert_allclose(policy(observation[0]), policy(observation)[0], atol=1e-6)
    with pytest.raises(ConfigError, match="takes observations of 4 numbers, not 9"):
        policy(np.zeros((2, 9)))
    with pytest.raises(ConfigError, match="acts on the state of the cell"):
        hrl_comfort.load_policy("expert")


@pytest.mark.parametrize("takes", [None, WIDTH, WIDTH + 1])
def test_behind_a_shield_a_policy_sees_the_share_unless_it_is_one_number_too_much(takes: int | None) -> None:
    task, cell = (
        subtask("reach"),
        environment(compose("train", ["task=reach", "robot.rating=collaborative", "safety=ssm"])),
    )
    engine, widths = Engine(cell, 2, 0), []
    state = engine.reset()

    def act(seen: np.ndarray) -> np.ndarray:
        widths.append(seen.shape[1])
        return np.zeros((2, 6))

    on_standard_observations(ObservationPolicy("mine", act, takes, 6), task, engine.scene, cell)(state)
    assert widths == [takes or WIDTH + 1]


@pytest.mark.parametrize("shield", [None, False, True])
def test_a_trained_policy_sees_the_share_if_it_was_trained_behind_a_shield(shield: bool | None) -> None:
    cell = environment(compose("train", ["task=reach"]))
    about = {"robot": "ur3e", "action": "joint", "action_repeat": 5, "observation": "default"}
    spec = {"task": "reach", "environment": about if shield is None else {**about, "shield": shield}}
    policy = ActorPolicy(Actor(4, 2, [8]), Normaliser(4), spec, None)
    assert list(observed_by(policy, "mine", subtask("reach"), cell).observations)[-1] == (
        "share" if shield else "goal_offset"
    )
