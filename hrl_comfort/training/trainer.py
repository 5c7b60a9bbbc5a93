"""`hrl-comfort train`: the training of a skill, stage by stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.learners import check_terminal_value, make_learner, with_columns
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.config.learning import SKILL_LEARNERS
from hrl_comfort.files.provenance import step_path
from hrl_comfort.files.run_config import environment, stored_config
from hrl_comfort.policies.actor import load_initial_policy, networks_of, save_policy
from hrl_comfort.training.collector import SkillCollector, make_collector
from hrl_comfort.training.curriculum import Curriculum, stage_list
from hrl_comfort.training.logger import MetricsLog
from hrl_comfort.training.loop import EpisodeEnd, TrainingLoop
from hrl_comfort.training.resume import train_in_folder

FEWEST_EPISODES = 20
"""Episodes between two checkpoints below which neither can be called the best."""
SAME_PRECISION_M = 0.005
"""Episodes this much coarser still count for the precision in force (`linear` moves all the time)."""
ALONE: dict[str, Any] = {"demonstrator": None, "demonstrator_envs": 0, "next_skill": None}
"""Values of `agent` with which a learner needs no other policies."""

MakeCollector = Callable[[TrainConfig], SkillCollector]


def train(config: TrainConfig, make: MakeCollector = make_collector) -> Path:
    """Train as `config` says and return the run folder.

    With `config.resume`, the training in that folder continues with its own config.yaml, bit for bit.

    Raises:
        ConfigError: a choice is not allowed, or the folder is taken.
        Preempted: SIGTERM came; a checkpoint has been written.
        TrainingDiverged: a loss or a parameter is not finite any more.
    """
    return train_in_folder(config, lambda own, folder, resumes: Training(own, make, folder, resumes))


class Training(TrainingLoop):
    """Training of a skill in progress, stage by stage."""

    config: TrainConfig
    learner: Any
    collector: SkillCollector
    log: MetricsLog
    unit = "policy_steps"
    command = "train"
    acts_before_updates = True

    def __init__(self, config: TrainConfig, make: MakeCollector, folder: Path, resumes: bool = False) -> None:
        self._make = make
        self.stages = stage_list(config)
        for stage in self.stages:  # before starts of the next skill are sought, which takes minutes
            check_terminal_value(stage.config.agent)
        for stage in [] if resumes else self.stages[1:]:  # a mistake in it is named before the first one trains
            make(stage.config.in_one_process()).close()
        collector = make(self.stages[0].config)
        torch.manual_seed(config.train_seed)
        agent = with_columns(self.stages[0].config.agent, collector.layout)
        learner = make_learner("agent", agent, collector.observation_dim, collector.action_dim)
        if self.stages[1:] and not hasattr(learner, "begin_stage"):
            raise ConfigError(f"curriculum.stages: agent.name={config.agent.name!r} has no begin_stage; choose []")
        if config.initial_policy is not None and not resumes:
            load_initial_policy(learner, Path(config.initial_policy))
        log = MetricsLog(folder, collector.reward_names, getattr(learner, "terms", ()), config)
        title = f"train {config.task.name}"
        super().__init__(config, folder, resumes, learner, collector, log, self.stages[-1].end, title)
        self._own = agent.own
        self.best: dict[str, Any] = {}
        self.recent: list[tuple[float, bool]] = []
        """Precision and success of the episodes since the last checkpoint."""
        self._lap = (0.0, 0, 0)
        """Seconds, policy steps and updates at the latest row."""
        self._enter(0, collector)

    def _enter(self, index: int, collector: SkillCollector) -> None:
        """Begin episodes in the environments of stage `index`."""
        self.index, self.stage, self.collector = index, self.stages[index], collector
        config = self.stage.config
        if hasattr(self.learner, "terminal_value"):
            self.learner.terminal_value = collector.terminal_value
        self.curriculum = Curriculum(config.curriculum, config.task.precision, config.agent.policy_steps)
        collector.reset(self.curriculum.precision_m, self.curriculum.reach)
        self.recent.clear()

    @property
    def end(self) -> int:
        """Policy steps at which the stage ends."""
        return self.stage.end

    def where(self) -> str:
        """Return the stage, if there are several, and the precision."""
        stage = f"stage {self.stage.setting.name}, " if len(self.stages) > 1 else ""
        return f"{stage}precision {self.curriculum.precision_m:.3g} m, "

    def begin_stage(self, index: int) -> None:
        """Go on in stage `index` from the policy that the one before it leaves; cut its episodes."""
        stage = self.stages[index]
        keep_replay, keep_optimiser = stage.setting.replay == "keep", stage.setting.optimiser == "keep"
        self.learner.begin_stage(stage.config.agent, keep_replay, keep_optimiser)
        self.collector.close()
        self._enter(index, self._make(stage.config))

    @property
    def exploration(self) -> float:
        """1, an action at random, before `learning_starts` of a training from nothing; then 0."""
        config = self.config
        return float(config.initial_policy is None and self.steps < config.agent.learning_starts)

    def updates_for(self, steps: int) -> float:
        """Return the number of updates that the `steps` just counted make due: none before `learning_starts`."""
        learns = self.steps - self.stage.replay_begin > self.config.agent.learning_starts
        return steps * self.stage.config.agent.updates_per_policy_step if learns else 0.0

    def step(self) -> list[EpisodeEnd]:
        """Make a decision in every environment, in the next stage if this one is over; return ended episodes."""
        if self.steps >= self.end:
            self.begin_stage(self.index + 1)
        finished = super().step()
        outcomes = [(outcome["precision_m"], outcome["success"] > 0) for outcome in finished]
        self.recent += outcomes
        self.curriculum.advance(self.steps - self.stage.begin, outcomes)
        self.collector.precision_m, self.collector.reach = self.curriculum.precision_m, self.curriculum.reach
        return finished

    def record(self, ends: bool) -> None:
        """Write the row and the checkpoint that are due; both if a stage ends."""
        if self._passes(self.config.agent.log_every) or ends:
            self._write_row()
        if self._passes(self.config.agent.checkpoint_every) or ends:
            self.save()

    def _write_row(self) -> None:
        now = self.seconds, self.steps, self.updates
        seconds, steps, updates = (here - before for here, before in zip(now, self._lap, strict=True))
        spent = max(seconds, 1e-9)
        stage, precision_m = self.stage.setting.name, self.curriculum.precision_m
        self.log.write_row(self.steps, stage, self.updates, precision_m, (self.seconds, steps / spent, updates / spent))
        self._lap = now

    def _passes(self, every: int) -> bool:
        """Return whether the decision just made was the first past a multiple of `every`."""
        return self.steps // every > (self.steps - self.collector.num_envs) // every

    def save_policy(self) -> None:
        """Write policy.pt, a light checkpoint, and the best one if this is it."""
        networks = networks_of(self.learner, self.config.agent.name)
        counters = {
            "policy_steps": self.steps,
            "updates": self.updates,
            "precision_m": self.curriculum.precision_m,
        }
        paths = [step_path(self.checkpoints, self.steps), self.folder / "policy.pt"]
        if self._is_best():
            paths.append(self.checkpoints / "best.pt")
        for path in paths:
            save_policy(path, networks, self.spec(), counters)
        checkpoint.keep_newest(self.checkpoints, self.config.agent.keep_checkpoints)
        self.recent.clear()

    def _is_best(self) -> bool:
        """Return whether the policy did best in this stage: at the tightest precision first, then by success."""
        now_m, stage = self.curriculum.precision_m, self.stage.setting.name
        outcomes = [success for begun_m, success in self.recent if begun_m <= now_m + SAME_PRECISION_M]
        if len(outcomes) < FEWEST_EPISODES:
            return False
        success, best = sum(outcomes) / len(outcomes), self.best
        if best and best["stage"] == stage and (now_m, -success) > (best["precision_m"], -best["success"]):
            return False
        self.best = {"stage": stage, "precision_m": now_m, "success": success, "policy_steps": self.steps}
        return True

    def spec(self) -> dict[str, Any]:
        """Return the description of the policy that its file holds."""
        task, agent = self.config.task, self.config.agent
        own = {} if agent.name in SKILL_LEARNERS else {"agent": asdict(replace(agent, own=self._own, **ALONE))}
        return {
            "task": task.name,
            "observation_dim": self.collector.observation_dim,
            "action_dim": self.collector.action_dim,
            "hidden": list(agent.hidden),
            "normalise": agent.normalise,
            "learner": agent.name,
            **own,
            "environment": {
                "action_repeat": task.action_repeat,
                "action": task.action,
                "observation": task.observation,
                "robot": self.config.robot.name,
                "gripper": self.config.robot.gripper.name,
                "levels": None if self.config.comfort.source == "none" else self.config.comfort.levels,
                "shield": self.config.safety.kind != "none",
                "train_seed": self.config.train_seed,
            },
            "config": stored_config(environment(self.config), self.folder),
        }

    def progress(self) -> dict[str, Any]:
        """Return what provenance.json says about the progress."""
        return {**super().progress(), "best": self.best}

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {
            **super().state_dict(),
            "stage": self.index,
            "curriculum": self.curriculum.state_dict(),
            "best": dict(self.best),
            "recent": [list(each) for each in self.recent],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        if state["stage"] != self.index:
            self.begin_stage(state["stage"])
        super().load_state_dict(state)
        self.curriculum.load_state_dict(state["curriculum"])
        self._lap = (self.seconds, self.steps, self.updates)
        self.best = state["best"]
        self.recent = [(precision_m, success) for precision_m, success in state["recent"]]
