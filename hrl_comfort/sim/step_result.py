"""Result of one decision: rewards, last state and termination."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.comfort.adapt import TERM
from hrl_comfort.comfort.sources import SourceInput
from hrl_comfort.comfort.terms import human_distance
from hrl_comfort.config import CONTROL_STEP_S, RewardConfig
from hrl_comfort.tasks import State, Subtask


@dataclass(frozen=True)
class StepResult:
    """Result of one decision in N cells; of its K control steps, those after its stage or episode ended are void."""

    state: State
    """The last valid instant of each row."""
    reward_terms: Tensor
    """(N, T) weighted, summed over the decision's control steps."""
    step_rewards: Tensor
    """(N, K) sum of the weighted terms of a control step; 0 after the decision ended."""
    failed: Tensor
    """(N,) bool, it ended in failure, which ends the episode unless the subtask repeats its stages."""
    success: Tensor
    terminated: Tensor
    truncated: Tensor
    """(N,) bool."""
    decision_steps: Tensor
    """(N,) int64, control steps this decision took."""
    instants: State
    """The K states after each control step."""

    @property
    def reward(self) -> Tensor:
        """(N,) sum of the terms."""
        return self.reward_terms.sum(dim=-1)

    @property
    def done(self) -> Tensor:
        """(N,) bool."""
        return self.terminated | self.truncated

    @property
    def valid(self) -> Tensor:
        """(N, K) bool, the control steps this decision took."""
        return torch.arange(self.step_rewards.shape[1]) < self.decision_steps[:, None]

    @property
    def level(self) -> Tensor:
        """(N,) comfort level in force, NaN without one; `state.level` is the next decision's."""
        return self.instants.level[:, 0]

    @property
    def human_distance(self) -> Tensor:
        """(N, K) m, horizontal, tool to the axis of the nearest human."""
        return human_distance(self.instants.tcp_pos, self.instants.humans_pos)

    @property
    def steps(self) -> list[State]:
        """The K instants, for recording."""
        return [self.instants.at(k) for k in range(self.step_rewards.shape[1])]


def reward_weights(reward: RewardConfig, comfort_scale: float) -> dict[str, float]:
    """Return the weight of every reward term by its name, with the factors k1, k2 and k3 of Eq. 1."""
    weights = {**vars(reward), TERM: comfort_scale}
    for name, k in (("pick", reward.k1), ("place", reward.k2), ("home", reward.k3)):
        weights[name] *= k
    return weights


def compute_step(
    subtask: Subtask, weights: Tensor, max_episode_steps: Tensor, before: State, moving: dict[str, Tensor]
) -> StepResult:
    """Return the result of K control steps from the state `before` and the fields (N, K, ...) that changed.

    `weights` (T,) are those of the subtask's reward terms, `max_episode_steps` (N,) the time limits. A decision
    ends where its stage or its episode does: the stage in force is the same in all its valid steps.
    """
    after = before.instants(**moving)
    begun = {name: getattr(before, name).numpy()[:, None] for name in moving}
    earlier = {name: np.concatenate([begun[name], value.numpy()[:, :-1]], axis=1) for name, value in moving.items()}
    stage = subtask.next_stage(after)
    previous = after.with_(**{name: torch.from_numpy(value) for name, value in earlier.items()})
    after = after.with_(stage=stage)

    failing, limits = subtask.failed(previous, after).numpy(), max_episode_steps.numpy()
    over = (stage.numpy() > before.stage.numpy()[:, None]) | failing | (moving["steps"].numpy() >= limits[:, None])
    rows, count = np.arange(len(over)), over.shape[1]
    last = np.where(over.any(axis=1), over.argmax(axis=1), count - 1)
    void = torch.from_numpy(np.arange(count) > last[:, None])
    paid, nothing = zip(subtask.rewards.values(), weights.tolist(), strict=True), torch.zeros(void.shape).double()
    gained = torch.stack([term(previous, after) if weight else nothing for term, weight in paid], dim=-1) * weights
    earned = gained.masked_fill(void[:, :, None], 0.0)

    kept = {name: value.numpy()[rows, last] for name, value in {**moving, "stage": stage}.items()}
    ended = before.with_(**{name: torch.from_numpy(value) for name, value in kept.items()})
    failed, finished = torch.from_numpy(failing[rows, last]), subtask.success(ended)
    terminated = (failed | finished) & (not subtask.repeats)
    return StepResult(
        state=ended,
        reward_terms=earned.sum(dim=1),
        step_rewards=earned.sum(dim=-1),
        failed=failed,
        # A collision in the step that completes the task is a failure.
        success=finished & ~failed,
        terminated=terminated,
        truncated=(ended.steps >= max_episode_steps) & ~terminated,
        decision_steps=torch.from_numpy(last + 1),
        instants=after,
    )


def source_input(before: State, result: StepResult) -> SourceInput:
    """Return what a source of levels sees of a decision that began in the state `before`."""
    taken = result.decision_steps
    travelled = vector_norm(result.state.tcp_pos - before.tcp_pos, dim=-1)
    return SourceInput(
        time_s=result.state.steps.numpy() * CONTROL_STEP_S,
        passed_s=taken.numpy() * CONTROL_STEP_S,
        distance_m=human_distance(result.state.tcp_pos, result.state.humans_pos).numpy(),
        speed_m_s=(travelled / (taken * CONTROL_STEP_S)).numpy(),
        arm_distance_m=result.state.arm_distance.numpy(),
    )
