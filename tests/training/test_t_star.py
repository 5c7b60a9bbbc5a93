"""Terminal-state regularisation: what looks like a start of the next skill earns more, and training resumes exactly."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.training.collector import SkillCollector, make_collector
from hrl_comfort.training.next_skill import NextSkill
from hrl_comfort.training.t_star import StartDiscriminator, TerminalStates
from hrl_comfort.training.trainer import Training, train
from tests.point_env import PointEnv, small_config
from tests.stopping import stopping

EASY = (
    "curriculum=off", "human=none", "engine.num_envs=4", "agent.batch_size=16", "agent.learning_starts=16",
    "task.max_episode_steps=20", "task.precision.grasp_tolerance_m=0.5", "task.precision.place_tolerance_m=0.5",
)  # fmt: skip


def test_a_terminal_state_earns_more_the_more_it_looks_like_the_next_skills_starts() -> None:
    torch.manual_seed(0)
    starts, ends = 0.3 * torch.randn(64, 4) + 1, 0.3 * torch.randn(64, 4) - 1
    discriminator = StartDiscriminator(starts, 2.0, seed=1)
    for _ in range(60):
        discriminator.learn(ends)
    like, unlike = discriminator.rewards(starts), discriminator.rewards(ends)
    assert like.mean() > 1.6 and unlike.mean() < 0.4
    assert torch.cat([like, unlike]).min() >= 0 and torch.cat([like, unlike]).max() <= 2
    between = discriminator.rewards(torch.zeros(1, 4)).item()
    assert unlike.mean() < between < like.mean()


def test_a_discriminator_goes_on_from_its_state() -> None:
    starts = torch.randn(16, 3)
    one, other = StartDiscriminator(starts, 1.0, seed=1), StartDiscriminator(starts, 1.0, seed=2)
    one.learn(torch.zeros(4, 3))
    other.load_state_dict(deepcopy(one.state_dict()))
    for each in (one, other):
        each.learn(torch.ones(2, 3))
    assert torch.equal(one.rewards(starts), other.rewards(starts)) and len(other.ends) == 6


def test_the_reward_of_a_stored_success_is_what_the_discriminator_says_now(tmp_path: Path) -> None:
    config = small_config(tmp_path, "curriculum=off", "task.precision.grasp_tolerance_m=0.3", "agent.gamma=0.5")
    env, end = PointEnv(8, 0), torch.tensor([[0.4, 0.2]])
    discriminator = StartDiscriminator(end + 0.1 * torch.randn(64, 2), 4.0, seed=1)
    states = TerminalStates(discriminator, lambda rows: end.expand(len(rows), -1))
    collector = SkillCollector(config.agent, env, next_skill=states)
    training = Training(config, lambda _: collector, tmp_path)
    env.point[:4], env.point[4:] = 0.0, 0.9  # four are there at once
    training.step()
    learner, seen = training.learner, []
    for _ in range(2):
        generator = learner.generator.get_state()
        batch = learner.sample()
        learner.generator.set_state(generator)
        learner.terminal_value = None
        plain, learner.terminal_value = learner.sample(), states.value
        success, seen = batch["next", "success"], [*seen, discriminator.rewards(end).item()]
        assert success.any() and not success.all()
        earned = (batch["next", "reward"] - plain["next", "reward"])[:, 0]
        torch.testing.assert_close(earned, success * 0.5**2 * seen[-1])
        for _ in range(30):
            discriminator.learn(torch.randn(16, 2))
    assert abs(seen[1] - seen[0]) > 0.1


def test_the_next_skill_sees_terminal_states_as_the_sensors_report_them() -> None:
    skill = object.__new__(NextSkill)
    skill._policy = SimpleNamespace(normaliser=lambda seen: seen)
    skill._seen = SimpleNamespace(observe=lambda state: state.joint_pos)
    for noise in (0.0, 2.0):
        words = ["task=pick", f"randomise.joint_noise_deg=[{noise},{noise}]"]
        env = CellEnv(environment(compose("train", words)), 4, 0)
        env.step(env.reset().set("action", torch.zeros(4, 6)))
        off = skill.observed(env, torch.tensor([1, 3])) - env.last.state.joint_pos[[1, 3]].float()
        assert (off != 0).all() if noise else (off == 0).all()
        env.close()


class Deaf:
    """A learner that asks nobody what a success is worth."""

    act = observe = update = state_dict = load_state_dict = lambda *_: None


@pytest.mark.parametrize("name", ["hiro", "end_to_end", f"{__name__}:Deaf"])
def test_a_learner_that_cannot_ask_the_discriminator_is_refused_before_starts_are_sought(
    name: str, tmp_path: Path
) -> None:
    def sought(_: Any) -> Any:
        pytest.fail("a collector seeks starts")

    stage = "{name:b,policy_steps:800,set:{agent:{next_skill_reward:2}}}"
    for words in (["agent.next_skill_reward=2"], [f"curriculum.stages=[{{name:a,policy_steps:800}},{stage}]"]):
        config = small_config(tmp_path, "agent.next_skill=runs/place", f"agent.name='{name}'", *words)
        said = (
            rf"^agent\.next_skill_reward=2 does not go with agent\.name='{name}', which has no terminal_value; choose "
        )
        with pytest.raises(ConfigError, match=said):
            Training(config, sought, tmp_path)


def test_a_buffer_that_is_kept_for_another_next_skill_gets_one_line(tmp_path: Path) -> None:
    stages = "{name:a,policy_steps:800},{name:b,policy_steps:800,replay:keep,set:{agent:{next_skill_reward:2}}}"
    own = ("agent.next_skill=runs/place", f"curriculum.stages=[{stages}]")
    with pytest.raises(ConfigError, match=r"^curriculum\.stages\.1\.replay=keep does not go with another agent\.next_"):
        small_config(tmp_path, *own)
    small_config(tmp_path, *own, "agent.next_skill_reward=1")


@pytest.mark.parametrize("terminal_dim", [0, 5, 64])
def test_memory_is_asked_for_what_the_buffer_stores(
    terminal_dim: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, states, config = list[tuple[str, float]](), None, small_config(tmp_path, "curriculum=off")
    monkeypatch.setattr("hrl_comfort.agents.memory.check_memory", lambda what, floats: asked.append((what, floats)))
    if terminal_dim:
        discriminator = StartDiscriminator(torch.randn(8, terminal_dim), 1.0, seed=1)
        states = TerminalStates(discriminator, lambda rows: torch.zeros(len(rows), terminal_dim))
    training = Training(config, lambda _: SkillCollector(config.agent, PointEnv(8, 0), None, states), tmp_path)
    training.step()
    stored = training.learner.buffer.storage[:8].bytes() / 8
    counted = max(4 * floats / 1000 for what, floats in asked if what == "agent.buffer_size=1000")
    assert stored <= counted < stored + 4


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("place") / "run"
    return train(small_config(folder, *EASY, "task=place", "agent.target_entropy=-6", "agent.policy_steps=40"))


def test_a_training_towards_the_next_skills_starts_resumes_bit_for_bit(place: Path, tmp_path: Path) -> None:
    own = (
        "task=pick", "agent.target_entropy=-6", "agent.policy_steps=240", "agent.checkpoint_every=80",
        "agent.log_every=80", f"agent.next_skill='{place}'", "agent.next_skill_reward=3",
    )  # fmt: skip
    whole = train(small_config(tmp_path / "whole", *EASY, *own))
    half, config = tmp_path / "half", small_config(tmp_path / "half", *EASY, *own)
    with stopping(Training, "step", lambda training: training.steps >= 120):
        train(config)
    train(replace(config, resume=str(half)))
    assert (half / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_no_two_environments_are_open_at_a_time(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    is_open: list[bool] = []

    class Watched(CellEnv):
        def __init__(self, *given: Any) -> None:
            assert not any(is_open), "the other one has the port of live levels"
            self.number = len(is_open)
            is_open.append(True)
            super().__init__(*given)

        def close(self, *given: Any, **named: Any) -> None:
            is_open[self.number] = False
            super().close(*given, **named)

    for module in ("collector", "t_star"):
        monkeypatch.setattr(f"hrl_comfort.training.{module}.CellEnv", Watched)
    own = ("task=pick", f"agent.next_skill='{place}'", "agent.next_skill_reward=3")
    make_collector(small_config(tmp_path, *EASY, *own)).close()
    assert is_open == [False, False]
