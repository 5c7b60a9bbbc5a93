"""`hrl-comfort bench train`: wall-clock to 95 % success beside TorchRL's and Stable-Baselines3's SAC."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pandas import DataFrame, Series
from scipy.stats import bootstrap

from hrl_comfort.agents.sac import matmul_precision
from hrl_comfort.analysis.tables import markdown
from hrl_comfort.benchmarks.measure import need_peers, spread
from hrl_comfort.benchmarks.peers import TorchRLSAC, stable_baselines3_sac
from hrl_comfort.config import ConfigError, EnvConfig, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.output import held_folder
from hrl_comfort.files.run_config import environment
from hrl_comfort.files.tables import Floats, read_table, write_table
from hrl_comfort.policies.actor import ActorPolicy
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.training.collector import make_collector
from hrl_comfort.training.trainer import Training

SEEDS = range(10)
GOAL = 0.95
CHECK_EPISODES, CHECK_SEED = 200, 77_777
"""A check of the success: its episodes, always the same, drawn as in training."""
CHECK_GROWTH = 1.05
"""Policy steps of a check over those of the check before."""
RESAMPLES = 2000
COLUMNS = ("task", "learner", "seed", "reached", "policy_steps", "seconds")
Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Raw observations (N, D) -> deterministic actions (N, A)."""


class Clock:
    """Seconds of training until two checks in a row reach GOAL; checks are not timed.

    `check` returns a policy's success share; the first check comes after `first` policy steps, and after
    `limit` of them the race is lost.
    """

    def __init__(self, check: Callable[[Act], float], first: int, limit: int) -> None:
        self._check, self._due, self._limit = check, first * CHECK_GROWTH, limit
        self._began, self._above = 0.0, False
        self.seconds, self.reached = 0.0, False

    def start(self) -> None:
        """Start with the training; environments and networks exist by now."""
        self._began = time.perf_counter()

    def done(self, act: Act, policy_steps: int) -> bool:
        """Return whether the race is over after so many policy steps; check if that is due."""
        over = policy_steps >= self._limit
        if policy_steps > self._due or over:
            self._due = policy_steps * CHECK_GROWTH
            paused = time.perf_counter()
            self.seconds = paused - self._began
            above = self._check(act) >= GOAL
            self.reached, self._above = above and self._above, above
            self._began += time.perf_counter() - paused
        return self.reached or over


def bench_train(config: TrainConfig) -> Path:
    """Race to GOAL success in the task of `config`; print the table of train.csv and return its path.

    All learners have the same task, without curriculum or demonstrator, and the same network widths, batch
    size, learning rate, target rate, discount and matmul precision; each normalises its observations. RACES sets
    the numbers of environments and of updates; `engine.num_envs` and `agent.updates_per_policy_step` have no effect.
    Races that are in train.csv already are not run again.

    Raises:
      ConfigError: Stable-Baselines3 is not installed, or train.csv is not of this command.
    """
    need_peers()
    torch.set_num_threads(1)
    none: dict[str, Any] = dict.fromkeys(("demonstrator", "next_skill", "learning_rate_end"))
    none |= dict.fromkeys(("demonstrator_envs", "other_level"), 0)
    curriculum = replace(config.curriculum, kind="off", stages=[])
    config = replace(config, agent=replace(config.agent, **none), curriculum=curriculum, initial_policy=None)
    env, path = environment(config), Path(config.output) / "train.csv"
    with held_folder(path.parent):
        rows = _races(config, env, path)
    print(table(DataFrame(rows, columns=list(COLUMNS)).infer_objects()), end="")
    return path


def _races(config: TrainConfig, env: EnvConfig, path: Path) -> list[list[object]]:
    """Run the races that are not in `path` yet; return the rows of all."""
    done, agent = read_table(path), config.agent
    if done is not None and tuple(done) != COLUMNS:
        raise ConfigError(f"output={str(path)!r} is there already, and not of this command; choose another output")
    rows: list[list[object]] = [] if done is None else done.to_numpy(object).tolist()
    run = {(task, learner, seed) for task, learner, seed, *_ in rows}
    for seed in SEEDS:
        for name, race in RACES.items():
            if (config.task.name, name, seed) in run:
                continue
            clock = Clock(partial(success, env), agent.learning_starts, agent.policy_steps)
            with matmul_precision(agent.matmul_precision):
                policy_steps = race(replace(config, train_seed=seed, episode_seed=seed), clock)
            rows.append([config.task.name, name, seed, clock.reached, policy_steps, round(clock.seconds, 2)])
            write_table(path, COLUMNS, rows)
    return rows


def table(frame: DataFrame) -> str:
    """Return the rows of train.csv as a Markdown table: medians, ranges, times ours with its 95 % interval.

    There is a column of times for each of our settings. Learners of which some did not arrive get lower bounds,
    marked by ≥: their time to the limit.
    """
    lines = []
    settings = [name for name in frame["learner"].unique() if name.startswith(OURS)]
    for (task, name), races in frame.groupby(["task", "learner"], sort=False):
        bound, times = "" if races["reached"].all() else "≥ ", []
        for setting in settings:
            ours = frame[(frame["task"] == task) & (frame["learner"] == setting)]
            arrived = not ours.empty and ours["reached"].all()
            ratio = bound + times_ours(races["seconds"], ours["seconds"]) if arrived else "-"
            times.append("" if name in settings else ratio)
        share = f"{races['reached'].sum()} of {len(races)}"
        spreads = bound + spread(races["policy_steps"]), bound + spread(races["seconds"], 1)
        lines.append([str(task), str(name), share, *spreads, *times])
    heads = [f"times ours{name.removeprefix(OURS)} [95 %]" for name in settings]
    return markdown(["task", "learner", "arrived", "policy_steps", "seconds", *heads], lines)


def times_ours(theirs: Series, ours: Series) -> str:
    """Return the ratio of median seconds, with the bootstrap interval over seeds."""

    def ratio(theirs: Floats, ours: Floats, axis: int = -1) -> Floats:
        return np.asarray(np.median(theirs, axis=axis) / np.median(ours, axis=axis))

    text = f"{ratio(theirs, ours):.2f}"
    if min(len(theirs), len(ours)) < 2:
        return text
    options: dict[str, Any] = {"n_resamples": RESAMPLES, "method": "percentile", "rng": 0}
    low, high = bootstrap((theirs, ours), ratio, **options).confidence_interval
    return f"{text} [{low:.2f}, {high:.2f}]"


def success(env: EnvConfig, act: Act) -> float:
    """Return the success share of CHECK_EPISODES episodes drawn as in training, always the same."""
    engine = make_engine(env, CHECK_EPISODES, CHECK_SEED)
    engine.reset()
    ended, won = np.zeros(CHECK_EPISODES, dtype=bool), np.zeros(CHECK_EPISODES, dtype=bool)
    while not ended.all():
        outcome = engine.step(act(engine.episodes.observe().float().numpy()).astype(np.float64))
        done = outcome.done.numpy()
        won |= outcome.success.numpy() & done & ~ended
        ended |= done
    engine.close()
    return float(won.mean())


def ours(config: TrainConfig, clock: Clock, num_envs: int, updates: int) -> int:
    """Train by this project until `clock` says so; return the policy steps made."""
    agent = replace(config.agent, updates_per_policy_step=updates / num_envs)
    config = replace(config, agent=agent, engine=replace(config.engine, num_envs=num_envs))
    with tempfile.TemporaryDirectory() as folder:
        training = Training(config, make_collector, Path(folder))
        learner = training.learner
        policy = ActorPolicy(learner.average, learner.normaliser, {"observation_dim": learner.observation_dim})

        def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
            return np.asarray(policy(torch.from_numpy(observation)))

        clock.start()
        while not clock.done(act, training.steps):
            training.step()
        return training.steps


def torchrl(config: TrainConfig, clock: Clock, num_envs: int, updates: int, every: int = 1) -> int:
    """Train by TorchRL's SAC and collector until `clock` says so; return the policy steps made."""
    from torchrl.collectors import Collector
    from torchrl.envs import TransformedEnv
    from torchrl.envs.transforms import VecNormV2

    env, agent = environment(config), config.agent
    torch.manual_seed(config.train_seed)
    normalise = VecNormV2(["observation"], reduce_batch_dims=True)
    cells = TransformedEnv(CellEnv(env, num_envs, config.episode_seed), normalise)
    sizes = cells.observation_spec["observation"].shape[-1], cells.action_spec.shape[-1]
    learner = TorchRLSAC(agent, *sizes, gamma=agent.gamma**env.task.action_repeat)
    network = learner.policy[0].module

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.no_grad():
            seen = (torch.from_numpy(observation) - normalise.loc["observation"]) / normalise.scale["observation"]
            return np.asarray(network(seen)[0].tanh())

    collector = Collector(
        cells,
        learner.policy,
        frames_per_batch=num_envs * every,
        total_frames=agent.policy_steps,
        init_random_frames=agent.learning_starts,
    )
    policy_steps = 0
    clock.start()
    for transitions in collector:
        learner.remember(transitions.reshape(-1))
        policy_steps += transitions.numel()
        for _ in range(updates if policy_steps > agent.learning_starts else 0):
            learner.update()
        if clock.done(act, policy_steps):
            break
    collector.shutdown()
    return policy_steps


def stable_baselines3(config: TrainConfig, clock: Clock, num_envs: int, updates: int, every: int = 1) -> int:
    """Train by Stable-Baselines3's SAC on the Gymnasium front until `clock` says so; return the policy steps."""
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from hrl_comfort.envs.gymnasium import CellGym

    env, agent = environment(config), config.agent
    cells = VecNormalize(
        DummyVecEnv([lambda: Monitor(CellGym(env)) for _ in range(num_envs)]), norm_reward=False, clip_obs=5.0
    )
    model = stable_baselines3_sac(
        agent, cells, agent.gamma**env.task.action_repeat,
        seed=config.train_seed, train_freq=every, gradient_steps=updates,
    )  # fmt: skip

    class Check(BaseCallback):
        """Stops the training when the race is over."""

        def _on_training_start(self) -> None:
            clock.start()  # the cells have been reset by now

        def _on_step(self) -> bool:
            return not clock.done(act, self.num_timesteps)

    def act(observation: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(model.predict(cells.normalize_obs(observation), deterministic=True)[0])

    model.learn(agent.policy_steps, callback=Check())
    cells.close()
    return int(model.num_timesteps)


OURS = "hrl-comfort"
"""Beginning of the names of this project's learners."""
RACES: dict[str, Callable[[TrainConfig, Clock], int]] = {
    f"{OURS}, 16 cells, 4 updates in 16 steps": partial(ours, num_envs=16, updates=4),
    f"{OURS}, 16 cells, 1 update in 16 steps": partial(ours, num_envs=16, updates=1),
    "TorchRL, 16 cells, 4 updates in 16 steps": partial(torchrl, num_envs=16, updates=4),
    "TorchRL, 16 cells, 1 update in 16 steps": partial(torchrl, num_envs=16, updates=1),
    "Stable-Baselines3, 1 cell, an update a step": partial(stable_baselines3, num_envs=1, updates=1),
    "Stable-Baselines3, 1 cell, an update in 4 steps": partial(stable_baselines3, num_envs=1, updates=1, every=4),
    "Stable-Baselines3, 16 cells, 4 updates in 16 steps": partial(stable_baselines3, num_envs=16, updates=4),
    "Stable-Baselines3, 16 cells, 1 update in 16 steps": partial(stable_baselines3, num_envs=16, updates=1),
}
"""Learner -> function that trains it until the clock says so and returns the policy steps made.

A learner has `num_envs` environments, and `updates` gradient steps after `every` policy steps of each.
"""
