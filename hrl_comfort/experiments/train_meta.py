"""Teach a controller above frozen policies which option to run: a thin loop over OptionEnv and QLearner."""

from __future__ import annotations

import csv
import time
from pathlib import Path

import torch
import torchrl
from tensordict import TensorDictBase
from torch import Tensor

from hrl_comfort.compose import environment, save_config
from hrl_comfort.config import MetaTrainConfig
from hrl_comfort.experiments.progress import training_line
from hrl_comfort.experiments.training_log import claim, write_provenance
from hrl_comfort.meta.observation import meta_observation
from hrl_comfort.meta.option_env import OptionEnv
from hrl_comfort.meta.q_learning import QLearner
from hrl_comfort.meta.sorting import sorting_options

METRICS = "meta_metrics.csv"
COLUMNS = ("options", "updates", "episodes", "success", "placed", "return", "steps", "exploration", "loss")


def train_meta(config: MetaTrainConfig) -> Path:
    """Train as `config` says; return the run folder: config.yaml, meta_metrics.csv, provenance.json, meta.pt.

    Raises:
      ConfigError: a choice is not allowed, a policy is missing, or the folder is taken.
    """
    torch.set_num_threads(1)
    torchrl.logger.setLevel("WARNING")
    folder = Path(config.output)
    with claim(folder, resume=False):
        MetaTraining(config, folder).run()
    return folder


class MetaTraining:
    """One training in progress."""

    def __init__(self, config: MetaTrainConfig, folder: Path) -> None:
        self.config, self.folder = config, folder
        env_config, levels = environment(config), config.comfort.levels
        self.env = OptionEnv(
            env_config,
            lambda engine: sorting_options(
                config.meta, config.policies, engine.scene, env_config, config.episode_seed
            ),
            config.meta.time_limit_steps,
            config.engine.rows,
            config.episode_seed,
            config.meta_agent.gamma,
            observe=lambda state: meta_observation(state, levels),
            disturbance=config.disturbance,
        )
        spec = self.env.observation_spec
        width, count = spec["observation"].shape[-1], spec["action_mask"].shape[-1]
        self.learner = QLearner(config.meta_agent, width, count, config.train_seed)
        self.options = self.updates = 0
        self.due = 0.0
        self.losses: list[float] = []
        self.finished: list[tuple[float, float, float, float]] = []
        """Success, balls placed, undiscounted return and control steps of episodes since the last row."""
        self.returns = torch.zeros(config.engine.rows, dtype=torch.float64)

    def run(self) -> None:
        """Train to the end."""
        precision_m = self.config.task.precision.take_m
        agent, began, logged = self.config.meta_agent, time.monotonic(), 0
        save_config(self.config, self.folder / "config.yaml")
        self._provenance(began, finished=False)
        with (self.folder / METRICS).open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            now = self.env.reset()
            with training_line("meta", agent.options, 0) as show:
                while self.options < agent.options:
                    now = self.step(now)
                    self.learn()
                    if self.options - logged >= agent.log_every or self.options >= agent.options:
                        logged = self.options
                        writer.writerow(self._row())
                        file.flush()
                        self._save()
                    show(
                        min(self.options, agent.options),
                        [e[0] > 0 for e in self.finished[-100:]],
                        precision_m,
                    )
        self._provenance(began, finished=True)

    def _provenance(self, began: float, finished: bool) -> None:
        write_provenance(
            self.folder,
            {"train_seed": self.config.train_seed, "episode_seed": self.config.episode_seed},
            finished=finished,
            options=self.options,
            updates=self.updates,
            wall_seconds=round(time.monotonic() - began, 1),
        )

    @property
    def exploration(self) -> float:
        """Probability of an option at random."""
        agent = self.config.meta_agent
        if self.options < agent.warmup_options:
            return 1.0
        share = min(1.0, 2 * self.options / agent.options)
        return agent.exploration_start + share * (agent.exploration_end - agent.exploration_start)

    def step(self, now: TensorDictBase) -> TensorDictBase:
        """Let options begin where rows decide, until the next ones end."""
        chosen: Tensor = self.learner.choose(now["observation"], now["action_mask"], self.exploration)
        stepped, now = self.env.step_and_maybe_reset(now.set("action", chosen))
        after = stepped["next"]
        transitions = self.env.transitions(after)
        self.learner.remember(transitions)
        self.options += len(transitions)
        self.due += len(transitions) * self.config.meta_agent.updates_per_option
        self.returns += self.env.earned
        for row in torch.nonzero(after["done"].reshape(-1)).squeeze(-1).tolist():
            placed, steps = self.env.last_state.placed[row].sum(), self.env.last_state.steps[row]
            self.finished.append(
                (float(after["success"][row]), float(placed), float(self.returns[row]), float(steps))
            )
            self.returns[row] = 0.0
        return now

    def learn(self) -> None:
        """Do the updates that are due."""
        if self.options < self.config.meta_agent.warmup_options:
            self.due = 0.0
        while self.due >= 1.0:
            self.due -= 1.0
            self.losses.append(self.learner.update())
            self.updates += 1

    def _row(self) -> list[object]:
        count = len(self.finished)
        means = [sum(e[k] for e in self.finished) / count if count else "" for k in range(4)]
        loss = sum(self.losses) / len(self.losses) if self.losses else ""
        self.finished, self.losses = [], []
        return [self.options, self.updates, count, *means, self.exploration, loss]

    def _save(self) -> None:
        names = [option.name for option in self.env.running.options]
        spec = {"levels": self.config.comfort.levels, "balls": self.config.task.balls, "names": names}
        self.learner.save(self.folder / "meta.pt", spec)
