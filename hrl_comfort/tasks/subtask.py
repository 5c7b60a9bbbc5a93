"""Stages and subtasks as values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, reduce
from itertools import accumulate, pairwise, starmap
from operator import or_

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks.state import State

StateFunction = Callable[[State], Tensor]
"""Pure function of one instant, or of K of them."""
TransitionFunction = Callable[[State, State], Tensor]
"""Pure function of instants and those one control step later: (before, after) -> (N, K), or (N,) of one each."""


class ObjectAt(StrEnum):
    """Location of the object of the stage in force: none, where it arrived, on the tool, or where it belongs."""

    NOWHERE = "nowhere"
    ARRIVAL = "arrival"
    TOOL = "tool"
    PLACE = "place"


class Start(StrEnum):
    """Posture in which a subtask begins: joints at home, or the tool at the object or where the object belongs.

    With a gripper a hand at the object has lifted it, and one where it belongs has let it go.
    """

    HOME = "home"
    BEFORE_OBJECT = "before_object"
    """With a gripper: the open hand in front of the object."""
    AT_OBJECT = "at_object"
    AT_PLACE = "at_place"


@dataclass(frozen=True)
class Stage:
    """One goal of a subtask, which succeeds once its stages are done in order."""

    name: str
    goal: StateFunction
    """(N, 3) m, where the tool centre point should go."""
    distance: StateFunction
    """(N,) m, or rad summed over the joints if `joint_space`; progress is its decrease."""
    done: StateFunction
    """(N,) bool."""
    bonus: str
    """Reward weight paid for completion."""
    joint_space: bool = False
    """The goal is a posture; progress has the weight `home_progress` instead of `progress`."""
    object: ObjectAt = ObjectAt.NOWHERE
    """Location of the object during the stage."""
    object_after: ObjectAt = ObjectAt.NOWHERE
    """Location of the object once the stage is done."""
    next_start: Start | None = None
    """Start of a subtask that follows this stage."""
    at_point: bool = False
    """The goal is one of the episode's points (`State.points`)."""
    dropped: StateFunction | None = None
    """(N,) bool: the object lies elsewhere, and the stage before begins again, if there is one; None: it never does."""

    @property
    def grasps(self) -> bool:
        """Whether completion fixes the object to the tool."""
        return self.object == ObjectAt.ARRIVAL and self.object_after == ObjectAt.TOOL

    @property
    def releases(self) -> bool:
        """Whether completion leaves the object where it belongs."""
        return self.object == ObjectAt.TOOL and self.object_after == ObjectAt.PLACE


def tool_distance(goal: StateFunction) -> StateFunction:
    """Return the distance (N,) m from the tool centre point to a goal (N, 3)."""
    return lambda state: vector_norm(goal(state) - state.tcp_pos, dim=-1)


@dataclass(frozen=True)
class Subtask:
    """Observations, rewards, success and start of one task."""

    name: str
    stages: tuple[Stage, ...]
    observations: dict[str, StateFunction]
    rewards: dict[str, TransitionFunction]
    start: Start = Start.HOME
    terminate_on: str = "contact"
    """Contact with the human that is a failure: `contact` or `unsafe_contact`."""
    arrival_speed: float | None = None
    """A stage is done only while the joints are slower than this, rad/s, Euclidean norm; None: at any speed."""
    losses: tuple[str, ...] = ()
    """Further fields of State, (N,) bool, that are a failure."""
    repeats: bool = False
    """The stages begin again after the last one: `State.stage` counts on, and only the time limit ends an episode."""
    orders: bool = False
    """Objects are ordered: there is one of each kind, each is due by a time, and people fetch those that are placed."""

    @property
    def points(self) -> int:
        """Number of the episode's points that are goals."""
        return sum(stage.at_point for stage in self.stages)

    def observe(self, state: State) -> Tensor:
        """Return the observation (N, D), the concatenation of the named terms in their order."""
        return torch.cat([term(state) for term in self.observations.values()], dim=-1)

    def layout(self, state: State) -> dict[str, range]:
        """Return the columns of the observation that each of the named terms has."""
        ends = [0, *accumulate(term(state).shape[-1] for term in self.observations.values())]
        return dict(zip(self.observations, starmap(range, pairwise(ends)), strict=True))

    def observing(self, **terms: StateFunction) -> Subtask:
        """Return this subtask with further observations, the last ones."""
        return replace(self, observations={**self.observations, **terms})

    def next_stage(self, state: State) -> Tensor:
        """Return the stage in force after this instant: one further where it is done, one back where it is dropped."""
        stage, own = state.stage, self.in_round(state.stage)
        for index, item in enumerate(self.stages):
            stage = torch.where((own == index) & item.done(state), state.stage + 1, stage)
            if index and item.dropped is not None:
                stage = torch.where((own == index) & item.dropped(state), state.stage - 1, stage)
        if self.arrival_speed is None:
            return stage
        return torch.where(self._fast(state), torch.minimum(stage, state.stage), stage)

    def begins_done(self, state: State) -> Tensor:
        """Return (N,) bool: the first stage, in which an episode begins, is done in its first state."""
        done = self.stages[0].done(state)
        return done if self.arrival_speed is None else done & ~self._fast(state)

    def _fast(self, state: State) -> Tensor:
        """Return (N,) bool: the joints are not slower than `arrival_speed`."""
        fast: Tensor = vector_norm(state.joint_vel, dim=-1) >= self.arrival_speed
        return fast

    def in_round(self, stage: Tensor) -> Tensor:
        """Return the stages (N,) counted from the first of their round, if stages are repeated."""
        return stage % len(self.stages) if self.repeats else stage

    def success(self, state: State) -> Tensor:
        """Return where every stage is done, and none begins again."""
        return torch.zeros_like(state.stage, dtype=torch.bool) if self.repeats else state.stage >= len(self.stages)

    def failure(self, state: State) -> Tensor:
        """Return (N,) bool: a contact with the human, as `terminate_on` says, the workcell or itself, or a loss."""
        return reduce(or_, (getattr(state, name) for name in self.failures))

    def failed(self, before: State, after: State) -> Tensor:
        """Return (N,) bool: a control step ends in failure or, if stages are repeated, a failure begins in it."""
        if not self.repeats:
            return self.failure(after)
        return reduce(or_, (getattr(after, name) & ~getattr(before, name) for name in self.failures))

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the fields of `State` that are failures."""
        return self.terminate_on, "table_collision", "self_collision", *self.losses

    def location(self, stage: int) -> ObjectAt:
        """Return the location of the object in a stage, or after the last one."""
        stage = stage % len(self.stages) if self.repeats else stage
        return self.stages[stage].object if stage < len(self.stages) else self.stages[-1].object_after

    def object_at(self, where: ObjectAt, stage: Tensor) -> Tensor:
        """Return (N,) bool: the object of the stage (N,), or after the last one, is at `where`."""
        return self._locations[where].index_select(0, self.in_round(stage))

    @cached_property
    def _locations(self) -> dict[ObjectAt, Tensor]:
        found = [self.location(stage) for stage in range(len(self.stages) + 1)]
        return {where: torch.tensor([each == where for each in found]) for where in ObjectAt}

    def grasping(self, stage: Tensor) -> Tensor:
        """Return (N,) bool: an object is to be picked in the stage (N,)."""
        return self._grasps.index_select(0, self.in_round(stage))

    @cached_property
    def _grasps(self) -> Tensor:
        return torch.tensor([*(item.grasps for item in self.stages), False])

    def releasing(self, stage: Tensor) -> Tensor:
        """Return (N,) bool: an object is carried in the stage (N,)."""
        return self._releases.index_select(0, self.in_round(stage))

    @cached_property
    def _releases(self) -> Tensor:
        return torch.tensor([*(item.releases for item in self.stages), False])

    def released(self, stage: Tensor) -> Tensor:
        """Return the number of objects (N,) int64 that are where they belong by the stage (N,)."""
        done = torch.tensor([0, *(item.releases for item in self.stages)]).cumsum(0)
        own = self.in_round(stage)
        return done[own] + (stage - own) // len(self.stages) * done[-1]


def by_stage(stages: tuple[Stage, ...], quantity: Callable[[Stage], StateFunction]) -> StateFunction:
    """Return the quantity of the stage in force, of the last one once all are done."""
    if len(stages) == 1:
        return quantity(stages[0])

    def select(state: State) -> Tensor:
        value = quantity(stages[-1])(state)
        for index, stage in enumerate(stages[:-1]):
            other = quantity(stage)(state)
            chosen = (state.stage == index)[(..., *[None] * (value.ndim - state.stage.ndim))]
            value = torch.where(chosen, other, value)
        return value

    return select
