"""`hrl-comfort bench train`: wall-clock to 95 % success beside Stable-Baselines3's SAC."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.agents.sac import matmul_precision
from hrl_comfort.analysis.tables import markdown
from hrl_comfort.benchmarks.env import ranged
from hrl_comfort.config import ConfigError, EnvConfig, TrainConfig
from hrl_comfort.config.compose import environment
from hrl_comfort.files.tables import read_table, write_table
from hrl_comfort.policies.actor import ActorPolicy
from hrl_comfort.sim.engine import Engine
from hrl_comfort.training.collector import make_collector
from hrl_comfort.training.trainer import Training

SEEDS = (0, 1, 2)
GOAL = 0.95
CHECK_EPISODES, CHECK_SEED = 200, 77_777
"""A check of the success: its episodes, always the same, drawn as in training."""
CHECK_GROWTH = 1.05
"""The next check is due when there are so many times the decisions: arrivals are told to 5 %, or to a
decision of every cell where that is more."""
LIMIT = 10_000
"""Decisions after which a learner is given up."""
OURS = "hrl-comfort"
PEERS: dict[str, dict[str, Any]] = {
    "Stable-Baselines3, 1 cell, an update a decision": {"cells": 1, "updates": 1},
    "Stable-Baselines3, 1 cell, an update in 4 decisions": {"cells": 1, "every": 4, "updates": 1},
    "Stable-Baselines3, 16 cells, 4 updates in 16 decisions": {"cells": 16, "updates": 4},
    "Stable-Baselines3, 16 cells, 1 update in 16 decisions": {"cells": 16, "updates": 1},
    "Stable-Baselines3, 1 cell, an update in 4 decisions, our products": {
        "cells": 1, "every": 4, "updates": 1, "precision": None,
    },
}  # fmt: skip
"""Settings of a peer: its cells, and its updates `every` so many decisions of each; `precision` of its
products, `agent.matmul_precision` if None. A peer as it comes has PyTorch's own."""
COLUMNS = ["learner", "seed", "reached", "policy_steps", "seconds"]
Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Observations (N, D) -> actions (N, 6)."""


class Clock:
    """Seconds spent in training; checks are not training, and begin when updates do."""

    def __init__(self, check: Callable[[Act], bool], warmup: int) -> None:
        self._check, self._began, self._due = check, 0.0, warmup * CHECK_GROWTH
        self.seconds, self.reached = 0.0, False

    def start(self) -> None:
        """Let the training begin: what it needs is there."""
        self._began = time.perf_counter()

    def done(self, act: Act, policy_steps: int) -> bool:
        """Return whether the race is over after so many decisions, checking if that is due."""
        if policy_steps > self._due:
            self._due = policy_steps * CHECK_GROWTH
            paused = time.perf_counter()
            self.seconds = paused - self._began
            self.reached = self._check(act)
            self._began += time.perf_counter() - paused
        return self.reached or policy_steps >= LIMIT


def bench_train(config: TrainConfig) -> Path:
    """Print how long each learner takes to GOAL success, and how much longer than ours; return train.csv.

    The same task, network widths, batch, rates and discount for all; every learner normalises what it
    observes. A learner has arrived when its deterministic policy succeeds in GOAL
    of the checked episodes.

    Raises:
      ConfigError: Stable-Baselines3 is not installed.
    """
    if find_spec("stable_baselines3") is None:
        raise ConfigError("bench train needs Stable-Baselines3: pip install 'hrl-comfort[bench]'")
    torch.set_num_threads(1)
    agent = replace(config.agent, demonstrator=None, demonstrator_envs=0, next_skill=None)
    config = replace(config, agent=agent)  # one core each
    env = environment(config)
    found: list[list[object]] = []
    path = Path(config.output) / "train.csv"
    for seed in SEEDS:
        for name in (OURS, *PEERS):
            clock = Clock(lambda act: success(env, act) >= GOAL, config.agent.learning_starts)
            if name == OURS:
                policy_steps = race(replace(config, train_seed=seed, episode_seed=seed), clock)
            else:
                policy_steps = race_of_peer(config, env, seed, clock, **PEERS[name])
            found.append([name, seed, clock.reached, policy_steps, f"{clock.seconds:.2f}"])
            write_table(path, COLUMNS, found)
    print(table(read_table(path)), end="")
    return path


def table(races: DataFrame) -> str:
    """Return the rows of train.csv as a Markdown table: medians, ranges, times ours; `-` if not reached."""
    ours = races[races["learner"] == OURS].set_index("seed")
    lines = []
    for name, each in races.groupby("learner", sort=False):
        cells = ["-", "-", "-"]
        if each["reached"].all():
            seconds = each.set_index("seed")["seconds"]
            ratio = ranged(list(seconds / ours["seconds"]), 2) if ours["reached"].all() else "-"
            cells = [ranged(list(each["policy_steps"])), ranged(list(seconds), 1), "" if name == OURS else ratio]
        lines.append([name, f"{each['reached'].sum()} of {len(each)}", *cells])
    return markdown(["learner", "arrived", "policy_steps", "seconds", "times ours"], lines)


def success(env: EnvConfig, act: Act) -> float:
    """Return the success share of CHECK_EPISODES episodes drawn as in training, always the same."""
    engine = Engine(env, CHECK_EPISODES, CHECK_SEED)
    state = engine.reset()
    ended, won = np.zeros(CHECK_EPISODES, dtype=bool), np.zeros(CHECK_EPISODES, dtype=bool)
    while not ended.all():
        outcome = engine.step(act(engine.episodes.subtask.observe(state).float().numpy()).astype(np.float64))
        state, done = outcome.state, outcome.done.numpy()
        won |= outcome.success.numpy() & done & ~ended
        ended |= done
    engine.close()
    return float(won.mean())


def race(config: TrainConfig, clock: Clock) -> int:
    """Train by this project until `clock` says so; return the decisions made."""
    with tempfile.TemporaryDirectory() as folder:
        training = Training(config, make_collector, Path(folder))
        learner = training.learner
        policy = ActorPolicy(learner.average, learner.normaliser, {"observation_dim": learner.observation_dim})

        def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
            actions: NDArray[np.float32] = policy(torch.from_numpy(observation)).numpy()
            return actions

        clock.start()
        while not clock.done(act, training.policy_steps):
            training.step()
        return training.policy_steps


def race_of_peer(
    config: TrainConfig,
    env: EnvConfig,
    seed: int,
    clock: Clock,
    cells: int,
    updates: int,
    every: int = 1,
    precision: str | None = "highest",
) -> int:
    """Train by Stable-Baselines3's SAC on the Gymnasium front until `clock` says so; return the decisions."""
    from stable_baselines3 import SAC
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from hrl_comfort.envs.gymnasium import CellGym

    agent = config.agent
    cell = VecNormalize(
        DummyVecEnv([lambda: Monitor(CellGym(env)) for _ in range(cells)]), norm_reward=False, clip_obs=5.0
    )
    model = SAC(
        "MlpPolicy", cell, seed=seed, device="cpu", learning_rate=agent.learning_rate, tau=agent.tau,
        batch_size=agent.batch_size, gamma=agent.gamma**env.task.action_repeat,
        buffer_size=agent.buffer_size, ent_coef=f"auto_{agent.entropy_coefficient}",
        target_entropy=agent.target_entropy, learning_starts=agent.learning_starts,
        train_freq=every, gradient_steps=updates, policy_kwargs={"net_arch": list(agent.hidden)},
    )  # fmt: skip

    class Check(BaseCallback):
        """Stops the training when the race is over."""

        def _on_training_start(self) -> None:
            clock.start()  # cells have been reset by now, as ours have

        def _on_step(self) -> bool:
            return not clock.done(act, self.num_timesteps)

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(model.predict(cell.normalize_obs(observation), deterministic=True)[0])

    with matmul_precision(precision or agent.matmul_precision):
        model.learn(LIMIT, callback=Check())
    cell.close()
    return int(model.num_timesteps)
