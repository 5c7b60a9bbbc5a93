"""`hrl-comfort train meta_controller`: the loop over OptionEnv and QLearner, above frozen policies."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from hrl_comfort.agents import checkpoint
from hrl_comfort.config import MetaControllerTrainConfig
from hrl_comfort.config.compose import environment, save_config
from hrl_comfort.files.provenance import write_provenance
from hrl_comfort.files.tables import GrowingTable
from hrl_comfort.hierarchy.observation import meta_observation
from hrl_comfort.hierarchy.option_env import OptionEnv
from hrl_comfort.hierarchy.q_learning import QLearner
from hrl_comfort.hierarchy.sort import sorting_options
from hrl_comfort.progress import progress, success_of
from hrl_comfort.training.preemption import Preempted, asked_to_stop
from hrl_comfort.training.resume import train_in_folder

METRICS = "meta_controller_metrics.csv"
COLUMNS = ("options", "updates", "episodes", "success", "placed", "return", "steps", "exploration", "loss")


def train_meta_controller(config: MetaControllerTrainConfig) -> Path:
    """Train as `config` says; return the run folder.

    With `config.resume`, the training in that folder continues with its own config.yaml, bit for bit unless a
    skill acts at random.

    Raises:
      ConfigError: a choice is not allowed, a policy is missing, or the folder is taken.
      Preempted: SIGTERM came; a checkpoint has been written.
    """
    return train_in_folder(config, ControllerTraining)


class ControllerTraining:
    """One training in progress."""

    _PLAIN = ("options", "updates", "due", "seconds", "losses", "_rows", "_logged")
    """State that is numbers, texts or lists of them."""

    def __init__(self, config: MetaControllerTrainConfig, folder: Path, resumes: bool) -> None:
        self.config, self.folder, self._resumes = config, folder, resumes
        env_config, levels = environment(config), config.comfort.levels
        layout = config.meta_controller_agent.observation
        self.env = OptionEnv(
            env_config,
            lambda engine: sorting_options(
                config.meta_controller, config.policies, engine.scene, env_config, config.episode_seed
            ),
            config.meta_controller.time_limit_steps,
            config.engine.num_envs,
            config.episode_seed,
            config.meta_controller_agent.gamma,
            observe=lambda state: meta_observation(state, levels, layout),
            disturbance=config.disturbance,
        )
        spec = self.env.observation_spec
        width, count = spec["observation"].shape[-1], spec["action_mask"].shape[-1]
        self.learner = QLearner(config.meta_controller_agent, width, count, config.train_seed)
        self.options = self.updates = 0
        self.due = 0.0
        self.seconds = 0.0
        self.losses: list[float] = []
        self.finished: list[tuple[float, ...]] = []
        """Success, balls placed, undiscounted return and control steps of episodes since the last row."""
        self.returns = torch.zeros(config.engine.num_envs, dtype=torch.float64)
        self.now: TensorDictBase = self.env.reset()
        """Observations and masks of the next choice."""
        self._table = GrowingTable(folder / METRICS, COLUMNS)
        self._rows = 0
        self._logged = 0

    def run(self) -> None:
        """Train to the end, or go on to it; at SIGTERM write a checkpoint and raise Preempted."""
        agent = self.config.meta_controller_agent
        checkpoints, began = self.folder / "checkpoints", time.monotonic() - self.seconds
        if not self._resumes:
            save_config(self.config, self.folder / "config.yaml")
            self._provenance(finished=False)
        self._table.begin(self._rows)
        with progress("train meta_controller", agent.options, self.options) as show, asked_to_stop() as stop:
            while self.options < agent.options:
                if stop():
                    checkpoint.save_resumable(checkpoints, self.state_dict())
                    raise Preempted(f"stopped by SIGTERM; go on with train meta_controller resume={self.folder}")
                self.step()
                self.learn()
                self.seconds = time.monotonic() - began
                ends = self.options >= agent.options
                if self.options - self._logged >= agent.log_every or ends:
                    self._write_row()
                    if not ends:
                        checkpoint.save_resumable(checkpoints, self.state_dict())
                    self._save()
                latest = [episode[0] > 0 for episode in self.finished[-100:]]
                show(min(self.options, agent.options), success_of(latest))
        self._provenance(finished=True)
        checkpoint.drop_resumable(checkpoints)

    def _provenance(self, finished: bool) -> None:
        progress = {"options": self.options, "updates": self.updates}
        write_provenance(self.folder, self.config, finished, self.seconds, **progress)

    @property
    def exploration(self) -> float:
        """Probability of an option at random."""
        agent = self.config.meta_controller_agent
        if self.options < agent.warmup_options:
            return 1.0
        share = min(1.0, 2 * self.options / agent.options)
        return agent.exploration_start + share * (agent.exploration_end - agent.exploration_start)

    def step(self) -> None:
        """Start options where an environment awaits one, and step until the next options end."""
        now = self.now
        chosen: Tensor = self.learner.choose(now["observation"], now["action_mask"], self.exploration)
        stepped, self.now = self.env.step_and_maybe_reset(now.set("action", chosen))
        after = stepped["next"]
        transitions = self.env.transitions(after)
        self.learner.remember(transitions)
        self.options += len(transitions)
        self.due += len(transitions) * self.config.meta_controller_agent.updates_per_option
        self.returns += self.env.earned
        for row in torch.nonzero(after["done"].reshape(-1)).squeeze(-1).tolist():
            placed, steps = self.env.last_state.placed[row].sum(), self.env.last_state.steps[row]
            self.finished.append((float(after["success"][row]), float(placed), float(self.returns[row]), float(steps)))
            self.returns[row] = 0.0

    def learn(self) -> None:
        """Do the updates that are due."""
        if self.options < self.config.meta_controller_agent.warmup_options:
            self.due = 0.0
        while self.due >= 1.0:
            self.due -= 1.0
            self.losses.append(self.learner.update())
            self.updates += 1

    def _write_row(self) -> None:
        count = len(self.finished)
        means = [sum(e[k] for e in self.finished) / count if count else None for k in range(4)]
        loss = sum(self.losses) / len(self.losses) if self.losses else None
        self._table.append([self.options, self.updates, count, *means, self.exploration, loss])
        self._rows += 1
        self.finished, self.losses, self._logged = [], [], self.options

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {
            "learner": self.learner.state_dict(),
            "env": self.env.state_dict(),
            "now": dict(self.now.items()),
            "returns": self.returns,
            "finished": [list(each) for each in self.finished],
            **{name: getattr(self, name) for name in self._PLAIN},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.env.load_state_dict(state["env"])
        self.now = TensorDict(state["now"], batch_size=self.env.batch_size)
        self.returns = state["returns"]
        self.finished = [tuple(each) for each in state["finished"]]
        for name in self._PLAIN:
            setattr(self, name, state[name])
        self.learner.load_state_dict(state["learner"])  # last, for it holds torch's random state

    def _save(self) -> None:
        names = [option.name for option in self.env.executor.options]
        spec = {
            "levels": self.config.comfort.levels,
            "balls": self.config.task.balls,
            "names": names,
            "max_waits": self.config.meta_controller.max_waits,
        }
        self.learner.save(self.folder / "meta_controller.pt", spec)
