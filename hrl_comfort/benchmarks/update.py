"""`hrl-comfort bench update`: gradient steps a second beside TorchRL's and Stable-Baselines3's SAC."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from pandas import DataFrame
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

from hrl_comfort.agents.sac import SAC, matmul_precision
from hrl_comfort.benchmarks.env import medians
from hrl_comfort.config import AgentConfig, ConfigError, TrainConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.sim.engine import Engine

BATCHES = (256, 1028)
ROUNDS = 7
SECONDS = 3.0
"""Of each measurement, at least."""
STORED = 10_000
"""Transitions in the replay buffer."""
Update = Callable[[], object]
COLUMNS = ["batch", "learner", "round", "updates_per_s"]


def bench_update(config: TrainConfig) -> Path:
    """Print gradient steps a second of each learner and our ratio to it; write update.csv and return it.

    Same network widths, observations, actions, batches and buffers; one update is a sample, all losses, the
    optimiser's step and the targets'. Peers are measured as they come and with our inner precision of
    products. Rounds are interleaved; ratios are medians of the rounds' ratios.

    Raises:
      ConfigError: Stable-Baselines3 is not installed.
    """
    if find_spec("stable_baselines3") is None:
        raise ConfigError("bench update needs Stable-Baselines3: pip install 'hrl-comfort[bench]'")
    torch.set_num_threads(1)
    width = observation_width(config)
    rates: list[list[object]] = []
    for batch in BATCHES:
        learners = {
            name: at(precision or config.agent.matmul_precision, make(config.agent, width, batch))
            for name, (make, precision) in LEARNERS.items()
        }
        for update in learners.values():
            update()
        for turn in range(ROUNDS):
            rates += [[batch, name, turn, rate(update)] for name, update in learners.items()]
    path = Path(config.output) / "update.csv"
    write_table(path, COLUMNS, rates)
    print(table(read_table(path)), end="")
    return path


def table(rates: DataFrame) -> str:
    """Return the rows of update.csv as a Markdown table: medians, ranges and ratios."""
    return medians(rates, COLUMNS, OURS, lambda theirs, ours: ours / theirs, "ours / theirs")


def observation_width(config: TrainConfig) -> int:
    """Return how many numbers the policy of a training observes."""
    engine = Engine(environment(config), 1, 0)
    width = engine.episodes.subtask.observe(engine.reset()).shape[-1]
    engine.close()
    return width


def at(precision: str, update: Update) -> Update:
    """Return the update with its float32 products computed at this inner precision."""

    def exact() -> None:
        with matmul_precision(precision):
            update()

    return exact


def rate(update: Update) -> float:
    """Return calls a second, over at least SECONDS."""
    began, count = time.perf_counter(), 0
    while time.perf_counter() - began < SECONDS:
        update()
        count += 1
    return count / (time.perf_counter() - began)


def transitions(width: int, actions: int = 6) -> dict[str, Tensor]:
    """Return STORED made-up transitions."""
    generator = torch.Generator().manual_seed(0)
    before, after = torch.randn(2, STORED, width, generator=generator)
    action = torch.rand(STORED, actions, generator=generator) * 2 - 1
    reward = torch.randn(STORED, generator=generator)
    terminated = torch.rand(STORED, generator=generator) < 0.05
    return {"before": before, "after": after, "action": action, "reward": reward, "terminated": terminated}


def ours(agent: AgentConfig, width: int, batch: int) -> Update:
    """Return an update of this project's learner."""
    return learner(agent, width, batch).update


def learner(agent: AgentConfig, width: int, batch: int) -> SAC:
    """Return this project's learner, its buffer filled with made-up transitions."""
    agent = replace(agent, batch_size=batch, buffer_size=STORED, critic_warmup_updates=0)
    one = SAC(replace(agent, demonstrator=None, demonstrator_envs=0), width, 6)
    data = transitions(width)
    steps = torch.full((STORED,), 5)
    one.remember(data["before"], data["action"], data["reward"], data["after"], data["terminated"], steps)
    return one


def torchrl(agent: AgentConfig, width: int, batch: int) -> Update:
    """Return an update by TorchRL's loss, SoftUpdate and replay buffer, one fused Adam for all losses."""
    cells, activation = list(agent.hidden), nn.ReLU
    body = nn.Sequential(MLP(width, 12, num_cells=cells, activation_class=activation), NormalParamExtractor())
    policy = ProbabilisticActor(
        TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = MLP(width + 6, 1, num_cells=cells, activation_class=activation)
    loss = SACLoss(
        policy,
        ValueOperator(critic, in_keys=["observation", "action"]),
        loss_function="l2",
        target_entropy=-6.0,
    )
    loss.make_value_estimator(gamma=agent.gamma)
    target = SoftUpdate(loss, tau=agent.tau)
    optimiser = torch.optim.Adam(loss.parameters(), lr=agent.learning_rate, fused=True)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(STORED), batch_size=batch)
    data = transitions(width)
    ended = data["terminated"][:, None]
    after = {
        "observation": data["after"],
        "reward": data["reward"][:, None],
        "terminated": ended,
        "done": ended,
    }
    now: dict[str, Any] = {"observation": data["before"], "action": data["action"], "next": after}
    buffer.extend(TensorDict(now, batch_size=[STORED]))

    def update() -> None:
        losses = loss(buffer.sample())
        optimiser.zero_grad(set_to_none=True)
        (losses["loss_qvalue"] + losses["loss_actor"] + losses["loss_alpha"]).backward()
        optimiser.step()
        target.step()

    return update


def stable_baselines3(agent: AgentConfig, width: int, batch: int) -> Update:
    """Return an update of Stable-Baselines3's SAC."""
    import gymnasium
    import numpy as np
    from gymnasium.spaces import Box
    from stable_baselines3 import SAC
    from stable_baselines3.common.logger import configure

    class Blank(gymnasium.Env[Any, Any]):
        """Says how wide observations and actions are."""

        observation_space = Box(-np.inf, np.inf, (width,), np.float32)
        action_space = Box(-1.0, 1.0, (6,), np.float32)

    cells = list(agent.hidden)
    model = SAC(
        "MlpPolicy", Blank(), buffer_size=STORED, batch_size=batch, gamma=agent.gamma, tau=agent.tau,
        learning_rate=agent.learning_rate, policy_kwargs={"net_arch": cells}, device="cpu",
    )  # fmt: skip
    model.set_logger(configure(None, []))
    data = {name: values.numpy() for name, values in transitions(width).items()}
    assert model.replay_buffer is not None
    before, after, action, reward, ended = (
        data[name] for name in ("before", "after", "action", "reward", "terminated")
    )
    for k in range(STORED):
        at = slice(k, k + 1)
        model.replay_buffer.add(before[at], after[at], action[at], reward[at], ended[at], [{}])
    return lambda: model.train(gradient_steps=1, batch_size=batch)


OURS = "hrl-comfort"
LEARNERS: dict[str, tuple[Callable[[AgentConfig, int, int], Update], str | None]] = {
    OURS: (ours, None),
    "TorchRL SACLoss": (torchrl, "highest"),
    "Stable-Baselines3": (stable_baselines3, "highest"),
    "TorchRL SACLoss, our products": (torchrl, None),
    "Stable-Baselines3, our products": (stable_baselines3, None),
}
"""Name -> what makes its update, and its inner precision of products: `agent.matmul_precision` if None."""
