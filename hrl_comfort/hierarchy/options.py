"""Options as values (Sutton, Precup, Singh 1999), and tables of them with their arguments, from which a top chooses.

An option has an initiation set, a policy and a termination. Its arguments are passed down when it is chosen: the object
that becomes the target, and the comfort level that the policy sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError
from hrl_comfort.policies.load import Act
from hrl_comfort.policies.remembering import Remembering
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.state import ABSENT
from hrl_comfort.tasks.subtask import StateFunction

NONE = -1
"""In `OptionTable.object`: no object."""


class Termination(Enum):
    """Ways in which an option ends: as its own termination says, in a failure, cut short, or left for another."""

    SUCCESS = "success"
    FAILURE = "failure"
    PREEMPTED = "preempted"
    INTERRUPTED = "interrupted"


class Cause(Enum):
    """Reasons for which an option ends."""

    DONE = "done"
    """Its own termination, or the end of the task."""
    UNSAFE_CONTACT = "unsafe contact"
    CONTACT = "contact"
    HIT_TABLE = "hit table"
    SELF_COLLISION = "self-collision"
    OBJECT_LOST = "object lost"
    OTHER_FAILURE = "other failure"
    """Of a user's own task."""
    TIME_LIMIT = "time limit"
    """Its own, not that of the episode."""
    INTERRUPTED = "interrupted"
    """The top chose another option."""
    EPISODE_OVER = "episode over"


OF_FAILURES = {
    "unsafe_contact": Cause.UNSAFE_CONTACT,
    "contact": Cause.CONTACT,
    "table_collision": Cause.HIT_TABLE,
    "self_collision": Cause.SELF_COLLISION,
    "object_lost": Cause.OBJECT_LOST,
}
"""Causes by the names of `Subtask.failures`."""


@dataclass(frozen=True)
class Begun:
    """Beginnings of the options in force, (N,) int64 each."""

    stage: Tensor
    """Stage of the task then."""
    lasted: Tensor
    """Control steps since."""


Terminates = Callable[[State, Begun], Tensor]
"""Termination: (N,) bool, the option ends now; or a float in [0, 1], the probability that it does."""


@dataclass(frozen=True)
class Stages:
    """Stages [first, last) of a longer task, in each of its rounds of `round_stages`; 0: it has one round."""

    first: int
    last: int
    round_stages: int = 0

    def start(self, stage: Tensor) -> Tensor:
        """Return the first of them (N,) in the round of the stages (N,) in force."""
        return (stage - stage % self.round_stages if self.round_stages else torch.zeros_like(stage)) + self.first

    def in_force(self, state: State) -> Tensor:
        """Return (N,) bool: one of them is in force."""
        own = state.stage - self.start(state.stage)
        return (own >= 0) & (own < self.last - self.first)

    def done(self, state: State, begun: Begun) -> Tensor:
        """Return (N,) bool: those of the round in which the option began are done."""
        return state.stage >= self.start(begun.stage) + self.last - self.first


@dataclass(frozen=True)
class Option:
    """An option; its policy may be frozen or may go on learning."""

    name: str
    policy: Act
    initiation: StateFunction
    """(N,) bool, it can start."""
    termination: Terminates
    stages: Stages | None = None
    """Stages of the task that it does; the policy sees them counted from the first. None: it does not advance the task,
    and the policy sees stage 0."""
    time_limit: int | None = None
    """Control steps after which it is preempted; more where `comfort` lets an episode last longer. None: never."""
    interruption_steps: int | None = None
    """Control steps after which the top decides anew, and may choose it again: then it goes on. None: it is never
    interrupted."""
    max_runs: int | None = None
    """Times in a row that it can be chosen; None: any number."""
    recovers: bool = False
    """It alone can start after an option that was cut short, until its termination holds."""

    def fallen_back(self, state: State, begun: Begun) -> Tensor:
        """Return (N,) bool: the task is at a stage before those that the option began with."""
        return state.stage < (begun.stage if self.stages is None else self.stages.start(begun.stage))


def skill(
    subtask: Subtask,
    policy: Act,
    time_limit: int | None,
    first: int = 0,
    round_stages: int = 0,
    interruption_steps: int | None = None,
) -> Option:
    """Return the option that does a subtask, from stage `first` on of a longer task."""
    stages = Stages(first, first + len(subtask.stages), round_stages)
    return Option(subtask.name, policy, stages.in_force, stages.done, stages, time_limit, interruption_steps)


def lasts(steps: int) -> Terminates:
    """Return the termination after `steps` control steps."""
    return lambda state, begun: begun.lasted >= steps


@dataclass(frozen=True)
class Choice:
    """An option and its arguments."""

    option: Option
    object: int | None = None
    """Index of the object that becomes the target; one that is placed cannot be chosen."""
    level: int | None = None
    """Comfort level that the policy sees instead of the one in force."""

    @property
    def name(self) -> str:
        """Name of the option, with its arguments: `pick_1_as_6`."""
        suffix = "" if self.object is None else f"_{self.object + 1}"
        return self.option.name + suffix + ("" if self.level is None else f"_as_{self.level}")


class OptionTable:
    """The K choices of a top, and their arguments as tensors (K,).

    Args:
      choices: in the order of their indices; a bare option has no arguments.

    Raises:
      ValueError: two choices have one name.
    """

    def __init__(self, choices: Sequence[Choice | Option]) -> None:
        self._choices = tuple(each if isinstance(each, Choice) else Choice(each) for each in choices)
        self.names = [each.name for each in self._choices]
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"choices must have names of their own, not {', '.join(self.names)}")
        self.options = tuple(dict.fromkeys(each.option for each in self._choices))
        self.option = torch.tensor([self.options.index(each.option) for each in self._choices])
        """int64, index into `options`."""
        self.object = torch.tensor([NONE if each.object is None else each.object for each in self._choices])
        """int64, index of the object; NONE without one."""
        levels = [torch.nan if each.level is None else each.level for each in self._choices]
        self.level = torch.tensor(levels, dtype=torch.float64)
        """Level that the policy sees; NaN for the one in force."""
        self.advances = torch.tensor([each.option.stages is not None for each in self._choices])
        """bool, it advances the task."""

    def __len__(self) -> int:
        return len(self._choices)

    def __getitem__(self, index: int) -> Choice:
        return self._choices[index]

    def __iter__(self) -> Iterator[Choice]:
        return iter(self._choices)

    @property
    def remembering(self) -> dict[str, Remembering]:
        """The policies that remember, by the names of their options."""
        return {each.name: each.policy for each in self.options if isinstance(each.policy, Remembering)}

    def memories(self) -> list[dict[str, Tensor]]:
        """Return what an exact continuation needs of `remembering`."""
        return [policy.state_dict() for policy in self.remembering.values()]

    def load_memories(self, saved: Sequence[dict[str, Tensor]]) -> None:
        """Continue from `memories`; checkpoints of earlier versions have none."""
        for policy, memory in zip(self.remembering.values(), saved, strict=False):
            policy.load_state_dict(memory)

    def position(self, name: str) -> int:
        """Return the index of the choice `name`; raise ConfigError if there is none."""
        if name not in self.names:
            raise ConfigError(f"there is no option {name!r}; choose one of {', '.join(self.names)}")
        return self.names.index(name)

    def can_start(self, state: State) -> Tensor:
        """Return (N, K) bool: the state is in the initiation set, and the object, if any, can be picked."""
        able = torch.stack([each.initiation(state) for each in self.options], dim=-1)[:, self.option]
        return able & ((self.object == NONE) | can_be_picked(state)[:, self.object.clamp(min=0)])

    def act(self, chosen: Tensor, state: State, acting: Tensor) -> Tensor:
        """Return the actions (N, A) of the choices in force, `chosen` (N,) int64; rows not `acting` stand still.

        Choices of one option act in one batch.
        """
        given, option = self.level[chosen], self.option[chosen]
        seen = state.with_(level=torch.where(given.isnan(), state.level, given))
        action = state.joint_pos.new_zeros(0)
        for index, each in enumerate(self.options):
            rows = torch.nonzero((option == index) & acting).squeeze(-1)
            if len(rows):
                mine = seen.rows(rows)
                own = mine.stage - (mine.stage if each.stages is None else each.stages.start(mine.stage))
                wanted = each.policy(mine.with_(stage=own.clamp(min=0))).to(action.dtype)
                if not len(action):
                    action = wanted.new_zeros(len(option), wanted.shape[-1])
                action[rows] = wanted
        return action


def can_be_picked(state: State) -> Tensor:
    """Return (N, B) bool: the object is not placed, and the hand, if there is one, holds no other."""
    held = in_hand(state).long()
    return ~state.placed & (held.sum(dim=1, keepdim=True) == held)


def in_hand(state: State) -> Tensor:
    """Return (N, B) bool: the hand holds the object, which is not placed; none without a hand."""
    if state.pads.shape == ABSENT.shape:
        return torch.zeros_like(state.placed)
    return (state.pads.all(dim=-1) | state.carried) & ~state.placed


def grid(options: Sequence[Option], objects: dict[str, int], levels: Sequence[int]) -> list[Choice]:
    """Return each option at the level in force and at each of `levels`, and at each of its `objects`, by name."""
    return [
        Choice(option, number, level)
        for level, option in product((None, *levels), options)
        for number in (range(objects[option.name]) if option.name in objects else (None,))
    ]


def chain(skills: Sequence[tuple[Subtask, Act]], time_limit: int | None, further: Sequence[Option] = ()) -> OptionTable:
    """Return the table of an option a skill, each with the stages after those of the one before, and of `further`."""
    options: list[Option] = []
    for subtask, policy in skills:
        stages = options[-1].stages if options else None
        options.append(skill(subtask, policy, time_limit, stages.last if stages else 0))
    return OptionTable([*options, *further])
