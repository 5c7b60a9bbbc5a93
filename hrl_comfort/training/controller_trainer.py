"""`hrl-comfort train meta_controller`: the training of a meta-controller above frozen policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from hrl_comfort.agents.learners import make_learner
from hrl_comfort.config import MetaControllerTrainConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.decision import Choose
from hrl_comfort.hierarchy.learned import save_controller
from hrl_comfort.hierarchy.observation import meta_observation
from hrl_comfort.hierarchy.option_env import OptionEnv
from hrl_comfort.hierarchy.sort import sorting_table
from hrl_comfort.hierarchy.tops import RULES
from hrl_comfort.training.logger import OptionsLog
from hrl_comfort.training.loop import Collected, TrainingLoop
from hrl_comfort.training.n_step import NStepReturns
from hrl_comfort.training.resume import train_in_folder

METRICS = "meta_controller_metrics.csv"


def train_meta_controller(config: MetaControllerTrainConfig) -> Path:
    """Train as `config` says; return the run folder.

    With `config.resume`, the training in that folder continues with its own config.yaml, bit for bit.

    Raises:
      ConfigError: a choice is not allowed, a policy is missing, or the folder is taken.
      Preempted: SIGTERM came; a checkpoint has been written.
    """
    return train_in_folder(config, ControllerTraining)


class OptionCollector:
    """Runs options in every environment until the next of them end.

    Args:
        env: of the options.
        rule: chooses in the first environments; None: the learner chooses in all of them.
        demonstrated: number of environments in which the rule chooses; they finish no episode of the learner.
    """

    def __init__(self, env: OptionEnv, rule: Choose | None = None, demonstrated: int = 0) -> None:
        self.env, self._rule = env, rule
        self._demonstrated = torch.arange(env.batch_size[0]) < demonstrated
        self.now: TensorDictBase = env.reset()
        self._returns = torch.zeros(env.batch_size[0], dtype=torch.float64)
        self.ran = torch.zeros(len(env.executor.table), dtype=torch.int64)
        """(K,) control steps of the options that have ended since the latest row of the log."""

    def step(self, action: Tensor) -> Collected:
        """Start options (N,) where an environment awaits one, and step until the next options end."""
        if self._rule is not None:
            action = torch.where(self._demonstrated, self._rule(self.env.decision), action)
        stepped, self.now = self.env.step_and_maybe_reset(self.now.set("action", action))
        after, state = stepped["next"], self.env.last_state
        self._returns += self.env.earned
        finished, subtask = [], self.env.engine.episodes.subtask
        placed = subtask.released(state.stage)
        # A shift succeeds when its time is up, as in an evaluation.
        won = after["truncated"] if subtask.repeats else after["success"]
        done = after["done"].reshape(-1)
        for row in torch.nonzero(done & ~self._demonstrated).squeeze(-1).tolist():
            numbers = won[row], placed[row], self._returns[row], state.steps[row]
            finished.append(dict(zip(OptionsLog.OUTCOMES, map(float, numbers), strict=True)))
        self._returns[done] = 0.0
        ended = self.env.transitions(after)
        chosen = ended[~self._demonstrated[ended["row"]]]
        self.ran.index_add_(0, chosen["action"], chosen["steps_to_next_obs"].reshape(-1))
        return Collected(ended, finished)

    def close(self) -> None:
        """Stop what simulates the environments."""
        self.env.close()

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {"env": self.env.state_dict(), "now": dict(self.now.items()), "returns": self._returns, "ran": self.ran}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.env.load_state_dict(state["env"])
        self.now = TensorDict(state["now"], batch_size=self.env.batch_size)
        self._returns, self.ran = state["returns"], state["ran"]


class ControllerTraining(TrainingLoop):
    """Training of a meta-controller in progress."""

    config: MetaControllerTrainConfig
    learner: Any
    collector: OptionCollector
    log: OptionsLog
    unit = "options"
    command = "train meta_controller"
    acts_before_updates = False

    def __init__(self, config: MetaControllerTrainConfig, folder: Path, resumes: bool) -> None:
        env_config, levels, agent = environment(config), config.comfort.levels, config.meta_controller_agent
        env = OptionEnv(
            env_config,
            lambda engine: sorting_table(
                config.meta_controller, config.policies, engine.scene, env_config, config.episode_seed
            ),
            config.engine.num_envs,
            config.episode_seed,
            agent.gamma,
            observe=lambda state: meta_observation(state, levels, agent.observation),
            disturbance=config.disturbance,
        )
        spec = env.observation_spec
        width, count = spec["observation"].shape[-1], spec["action_mask"].shape[-1]
        torch.manual_seed(config.train_seed)
        learner = make_learner("meta_controller_agent", agent, width, count)
        rule = None if agent.rule is None else RULES[agent.rule]
        collector = OptionCollector(env, rule, agent.rule_envs)
        log = OptionsLog(folder / METRICS, env.executor.table.names)
        super().__init__(config, folder, resumes, learner, collector, log, agent.options, self.command)
        self._observation_dim, self._logged = width, 0
        """Options at the latest row."""
        self._n_step = NStepReturns(agent.n_step, agent.gamma, config.engine.num_envs)

    @property
    def exploration(self) -> float:
        """Probability of an option at random."""
        agent = self.config.meta_controller_agent
        if self.steps < agent.warmup_options:
            return 1.0
        phase = min(1.0, 2 * self.steps / agent.options)
        return agent.exploration_start + phase * (agent.exploration_end - agent.exploration_start)

    def updates_for(self, steps: int) -> float:
        """Return the number of updates that the `steps` just counted make due: none in the warm-up."""
        agent = self.config.meta_controller_agent
        return steps * agent.updates_per_option if self.steps >= agent.warmup_options else 0.0

    def observed(self, transitions: TensorDictBase) -> TensorDictBase:
        """Return the transitions (G,) that are complete now, of `n_step` choices each."""
        return self._n_step(transitions)

    def record(self, ends: bool) -> None:
        """Write a row and a checkpoint every `log_every` options."""
        if self.steps - self._logged >= self.config.meta_controller_agent.log_every or ends:
            self.log.write_row(self.steps, self.updates, self.exploration, self.collector.ran.tolist())
            self.collector.ran.zero_()
            self._logged = self.steps
            self.save()

    def save_policy(self) -> None:
        """Write meta_controller.pt."""
        spec = {
            "levels": self.config.comfort.levels,
            "objects": self.config.task.objects,
            "names": self.collector.env.executor.table.names,
            "max_waits": self.config.meta_controller.max_waits,
            "interruption_steps": self.config.meta_controller.interruption_steps,
        }
        agent = self.config.meta_controller_agent
        save_controller(self.folder / "meta_controller.pt", self.learner, agent, self._observation_dim, spec)

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {**super().state_dict(), "logged": self._logged, "n_step": self._n_step.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self._logged = state["logged"]
        if "n_step" in state:  # those of an earlier version have none
            self._n_step.load_state_dict(state["n_step"])
        super().load_state_dict(state)
