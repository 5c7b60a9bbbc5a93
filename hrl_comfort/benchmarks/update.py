"""`hrl-comfort bench update`: gradient steps a second beside TorchRL's and Stable-Baselines3's SAC."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from pandas import DataFrame
from tensordict import TensorDict

from hrl_comfort.agents.sac import SAC, matmul_precision
from hrl_comfort.benchmarks.measure import Rate, interleaved, need_peers, rate, ratios
from hrl_comfort.benchmarks.peers import TorchRLSAC, stable_baselines3_sac
from hrl_comfort.config import AgentConfig, TrainConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine

BATCHES = (256, 1028)
STORED = 10_000
"""Transitions in the replay buffer."""
OURS = "hrl-comfort"
COLUMNS = ("batch", "learner", "round", "updates_per_s")
Sizes = tuple[int, int]
"""Width of an observation and of an action."""
Update = Callable[[], object]


def bench_update(config: TrainConfig) -> Path:
    """Print gradient steps a second of each learner and our ratio to it; write update.csv and return it.

    Network widths, observations, actions, batches and buffers are equal; one update is a sample, all losses,
    the optimiser's step and the targets'. Peers are measured at PyTorch's and at our matmul precision.

    Raises:
      ConfigError: Stable-Baselines3 is not installed.
    """
    need_peers()
    torch.set_num_threads(1)
    sizes = observed_and_acted(config)

    def learners(batch: int) -> dict[str, Rate]:
        agent = replace(config.agent, batch_size=batch, buffer_size=STORED, critic_warmup_updates=0)
        return {
            name: partial(rate, at_precision(make(agent, sizes), precision or agent.matmul_precision))
            for name, (make, precision) in LEARNERS.items()
        }

    path = Path(config.output) / "update.csv"
    print(table(interleaved(path, COLUMNS, BATCHES, learners)), end="")
    return path


def table(frame: DataFrame) -> str:
    """Return the rows of update.csv as a Markdown table: medians, ranges and ratios."""
    return ratios(frame, OURS, "ours / theirs", inverse=True)


def observed_and_acted(config: TrainConfig) -> Sizes:
    """Return the widths of a training's observations and actions."""
    engine = Engine(environment(config), 1, 0)
    state = engine.reset()
    sizes = engine.episodes.subtask.observe(state).shape[-1], state.joint_target.shape[-1]
    engine.close()
    return sizes


def at_precision(update: Update, precision: str) -> Update:
    """Return an update at a matmul precision."""

    def step() -> None:
        with matmul_precision(precision):
            update()

    return step


def transitions(sizes: Sizes) -> TensorDict:
    """Return STORED random transitions."""
    generator = torch.Generator().manual_seed(0)
    before, after = torch.randn(2, STORED, sizes[0], generator=generator)
    action = torch.rand(STORED, sizes[1], generator=generator) * 2 - 1
    reward = torch.randn(STORED, 1, generator=generator)
    terminated = torch.rand(STORED, 1, generator=generator) < 0.05
    then = {"observation": after, "reward": reward, "terminated": terminated, "done": terminated}
    return TensorDict({"observation": before, "action": action, "next": then}, batch_size=[STORED])


def ours(agent: AgentConfig, sizes: Sizes) -> Update:
    """Return an update of this project's learner."""
    learner, data = SAC(agent, *sizes), transitions(sizes)
    steps, demonstrated = torch.full((STORED, 1), 5), torch.zeros(STORED, dtype=torch.bool)
    learner.observe(data.update({"steps_to_next_obs": steps, "demonstrated": demonstrated}))
    return learner.update


def torchrl(agent: AgentConfig, sizes: Sizes) -> Update:
    """Return an update of TorchRL's SAC."""
    learner = TorchRLSAC(agent, *sizes, gamma=agent.gamma)
    learner.remember(transitions(sizes))
    return learner.update


def stable_baselines3(agent: AgentConfig, sizes: Sizes) -> Update:
    """Return an update of Stable-Baselines3's SAC."""
    import gymnasium
    import numpy as np
    from gymnasium.spaces import Box
    from stable_baselines3.common.logger import configure

    class Blank(gymnasium.Env[Any, Any]):
        """Environment of nothing but spaces."""

        observation_space = Box(-np.inf, np.inf, sizes[:1], np.float32)
        action_space = Box(-1.0, 1.0, sizes[1:], np.float32)

    model = stable_baselines3_sac(agent, Blank(), agent.gamma)
    model.set_logger(configure(None, []))
    data = {key: value.numpy() for key, value in transitions(sizes).flatten_keys(".").items()}
    names = ("observation", "next.observation", "action", "next.reward", "next.terminated")
    for row in zip(*(data[name] for name in names), strict=True):
        model.replay_buffer.add(*row, [{}])
    return lambda: model.train(gradient_steps=1, batch_size=agent.batch_size)


LEARNERS: dict[str, tuple[Callable[[AgentConfig, Sizes], Update], str | None]] = {
    OURS: (ours, None),
    "TorchRL SACLoss": (torchrl, "highest"),
    "Stable-Baselines3": (stable_baselines3, "highest"),
    "TorchRL SACLoss, our precision": (torchrl, None),
    "Stable-Baselines3, our precision": (stable_baselines3, None),
}
"""Name -> function that makes its update, and its matmul precision: `agent.matmul_precision` if None."""
