"""Teach one subtask to one policy: a thin loop over what is stepped, a learner and a curriculum.

While a decision is carried out the learner learns from all those before it. So the two can go on beside each
other (`stepper_apart`), and where they take turns the training is the same to the bit.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import torch
import torchrl
from torch import Tensor

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config import TrainConfig
from hrl_comfort.config.compose import save_config
from hrl_comfort.policies.actor import load_initial_policy, save_policy
from hrl_comfort.training.collector import Steps, Transition
from hrl_comfort.training.curriculum import Curriculum
from hrl_comfort.training.logger import MetricsLog, claim, write_provenance
from hrl_comfort.training.preemption import Preempted, asked_to_stop
from hrl_comfort.training.progress import Show, training_line
from hrl_comfort.training.resume import go_on, stopped_config

FEWEST_EPISODES = 20
"""Episodes between two checkpoints below which neither can be called the best."""
SAME_PRECISION_M = 0.005
"""Episodes this much coarser still count for the precision in force (`linear` moves all the time)."""

Make = Callable[[TrainConfig], Steps]
"""configuration in force -> what is stepped."""


def train(config: TrainConfig, make: Make) -> Path:
    """Train as `config` says and return the run folder.

    With `config.resume`, the training in that folder goes on under its own config.yaml, bit for bit as if
    it had never stopped.

    Raises:
        ConfigError: a choice is not allowed, or the folder is taken.
        Preempted: SIGTERM came; a checkpoint has been written.
        TrainingDiverged: a loss or a parameter is not finite any more.
    """
    with begun(config, make) as training:
        training.run()
    return training.folder


@contextmanager
def begun(config: TrainConfig, make: Make) -> Iterator[Training]:
    """Yield the training that `train` runs, at its beginning or where it stopped, and hold its folder.

    Raises:
        ConfigError: see `train`.
    """
    torch.set_num_threads(1)
    torchrl.logger.setLevel("WARNING")  # it reports on every buffer that it allocates
    folder = Path(config.resume or config.output)
    resumes = config.resume is not None
    with claim(folder, resume=resumes):
        config = stopped_config(folder, TrainConfig) if resumes else config
        with closing(make(config)) as steps:
            training = Training(config, steps, folder, resumes)
            if resumes:
                go_on(training, folder)
            yield training


class Training:
    """One training in progress: everything that a resumable checkpoint holds."""

    def __init__(self, config: TrainConfig, steps: Steps, folder: Path, resumes: bool = False) -> None:
        self.config, self.steps, self.folder = config, steps, folder
        self.rows, self.reward_names = steps.shape.rows, steps.shape.reward_names
        self.demonstrated = torch.arange(self.rows) < config.agent.demonstrator_envs
        torch.manual_seed(config.train_seed)
        agent = config.agent
        self.learner = SAC(agent, steps.shape.observation_dim, steps.shape.action_dim)
        if config.initial_policy is not None and not resumes:
            load_initial_policy(self.learner, Path(config.initial_policy))
        self.curriculum = Curriculum(config.curriculum, config.task.precision, agent.policy_steps)
        self.log = MetricsLog(folder, self.reward_names)
        self.policy_steps = 0
        self.updates_due = 0.0
        self.seconds = 0.0
        self.best: dict[str, float] = {}
        self.recent: list[tuple[float, bool]] = []
        """Precision and success of the episodes since the last checkpoint."""
        self.observation = steps.reset(self.curriculum.precision_m)
        """(N, D): what the next decision is made on."""
        self.precision = torch.full((self.rows,), self.curriculum.precision_m, dtype=torch.float64)
        self.returns = torch.zeros(self.rows, dtype=torch.float64)
        self.terms = torch.zeros(self.rows, len(self.reward_names), dtype=torch.float64)
        self._resumed = False

    def run(self) -> None:
        """Train to the end, or go on to it."""
        line = training_line(self.config.task.name, self.config.agent.policy_steps, self.policy_steps)
        with line as show, asked_to_stop() as stop:
            for due in self.rounds(stop, show):
                self.learn(due)

    def rounds(self, stop: Callable[[], bool], show: Show) -> Generator[int]:
        """Let a decision begin in every row and yield how many updates are due by those before, to the end.

        The caller does them before it asks for the next; at the end, those due by the last decision too.

        Raises:
            Preempted: `stop` says so; a checkpoint has been written.
        """
        agent = self.config.agent
        if not self._resumed:
            save_config(self.config, self.folder / "config.yaml")
            self._write_provenance(finished=False)
        self.log.start(self.policy_steps)
        began = time.monotonic() - self.seconds
        lap = (self.seconds, self.policy_steps, self.learner.updates)
        shown: deque[bool] = deque(maxlen=self.config.curriculum.window)
        try:
            while self.policy_steps < agent.policy_steps:
                if stop():
                    checkpoint.save_resumable(self.folder / "checkpoints", self.state_dict())
                    raise Preempted(f"stopped by SIGTERM; go on with resume={self.folder}")
                self.decide()
                yield self.due()
                finished = self.take_in()
                shown.extend(success for _, success in finished)
                ends = self.policy_steps >= agent.policy_steps
                if ends:
                    yield self.due()
                self.seconds = time.monotonic() - began
                if self._passes(agent.log_every) or ends:
                    lap = self._write_row(lap)
                if self._passes(agent.checkpoint_every) or ends:
                    self.save(resumable=not ends)
                show(self.policy_steps, shown, self.curriculum.precision_m)
        finally:
            self.log.close()
        self._write_provenance(finished=True)
        checkpoint.drop_resumable(self.folder / "checkpoints")

    def _write_row(self, lap: tuple[float, int, int]) -> tuple[float, int, int]:
        now = self.seconds, self.policy_steps, self.learner.updates
        spent = max(now[0] - lap[0], 1e-9)
        timing = (self.seconds, (now[1] - lap[1]) / spent, (now[2] - lap[2]) / spent)
        self.log.write_row(self.policy_steps, self.learner.updates, self.curriculum.precision_m, timing)
        return now

    def _passes(self, every: int) -> bool:
        """Return whether the decision just made was the first past a multiple of `every`."""
        return self.policy_steps // every > (self.policy_steps - self.rows) // every

    def decide(self) -> None:
        """Let a decision begin in every row."""
        if self.config.initial_policy is None and self.policy_steps < self.config.agent.learning_starts:
            action = torch.rand(self.rows, self.learner.action_dim, generator=self.learner.generator) * 2 - 1
        else:
            action = self.learner.act(self.observation)
        self.steps.start(action, self.curriculum.precision_m)

    def take_in(self) -> list[tuple[float, bool]]:
        """Remember what the decision led to; return (precision, success) of the episodes that it ended."""
        step = self.steps.finish()
        self.learner.remember(
            self.observation,
            step.action,
            step.reward + step.terminal_value,
            step.next_observation,
            step.terminated,
            step.decision_steps,
            self.demonstrated,
        )
        self.observation = step.observation
        self.policy_steps += self.rows
        finished = self._end_episodes(step)
        self.curriculum.advance(self.policy_steps, finished)
        return finished

    def _end_episodes(self, step: Transition) -> list[tuple[float, bool]]:
        self.returns += step.reward.double()
        self.terms += step.reward_terms.double()
        rows = step.done.nonzero()[:, 0]
        finished = []
        for row in rows[~self.demonstrated[rows]].tolist():
            outcome = {
                "success": float(step.success[row]),
                "return": float(self.returns[row]),
                "steps": float(step.steps[row]),
                "human_collision": float(step.human_collision[row]),
                "other_collision": float(step.other_collision[row]),
            }
            terms = self.terms[row].tolist()
            outcome |= {f"reward/{name}": value for name, value in zip(self.reward_names, terms, strict=True)}
            self.log.episode(outcome)
            finished.append((float(self.precision[row]), bool(step.success[row])))
        self.returns[rows] = 0.0
        self.terms[rows] = 0.0
        self.precision[rows] = self.curriculum.precision_m  # what their next episodes have just started with
        self.recent += finished
        return finished

    def due(self) -> int:
        """Count in the updates that the latest decisions ask for; return how many whole ones are due."""
        if self.policy_steps <= self.config.agent.learning_starts:
            return 0
        self.updates_due += self.rows * self.config.agent.updates_per_policy_step
        due = int(self.updates_due)
        self.updates_due -= due
        return due

    def learn(self, updates: int) -> None:
        """Do so many updates."""
        for _ in range(updates):
            self.log.update(self.learner.update())

    def save(self, resumable: bool) -> None:
        """Write policy.pt, a light checkpoint, the best one if this is it, and what resuming needs."""
        checkpoints = self.folder / "checkpoints"
        networks = self.learner.policy_state()
        precision_m = self.curriculum.precision_m
        counters = {
            "policy_steps": self.policy_steps,
            "updates": self.learner.updates,
            "precision_m": precision_m,
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
        """Return whether the policy did best so far: at the tightest precision first, then by success."""
        now_m = self.curriculum.precision_m
        outcomes = [success for begun_m, success in self.recent if begun_m <= now_m + SAME_PRECISION_M]
        if len(outcomes) < FEWEST_EPISODES:
            return False
        success = sum(outcomes) / len(outcomes)
        if self.best and (now_m, -success) > (self.best["precision_m"], -self.best["success"]):
            return False
        self.best = {"precision_m": now_m, "success": success, "policy_steps": self.policy_steps}
        return True

    def spec(self) -> dict[str, Any]:
        """Return what a policy file says of its policy."""
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
                "train_seed": self.config.train_seed,
            },
        }

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {
            "learner": self.learner.state_dict(),
            **self.steps.state_dict(),
            "curriculum": self.curriculum.state_dict(),
            "log": self.log.state_dict(),
            "rows": {"precision": self.precision, "returns": self.returns, "terms": self.terms},
            "policy_steps": self.policy_steps,
            "updates_due": self.updates_due,
            "seconds": self.seconds,
            "best": dict(self.best),
            "recent": [list(each) for each in self.recent],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.learner.load_state_dict(state["learner"])
        self.observation = self.steps.load_state_dict({name: state[name] for name in ("env", "now")})
        self.curriculum.load_state_dict(state["curriculum"])
        self.log.load_state_dict(state["log"])
        rows: dict[str, Tensor] = state["rows"]
        self.precision, self.returns, self.terms = rows["precision"], rows["returns"], rows["terms"]
        self.policy_steps, self.updates_due = state["policy_steps"], state["updates_due"]
        self.seconds = state["seconds"]
        self.best = state["best"]
        self.recent = [(precision_m, success) for precision_m, success in state["recent"]]
        self._resumed = True

    def _write_provenance(self, finished: bool) -> None:
        seeds = {"train_seed": self.config.train_seed, "episode_seed": self.config.episode_seed}
        write_provenance(
            self.folder,
            seeds,
            finished=finished,
            policy_steps=self.policy_steps,
            updates=self.learner.updates,
            wall_seconds=round(self.seconds, 1),
            best=self.best,
        )
