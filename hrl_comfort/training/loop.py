"""The training loop: a collector and a learner take turns until the budget is spent."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.learners import Learner
from hrl_comfort.config import TrainingConfig
from hrl_comfort.files.provenance import write_provenance
from hrl_comfort.files.run_config import save_config
from hrl_comfort.progress import progress, success_of
from hrl_comfort.training.logger import RowLog
from hrl_comfort.training.preemption import Preempted, asked_to_stop

EpisodeEnd = dict[str, float]
"""Success, return, control steps and so on of one episode, by column."""


@dataclass(frozen=True)
class Collected:
    """Result of one step of a collector."""

    transitions: TensorDict
    """(F,): what the learner observes, with the keys of TorchRL's losses."""
    finished: list[EpisodeEnd]
    """Episodes that ended."""


class Collector(Protocol):
    """Steps the environments of a training; its state is plain data."""

    now: TensorDictBase
    """(N,): what the next actions are chosen by."""

    def step(self, action: Tensor) -> Collected:
        """Take actions (N, …), one in each environment."""

    def close(self) -> None:
        """Stop what simulates the environments."""

    def state_dict(self) -> dict[str, Any]: ...  # noqa: D102
    def load_state_dict(self, state: dict[str, Any]) -> None: ...  # noqa: D102


class TrainingLoop(ABC):
    """One training in progress: everything that a resumable checkpoint holds.

    Args:
        config: of the whole training; its folder is `folder`.
        resumes: whether `load_state_dict` follows.
        learner, collector, log: the parts that the loop drives.
        total: the budget, in units of `unit`.
        title: of the progress line.
    """

    unit: ClassVar[str]
    """Name of what is counted: one for each transition collected."""
    command: ClassVar[str]
    acts_before_updates: ClassVar[bool]
    """Whether the next actions are chosen before the updates that are due, or after them."""

    def __init__(
        self, config: TrainingConfig, folder: Path, resumes: bool, learner: Learner, collector: Collector, log: RowLog,
        total: int, title: str,
    ) -> None:  # fmt: skip
        self.config, self.folder, self.resumes, self.total, self.title = config, folder, resumes, total, title
        self.learner, self.collector, self.log = learner, collector, log
        self.steps = 0
        self.updates = 0
        self.updates_due = 0.0
        self.seconds = 0.0

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.folder / "checkpoints"

    @property
    def end(self) -> int:
        """Steps at which the current part of the training ends."""
        return self.total

    @property
    @abstractmethod
    def exploration(self) -> float:
        """Probability of an action at random."""

    @abstractmethod
    def updates_for(self, steps: int) -> float:
        """Return the number of updates that the `steps` just counted make due."""

    def observed(self, transitions: TensorDictBase) -> TensorDictBase:
        """Return what the learner observes of the `transitions` (F,) just collected."""
        return transitions

    @abstractmethod
    def record(self, ends: bool) -> None:
        """Write the row and the checkpoint that are due; all if a part of the training ends."""

    @abstractmethod
    def save_policy(self) -> None:
        """Write the policy."""

    def run(self) -> None:
        """Train to the end, or go on to it; at SIGTERM write a checkpoint and raise Preempted."""
        if not self.resumes:
            save_config(self.config, self.folder / "config.yaml")
            self.write_provenance(finished=False)
        self.log.start(self.steps)
        began = time.monotonic() - self.seconds
        latest: deque[bool] = deque(maxlen=100)
        try:
            with progress(self.title, self.total, self.steps) as show, asked_to_stop() as stop:
                while self.steps < self.total:
                    if stop():
                        checkpoint.save_resumable(self.checkpoints, self.state_dict())
                        raise Preempted(f"stopped by SIGTERM; go on with {self.command} resume={self.folder}")
                    latest.extend(outcome["success"] > 0 for outcome in self.step())
                    ends = self.steps >= self.end
                    if ends or not self.acts_before_updates:
                        self.learn()
                    self.seconds = time.monotonic() - began
                    self.record(ends)
                    show(min(self.steps, self.total), f"{self.where()}{success_of(list(latest))}")
        finally:
            self.log.close()
            self.collector.close()
        self.write_provenance(finished=True)
        checkpoint.drop_resumable(self.checkpoints)

    def step(self) -> list[EpisodeEnd]:
        """Choose an action in every environment and take it; return the episodes that ended."""
        action = self.learner.act(self.collector.now, self.exploration)
        if self.acts_before_updates:
            self.learn()
        collected = self.collector.step(action)
        self.learner.observe(self.observed(collected.transitions))
        self.steps += len(collected.transitions)
        self.updates_due += self.updates_for(len(collected.transitions))
        for outcome in collected.finished:
            self.log.episode(outcome)
        return collected.finished

    def learn(self) -> None:
        """Do the updates that are due."""
        due = int(self.updates_due)
        self.updates_due -= due
        for _ in range(due):
            if terms := self.learner.update():
                self.updates += 1
                self.log.update(terms)

    def save(self) -> None:
        """Write the policy and, before the end, what resuming needs."""
        self.save_policy()
        if self.steps < self.total:
            checkpoint.save_resumable(self.checkpoints, self.state_dict())

    def where(self) -> str:
        """Return words on the part of the training for the progress line."""
        return ""

    def progress(self) -> dict[str, Any]:
        """Return what provenance.json says about the progress."""
        return {self.unit: self.steps, "updates": self.updates}

    def write_provenance(self, finished: bool) -> None:
        """Write provenance.json."""
        write_provenance(self.folder, self.config, finished, self.seconds, **self.progress())

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        parts = {name: getattr(self, name).state_dict() for name in ("learner", "collector", "log")}
        counts = {name: getattr(self, name) for name in ("updates", "updates_due", "seconds")}
        return {**parts, self.unit: self.steps, **counts}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        for name in ("collector", "log", "learner"):  # the last may hold torch's global random state
            getattr(self, name).load_state_dict(state[name])
        self.steps, self.updates = state[self.unit], state["updates"]
        self.updates_due, self.seconds = state["updates_due"], state["seconds"]
