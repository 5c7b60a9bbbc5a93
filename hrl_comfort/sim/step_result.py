"""Result of one decision: rewards, last state and termination."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.comfort.adapt import TERM
from hrl_comfort.comfort.sources import SourceInput
from hrl_comfort.comfort.terms import human_distance
from hrl_comfort.compiled import contiguous
from hrl_comfort.config import CONTROL_STEP_S, RewardConfig
from hrl_comfort.sim.hand.sensors import Fields
from hrl_comfort.tasks import State, Subtask, kernels

Ints = NDArray[np.int64]
Truths = NDArray[np.bool_]


def tensors(fields: Fields) -> dict[str, Tensor]:
    """Return `fields` as tensors, without a copy."""
    return {name: torch.from_numpy(value) for name, value in fields.items()}


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
    before: State
    """In which it began."""
    moving: Fields
    """Fields (N, K, ...) of the K states after each control step that changed."""

    @cached_property
    def instants(self) -> State:
        """The K states after each control step."""
        return self.before.instants(**tensors(self.moving))

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

    def begun(self, name: str) -> Tensor:
        """Return (N,) bool: the truth `name` of the state began in the last control step of the decision."""
        after, before = self.moving[name], getattr(self.before, name).numpy()
        rows, last = np.arange(len(after)), self.decision_steps.numpy() - 1
        return torch.from_numpy(after[rows, last] & ~np.where(last > 0, after[rows, last - 1], before))

    @property
    def level(self) -> Tensor:
        """(N,) comfort level in force, NaN without one; `state.level` is the next decision's."""
        return self.before.level

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


class Rules:
    """Ends of the stages of a `subtask`, failures and pay, by the `weights` (T,) of its reward terms.

    Where they are built in they are compiled; a user's own are asked.
    """

    def __init__(self, subtask: Subtask, weights: Tensor) -> None:
        self.subtask, self.weights = subtask, weights
        self._goals = kernels.compiled_stages(subtask)
        self._terms, self._paid = kernels.compiled_terms(subtask)
        speed = subtask.arrival_speed
        self._slow_rad_s = np.inf if speed is None else speed
        paying = zip(self._terms == kernels.OTHER, subtask.rewards.values(), weights.tolist(), strict=True)
        self._others = [(index, term) for index, (other, term, weight) in enumerate(paying) if other and weight]

    def judged(self, before: State, moving: Fields, limits: Ints) -> tuple[Ints, Truths, Ints, Tensor]:
        """Return stages (N, K), failures (N, K), the last valid step (N,) and weighted rewards (N, K, T) of a decision.

        It began in the state `before`; the fields `moving` (N, K, ...) changed; `limits` (N,) are the time limits.
        """
        if self._goals is None:
            return self.asked(before, moving, limits)
        at = [getattr(before, name).numpy() for name in ("objects", "kind_places", "kinds", "target", "points")]
        stage, joints = before.stage.numpy(), (before.joint_pos.numpy(), moving["joint_pos"])
        ways = kernels.offsets(self._goals, stage, *contiguous(before.tcp_pos.numpy(), moving["tcp_pos"], *at))
        bent = torch.from_numpy(kernels.errors(*contiguous(*joints, before.joint_home.numpy())))
        harms = (self.subtask.terminate_on, "table_collision", "self_collision", "touching")
        stages, failing, last, gained = kernels.judge(
            self._goals, self.subtask.repeats, self._slow_rad_s, stage, length(torch.from_numpy(ways)),
            bent.sum(dim=-1).numpy(), bent.numpy(), length(torch.from_numpy(moving["joint_vel"])),
            tuple(contiguous(*(getattr(before, f"{name}_tolerance").numpy() for name in ("grasp", "place", "home")))),
            tuple(contiguous(*(getattr(before, name).numpy() for name in harms))),
            tuple(contiguous(*(moving[name] for name in harms))),
            *contiguous(moving["steps"], limits), self._terms, self._paid, self.weights.numpy(),
        )  # fmt: skip
        earned = torch.from_numpy(gained)
        if self._others:
            previous, after = transitions(before, moving, stages)
            void = _void(last, stages.shape[1])
            for index, term in self._others:
                earned[:, :, index] = (term(previous, after) * self.weights[index]).masked_fill(void, 0.0)
        return stages, failing, last, earned

    def asked(self, before: State, moving: Fields, limits: Ints) -> tuple[Ints, Truths, Ints, Tensor]:
        """Return what `judged` does, by the functions of the subtask alone."""
        task = self.subtask
        stages = task.next_stage(before.instants(**tensors(moving))).numpy()
        previous, after = transitions(before, moving, stages)
        failing = task.failed(previous, after).numpy()
        over = (stages != before.stage.numpy()[:, None]) | failing | (moving["steps"] >= limits[:, None])
        last = np.where(over.any(axis=1), over.argmax(axis=1), over.shape[1] - 1)
        paid = zip(task.rewards.values(), self.weights.tolist(), strict=True)
        nothing = torch.zeros(over.shape, dtype=torch.float64)
        gained = torch.stack([term(previous, after) if weight else nothing for term, weight in paid], dim=-1)
        return stages, failing, last, (gained * self.weights).masked_fill(_void(last, over.shape[1])[..., None], 0.0)


def length(vectors: Tensor) -> NDArray[np.float64]:
    """Return the Euclidean norms (...,) of vectors (..., n)."""
    return vector_norm(vectors, dim=-1).numpy()  # type: ignore[no-any-return]


def _void(last: Ints, count: int) -> Tensor:
    """Return (N, K) whether control steps come after the last valid ones (N,)."""
    return torch.from_numpy(np.arange(count) > last[:, None])


def transitions(before: State, moving: Fields, stages: Ints) -> tuple[State, State]:
    """Return the instants (N, K) before and after each control step of a decision; see `Rules.judged`."""
    begun = {name: getattr(before, name).numpy()[:, None] for name in moving}
    earlier = {name: np.concatenate([begun[name], value[:, :-1]], axis=1) for name, value in moving.items()}
    after = before.instants(**tensors(moving))
    return after.with_(**tensors(earlier)), after.with_(stage=torch.from_numpy(stages))


def compute_step(rules: Rules, max_episode_steps: Tensor, before: State, moving: Fields) -> StepResult:
    """Return the result of K control steps from the state `before` and the fields (N, K, ...) that changed.

    `max_episode_steps` (N,) are the time limits. A decision ends where its stage or its episode does: the stage in
    force is the same in all its valid steps.
    """
    limits, task = max_episode_steps.numpy(), rules.subtask
    stages, failing, last, earned = rules.judged(before, moving, limits)
    moving = {**moving, "stage": stages}
    rows, end = np.arange(len(last)), failing.shape[1] - 1
    kept, early = {name: value[:, end].copy() for name, value in moving.items()}, np.flatnonzero(last < end)
    if len(early):  # few, as a rule
        at = early, last[early]
        for name, value in moving.items():
            kept[name][early] = value[at]
    ended, failed = before.with_(**tensors(kept)), failing[rows, last]
    finished = task.success(ended).numpy()
    terminated = (failed | finished) & (not task.repeats)
    return StepResult(
        state=ended,
        reward_terms=earned.sum(dim=1),
        step_rewards=earned.sum(dim=-1),
        failed=torch.from_numpy(failed),
        # A collision in the step that completes the task is a failure.
        success=torch.from_numpy(finished & ~failed),
        terminated=torch.from_numpy(terminated),
        truncated=torch.from_numpy((kept["steps"] >= limits) & ~terminated),
        decision_steps=torch.from_numpy(last + 1),
        before=before,
        moving=moving,
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
