"""Terminal-state regularisation: what looks like a start of the next skill earns more, and training resumes exactly."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from hrl_comfort.training.t_star import StartDiscriminator
from hrl_comfort.training.trainer import Training, train
from tests.point_env import small_config
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
        discriminator.judge(ends)
    like, unlike = discriminator.rewards(starts), discriminator.rewards(ends)
    assert like.mean() > 1.6 and unlike.mean() < 0.4
    assert torch.cat([like, unlike]).min() >= 0 and torch.cat([like, unlike]).max() <= 2
    between = discriminator.rewards(torch.zeros(1, 4)).item()
    assert unlike.mean() < between < like.mean()


def test_a_discriminator_goes_on_from_its_state() -> None:
    starts = torch.randn(16, 3)
    one, other = StartDiscriminator(starts, 1.0, seed=1), StartDiscriminator(starts, 1.0, seed=2)
    one.judge(torch.zeros(4, 3))
    other.load_state_dict(deepcopy(one.state_dict()))
    for each in (one, other):
        each.judge(torch.ones(2, 3))
    assert torch.equal(one.rewards(starts), other.rewards(starts)) and len(other.ends) == 6


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
