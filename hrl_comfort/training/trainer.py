"""`hrl-comfort train`: the loop over collector, learner and curriculum, stage by stage."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config import TrainConfig
from hrl_comfort.config.compose import environment, save_config, stored_config
from hrl_comfort.files.provenance import write_provenance
from hrl_comfort.policies.actor import load_initial_policy, save_policy
from hrl_comfort.progress import progress, success_of
from hrl_comfort.training.collector import Collector, Transition, make_collector
from hrl_comfort.training.curriculum import Curriculum, stage_list
from hrl_comfort.training.logger import OUTCOMES, MetricsLog
from hrl_comfort.training.preemption import Preempted, asked_to_stop
from hrl_comfort.training.resume import train_in_folder

FEWEST_EPISODES = 20
"""Episodes between two checkpoints below which neither can be called the best."""
SAME_PRECISION_M = 0.005
"""Episodes this much coarser still count for the precision in force (`linear` moves all the time)."""

MakeCollector = Callable[[TrainConfig], Collector]


def train(config: TrainConfig, make: MakeCollector = make_collector) -> Path:
    """Train as `config` says and return the run folder.

    With `config.resume`, the training in that folder continues with its own config.yaml, bit for bit.

    Raises:
        ConfigError: a choice is not allowed, or the folder is taken.
        Preempted: SIGTERM came; a checkpoint has been written.
        TrainingDiverged: a loss or a parameter is not finite any more.
    """
    return train_in_folder(config, lambda own, folder, resumes: Training(own, make, folder, resumes))


class Training:
    """One training in progress: everything that a resumable checkpoint holds."""

    def __init__(self, config: TrainConfig, make: MakeCollector, folder: Path, resumes: bool = False) -> None:
        self.config, self.folder, self._make, self._resumes = config, folder, make, resumes
        self.stages = stage_list(config)
        for stage in [] if resumes else self.stages[1:]:
            make(stage.config)  # a mistake in a later stage is named before the first one trains
        collector = make(self.stages[0].config)
        torch.manual_seed(config.train_seed)
        self.learner = SAC(self.stages[0].config.agent, collector.observation_dim, collector.action_dim)
        if config.initial_policy is not None and not resumes:
            load_initial_policy(self.learner, Path(config.initial_policy))
        self.log = MetricsLog(folder, collector.reward_names, config)
        self.policy_steps = 0
        self.updates_due = 0.0
        self.seconds = 0.0
        self.best: dict[str, Any] = {}
        self.recent: list[tuple[float, bool]] = []
        """Precision and success of the episodes since the last checkpoint."""
        self._enter(0, collector)

    def _enter(self, index: int, collector: Collector) -> None:
        """Begin episodes in the environments of stage `index`."""
        self.index, self.stage, self.collector = index, self.stages[index], collector
        config = self.stage.config
        self.curriculum = Curriculum(config.curriculum, config.task.precision, config.agent.policy_steps)
        self.observation = collector.reset(self.curriculum.precision_m)
        """(N, D): what the next decision is made on."""
        self.demonstrated = torch.arange(collector.num_envs) < config.agent.demonstrator_envs
        self.precision = torch.full((collector.num_envs,), self.curriculum.precision_m, dtype=torch.float64)
        self.returns = torch.zeros(collector.num_envs, dtype=torch.float64)
        self.terms = torch.zeros(collector.num_envs, len(collector.reward_names), dtype=torch.float64)
        self.recent.clear()

    def run(self) -> None:
        """Train to the end, or go on to it; at SIGTERM write a checkpoint and raise Preempted."""
        agent = self.config.agent
        if not self._resumes:
            save_config(self.config, self.folder / "config.yaml")
            self._write_provenance(finished=False)
        self.log.start(self.policy_steps)
        began = time.monotonic() - self.seconds
        lap = (self.seconds, self.policy_steps, self.learner.updates)
        shown: deque[bool] = deque(maxlen=self.config.curriculum.window)
        line = progress(f"train {self.config.task.name}", self.stages[-1].end, self.policy_steps)
        try:
            with line as show, asked_to_stop() as stop:
                while self.policy_steps < self.stages[-1].end:
                    if stop():
                        checkpoint.save_resumable(self.folder / "checkpoints", self.state_dict())
                        raise Preempted(f"stopped by SIGTERM; go on with resume={self.folder}")
                    if self.policy_steps >= self.stage.end:
                        self.begin_stage(self.index + 1)
                    finished = self.step()
                    shown.extend(success for _, success in finished)
                    ends = self.policy_steps >= self.stage.end
                    if ends:
                        self.learn()
                    self.seconds = time.monotonic() - began
                    if self._passes(agent.log_every) or ends:
                        lap = self._write_row(lap)
                    if self._passes(agent.checkpoint_every) or ends:
                        self.save(resumable=self.policy_steps < self.stages[-1].end)
                    show(self.policy_steps, f"{self._where}{success_of(list(shown))}")
        finally:
            self.log.close()
        self._write_provenance(finished=True)
        checkpoint.drop_resumable(self.folder / "checkpoints")

    @property
    def _where(self) -> str:
        """The stage, if there are several, and the precision."""
        stage = f"stage {self.stage.setting.name}, " if len(self.stages) > 1 else ""
        return f"{stage}precision {self.curriculum.precision_m:.3g} m, "

    def begin_stage(self, index: int) -> None:
        """Go on in stage `index` from the policy that the one before it leaves; cut its episodes."""
        stage = self.stages[index]
        keep_replay, keep_optimiser = stage.setting.replay == "keep", stage.setting.optimiser == "keep"
        self.learner.begin_stage(stage.config.agent, keep_replay, keep_optimiser)
        self._enter(index, self._make(stage.config))

    def step(self) -> list[tuple[float, bool]]:
        """Make a decision in every environment; return (precision, success) of the episodes that it ends.

        Between the choice of actions and their consequences, the learner does the updates due by earlier decisions.
        """
        if self.config.initial_policy is None and self.policy_steps < self.config.agent.learning_starts:
            size = (self.collector.num_envs, self.learner.action_dim)
            action = torch.rand(size, generator=self.learner.generator) * 2 - 1
        else:
            action = self.learner.act(self.observation)
        self.learn()
        transition = self.collector.step(action, self.curriculum.precision_m)
        self.learner.remember(
            self.observation,
            transition.action,
            transition.reward + transition.terminal_value,
            transition.next_observation,
            transition.terminated,
            transition.decision_steps,
            self.demonstrated,
        )
        self.observation = transition.observation
        self.policy_steps += self.collector.num_envs
        if self.policy_steps - self.stage.replay_begin > self.config.agent.learning_starts:
            self.updates_due += self.collector.num_envs * self.stage.config.agent.updates_per_policy_step
        finished = self._end_episodes(transition)
        self.curriculum.advance(self.policy_steps - self.stage.begin, finished)
        return finished

    def learn(self) -> None:
        """Do the updates that are due."""
        due = int(self.updates_due)
        self.updates_due -= due
        for _ in range(due):
            self.log.update(self.learner.update())

    def _end_episodes(self, transition: Transition) -> list[tuple[float, bool]]:
        self.returns += transition.reward.double()
        self.terms += transition.reward_terms.double()
        rows = transition.done.nonzero()[:, 0]
        finished = []
        for row in rows[~self.demonstrated[rows]].tolist():
            outcome = {name: float(getattr(transition, name)[row]) for name in OUTCOMES if name != "return"}
            terms = zip(self.collector.reward_names, self.terms[row].tolist(), strict=True)
            outcome |= {"return": float(self.returns[row]), **{f"reward/{name}": value for name, value in terms}}
            self.log.episode(outcome)
            finished.append((float(self.precision[row]), bool(transition.success[row])))
        self.returns[rows] = 0.0
        self.terms[rows] = 0.0
        self.precision[rows] = self.curriculum.precision_m  # what their next episodes have just started with
        self.recent += finished
        return finished

    def _write_row(self, lap: tuple[float, int, int]) -> tuple[float, int, int]:
        now = self.seconds, self.policy_steps, self.learner.updates
        spent = max(now[0] - lap[0], 1e-9)
        timing = (self.seconds, (now[1] - lap[1]) / spent, (now[2] - lap[2]) / spent)
        stage, precision_m = self.stage.setting.name, self.curriculum.precision_m
        self.log.write_row(self.policy_steps, stage, self.learner.updates, precision_m, timing)
        return now

    def _passes(self, every: int) -> bool:
        """Return whether the decision just made was the first past a multiple of `every`."""
        return self.policy_steps // every > (self.policy_steps - self.collector.num_envs) // every

    def save(self, resumable: bool) -> None:
        """Write policy.pt, a light checkpoint, the best one if this is it, and what resuming needs."""
        checkpoints = self.folder / "checkpoints"
        networks = self.learner.policy_state()
        counters = {
            "policy_steps": self.policy_steps,
            "updates": self.learner.updates,
            "precision_m": self.curriculum.precision_m,
        }
        paths = [checkpoint.step_path(checkpoints, self.policy_steps), self.folder / "policy.pt"]
        if self._is_best():
            paths.append(checkpoints / "best.pt")
        for path in paths:
            save_policy(path, networks, self.spec(), counters)
        checkpoint.keep_newest(checkpoints, self.config.agent.keep_checkpoints)
        self.recent.clear()
        if resumable:
            checkpoint.save_resumable(checkpoints, self.state_dict())

    def _is_best(self) -> bool:
        """Return whether the policy did best in this stage: at the tightest precision first, then by success."""
        now_m, stage = self.curriculum.precision_m, self.stage.setting.name
        outcomes = [success for begun_m, success in self.recent if begun_m <= now_m + SAME_PRECISION_M]
        if len(outcomes) < FEWEST_EPISODES:
            return False
        success, best = sum(outcomes) / len(outcomes), self.best
        if best and best["stage"] == stage and (now_m, -success) > (best["precision_m"], -best["success"]):
            return False
        self.best = {"stage": stage, "precision_m": now_m, "success": success, "policy_steps": self.policy_steps}
        return True

    def spec(self) -> dict[str, Any]:
        """Return the description of the policy that its file holds."""
        task = self.config.task
        return {
            "task": task.name,
            "observation_dim": self.learner.observation_dim,
            "action_dim": self.learner.action_dim,
            "hidden": list(self.config.agent.hidden),
            "normalise": self.config.agent.normalise,
            "environment": {
                "action_repeat": task.action_repeat,
                "action": task.action,
                "observation": task.observation,
                "robot": self.config.robot.name,
                "levels": None if self.config.comfort.source == "none" else self.config.comfort.levels,
                "shield": self.config.safety.kind != "none",
                "train_seed": self.config.train_seed,
            },
            "config": stored_config(environment(self.config), self.folder),
        }

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {
            "stage": self.index,
            "learner": self.learner.state_dict(),
            "collector": self.collector.state_dict(),
            "curriculum": self.curriculum.state_dict(),
            "log": self.log.state_dict(),
            "episodes": {"precision": self.precision, "returns": self.returns, "terms": self.terms},
            "policy_steps": self.policy_steps,
            "updates_due": self.updates_due,
            "seconds": self.seconds,
            "best": dict(self.best),
            "recent": [list(each) for each in self.recent],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        if state["stage"] != self.index:
            self.begin_stage(state["stage"])
        self.learner.load_state_dict(state["learner"])
        self.observation = self.collector.load_state_dict(state["collector"])
        self.curriculum.load_state_dict(state["curriculum"])
        self.log.load_state_dict(state["log"])
        episodes = state["episodes"]
        self.precision, self.returns, self.terms = episodes["precision"], episodes["returns"], episodes["terms"]
        self.policy_steps, self.updates_due = state["policy_steps"], state["updates_due"]
        self.seconds = state["seconds"]
        self.best = state["best"]
        self.recent = [(precision_m, success) for precision_m, success in state["recent"]]

    def _write_provenance(self, finished: bool) -> None:
        progress = {"policy_steps": self.policy_steps, "updates": self.learner.updates, "best": self.best}
        write_provenance(self.folder, self.config, finished, self.seconds, **progress)
