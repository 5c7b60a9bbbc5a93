"""Judgement of a decision: from readings to State, rewards and outcome."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.adapt import max_episode_steps
from hrl_comfort.comfort.sources import Source
from hrl_comfort.config import EnvConfig
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.episode_sampler import Draw
from hrl_comfort.sim.hand.arrivals import Arrivals
from hrl_comfort.sim.objects import go_on, renewed, update_placed
from hrl_comfort.sim.plan import Planned
from hrl_comfort.sim.sensors import Sensors
from hrl_comfort.sim.step_result import Rules, StepResult, compute_step, reward_weights, source_input
from hrl_comfort.sim.variation.disturbance import Disturbance
from hrl_comfort.sim.variation.slots import ARRIVALS
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]


class Referee:
    """Judge of N cells.

    Args:
      scene: whose sensors are read.
      separation: of arm and people.
      config: of the cells.
      subtask: of their episodes.
      source: of their comfort levels.
      disturbance: which may take objects out of the gripper.
      measure_arm: whether to measure how far people are from the arm, and from one at home, though no reward needs it.
      pushing: whether people do not stop at a touch (`Sensors`).
    """

    def __init__(
        self,
        scene: Scene,
        separation: Separation,
        config: EnvConfig,
        subtask: Subtask,
        source: Source,
        disturbance: Disturbance,
        measure_arm: bool,
        pushing: bool,
    ) -> None:
        self._config, self._disturbance = config, disturbance
        self._arrivals = Arrivals(scene) if scene.gripper is not None and subtask.repeats else None
        self.source = source
        weights = reward_weights(config.reward, config.comfort.scale)
        self.weights = torch.tensor([weights[name] for name in subtask.rewards], dtype=torch.float64)
        self.subtask = subtask
        comfort = config.comfort
        priced = comfort.distance if comfort.source != "none" else None
        paid = comfort.source in ("frightened", "fitted") or priced in ("arm", "avoidable")
        self.sensors = Sensors(scene, separation, measure_arm or paid, measure_arm or priced == "avoidable", pushing)

    @property
    def subtask(self) -> Subtask:
        """That is judged."""
        return self._rules.subtask

    @subtask.setter
    def subtask(self, subtask: Subtask) -> None:
        self._rules = Rules(subtask, self.weights)
        comfort = self._config.comfort
        self._limiting = replace(comfort, beta=0.0) if subtask.repeats else comfort

    def first(self, sensed: Array, planned: Planned, known: dict[str, Tensor]) -> State:
        """Return the state (r) in which episodes begin: from readings (r, nsensor), and fields that are drawn."""
        return State(**self.sensors.read_first(sensed, planned, known), **known)

    def judge(
        self,
        before: State,
        draw: Draw,
        planned: Planned,
        limbs: Array,
        readings: Array,
        rows: NDArray[np.int64] | None,
    ) -> StepResult:
        """Return the result of the decision that began in the state `before` beside people with `limbs` (N, L, 7).

        `readings` (r, K, substeps, nsensor) are those of `rows` (r,), all by default.
        """
        moving = self.sensors.read_decision(readings, planned, before, limbs, rows)
        limits = self.max_episode_steps(before.level)
        result = compute_step(self._rules, limits, before, moving)
        state = result.state
        if self._config.comfort.source != "none":
            state = state.with_(level=torch.from_numpy(self.source.advance(source_input(before, result))))
        state = self._disturbance.applied(update_placed(state, before.stage, self.subtask), self.subtask)
        if self.subtask.repeats:
            now = np.arange(len(draw.arriving)), state.steps.numpy() % ARRIVALS
            drawn = torch.from_numpy(draw.arriving[now]), torch.from_numpy(draw.arrivals)
            taken, placed = None, state.placed
            if self._arrivals is None:
                state = go_on(state, before, result.failed, *drawn, self.subtask)
            else:
                state = self._arrivals.go_on(state, *drawn, torch.from_numpy(draw.turns), self.subtask)
                taken = placed & ~state.placed
            if self.subtask.orders:
                state = renewed(state, torch.from_numpy(draw.due[now]), self.subtask, taken)
        return result if state is result.state else replace(result, state=state)

    def max_episode_steps(self, level: Tensor) -> Tensor:
        """Return the time limits (N,) in control steps at levels (N,)."""
        return max_episode_steps(level, self._config.task.max_episode_steps, self._limiting)

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs."""
        return {"source": self.source.state_dict(), "disturbance": self._disturbance.state_dict()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.source.load_state_dict(saved["source"])
        self._disturbance.load_state_dict(saved["disturbance"])
