"""A point on a plane that must reach the origin: the smallest environment with the keys of the real one."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import TrainConfig
from hrl_comfort.training.collector import SkillCollector
from hrl_comfort.training.trainer import train

LIMIT = 20
FLAGS = ("success", "contact", "unsafe_contact", "other_collision", "terminated", "truncated", "done")


class Stopped(Exception):
    """Stands for the end of the process."""


class PointEnv(EnvBase):
    """Velocity-controlled points; a decision takes two steps, its reward is the distance gained."""

    batch_locked = True
    reward_names = ("progress", "reach")

    def __init__(self, rows: int, seed: int, stop_after: int | None = None, kill: bool = False) -> None:
        super().__init__(device="cpu", batch_size=torch.Size([rows]))
        flag, count = Binary(1, shape=(rows, 1), dtype=torch.bool), Unbounded((rows, 1), dtype=torch.int64)
        self.observation_spec = Composite(
            observation=Unbounded((rows, 3)),
            **{name: flag.clone() for name in FLAGS[:3]},
            steps=count.clone(),
            decision_steps=count.clone(),
            shield_share_mean=Unbounded((rows, 1)),
            protective_stops=count.clone(),
            reward_terms=Unbounded((rows, 2)),
            shape=(rows,),
        )
        self.action_spec = Bounded(-1.0, 1.0, shape=(rows, 2))
        self.reward_spec = Unbounded((rows, 1))
        self.full_done_spec = Composite(**{name: flag.clone() for name in FLAGS[3:]}, shape=(rows,))
        self.stop_after, self.kill, self.calls = stop_after, kill, 0
        self.generator = torch.Generator().manual_seed(seed)
        self.precision_m = 0.3
        self.point = torch.zeros(rows, 2)
        self.near = torch.zeros(rows, 1)
        self.steps = torch.zeros(rows, 1, dtype=torch.int64)

    def _observation(self) -> torch.Tensor:
        return torch.cat([self.point, self.near], dim=1)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        rows = torch.ones(len(self.point), dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(-1)
        fresh = torch.rand(len(self.point), 2, generator=self.generator) * 2 - 1
        self.point = torch.where(rows[:, None], fresh, self.point)
        self.near = torch.where(rows[:, None], self.precision_m, self.near)
        self.steps = self.steps.masked_fill(rows[:, None], 0)
        flags = {name: torch.zeros_like(self.steps, dtype=torch.bool) for name in FLAGS}
        return TensorDict(
            {
                "observation": self._observation(),
                **flags,
                "steps": self.steps.clone(),
                "decision_steps": torch.zeros_like(self.steps),
                "shield_share_mean": torch.ones(len(self.point), 1),
                "protective_stops": torch.zeros_like(self.steps),
                "reward_terms": torch.zeros(len(self.point), 2),
            },
            batch_size=self.batch_size,
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.calls += 1
        if self.calls == self.stop_after:
            if self.kill:
                os.kill(os.getpid(), signal.SIGKILL)
            raise Stopped
        before = self.point.norm(dim=1, keepdim=True)
        self.point = (self.point + 0.2 * tensordict["action"]).clamp(-1.5, 1.5)
        distance = self.point.norm(dim=1, keepdim=True)
        self.steps = self.steps + 2
        success, late = distance < self.near, self.steps >= 2 * LIMIT
        terms = torch.cat([before - distance, success.float()], dim=1)
        return TensorDict(
            {
                "observation": self._observation(),
                "reward": terms.sum(1, keepdim=True),
                "reward_terms": terms,
                "success": success,
                "contact": torch.zeros_like(success),
                "unsafe_contact": torch.zeros_like(success),
                "other_collision": torch.zeros_like(success),
                "terminated": success,
                "truncated": late & ~success,
                "done": success | late,
                "steps": self.steps.clone(),
                "decision_steps": torch.full_like(self.steps, 2),
                "shield_share_mean": torch.ones_like(distance),
                "protective_stops": torch.zeros_like(self.steps),
            },
            batch_size=self.batch_size,
        )

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.generator.manual_seed(seed)

    def set_precision(self, precision_m: float) -> None:
        self.precision_m = precision_m

    def state_dict(self, *_: Any, **__: Any) -> dict[str, Any]:
        return {
            "generator": self.generator.get_state(),
            "precision_m": self.precision_m,
            "point": self.point,
            "near": self.near,
            "steps": self.steps,
        }

    def load_state_dict(self, state: dict[str, Any], *_: Any, **__: Any) -> None:
        self.generator.set_state(state["generator"])
        self.precision_m = state["precision_m"]
        self.point, self.near, self.steps = state["point"], state["near"], state["steps"]


SMALL = (
    "agent.policy_steps=1600", "agent.learning_starts=200", "agent.batch_size=64", "agent.hidden=[32,32]",
    "agent.buffer_size=1000", "agent.log_every=200", "agent.checkpoint_every=300", "agent.keep_checkpoints=2",
    "agent.target_entropy=-2", "curriculum.window=20", "engine.num_envs=8",
)  # fmt: skip


def small_config(output: Path, *overrides: str, **changes: Any) -> TrainConfig:
    """Return a training of seconds; `changes` replace fields of the root."""
    config = compose("train", [*SMALL, f"output='{output}'", *overrides])
    assert isinstance(config, TrainConfig)
    return dataclasses.replace(config, **changes)


def make_points(config: TrainConfig, stop_after: int | None = None, kill: bool = False) -> SkillCollector:
    return SkillCollector(config.agent, PointEnv(config.engine.num_envs, config.episode_seed, stop_after, kill))


def interrupted(folder: Path, calls: int, *overrides: str, make: Callable[..., SkillCollector] = make_points) -> Path:
    """Return the folder of a training that stopped after a number of decisions."""
    with pytest.raises(Stopped):
        train(small_config(folder, *overrides), lambda config: make(config, calls))
    return folder
