"""Stages of a training, and the precision schedule within a stage."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from hrl_comfort.composition.stages import stages_of
from hrl_comfort.config import CurriculumConfig, PrecisionConfig, StageConfig, TrainConfig


@dataclass(frozen=True)
class TrainingStage:
    """One stage of a training."""

    setting: StageConfig
    config: TrainConfig
    """In force in this stage."""
    begin: int
    """Policy steps of the training at which it begins, over all environments; so the next two."""
    end: int
    replay_begin: int
    """At which the replay buffer was last empty."""


def stage_list(config: TrainConfig) -> list[TrainingStage]:
    """Return the stages of a training in order."""
    stages: list[TrainingStage] = []
    begin = replay_begin = 0
    for setting, changed in stages_of(config):
        replay_begin = begin if setting.replay == "clear" else replay_begin
        stages.append(TrainingStage(setting, changed, begin, begin + setting.policy_steps, replay_begin))
        begin = stages[-1].end
    return stages


class Curriculum:
    """Precision schedule over one stage of `policy_steps`.

    `off` stays at the task's own precision; `linear` goes from start to end over a fraction of the stage;
    `adaptive` subtracts `step_m` when the success rate over the last `window` episodes at the current
    precision reaches the threshold.
    """

    def __init__(self, config: CurriculumConfig, precision: PrecisionConfig, policy_steps: int) -> None:
        self._config = config
        self._policy_steps = policy_steps
        self.precision_m = precision.grasp_tolerance_m if config.kind == "off" else config.start_m
        """Precision of the episodes that start now, metres."""
        self._outcomes: deque[bool] = deque(maxlen=config.window)

    @property
    def reach(self) -> float | None:
        """Part of the way to home at which the episodes begin that start now; None: as the task says."""
        config = self._config
        if config.reach is None:
            return None
        begin, end = config.reach
        whole = config.start_m - config.end_m
        if config.kind == "off" or not whole:
            return end
        return begin + (end - begin) * min(max((config.start_m - self.precision_m) / whole, 0.0), 1.0)

    def advance(self, policy_steps: int, finished: list[tuple[float, bool]]) -> None:
        """Update by the policy steps of the stage so far and (precision, success) of episodes that just ended."""
        config = self._config
        if config.kind == "linear":
            phase = min(1.0, policy_steps / (config.fraction * self._policy_steps))
            self.precision_m = config.start_m + phase * (config.end_m - config.start_m)
        elif config.kind == "adaptive":
            for precision_m, success in finished:
                # Episodes that began before the last tightening were easier.
                if precision_m == self.precision_m:
                    self._outcomes.append(success)
                    self._tighten_if_mastered()

    def _tighten_if_mastered(self) -> None:
        config = self._config
        mastered = sum(self._outcomes) >= config.threshold * config.window
        if len(self._outcomes) == config.window and mastered and self.precision_m > config.end_m:
            # rounded to the micrometre, so that repeated subtraction lands on the values a reader expects
            self.precision_m = max(config.end_m, round(self.precision_m - config.step_m, 6))
            self._outcomes.clear()

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue."""
        return {"precision_m": self.precision_m, "outcomes": list(self._outcomes)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.precision_m = state["precision_m"]
        self._outcomes.clear()
        self._outcomes.extend(state["outcomes"])
