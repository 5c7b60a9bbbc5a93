"""Reward terms of a grasp: differences of potentials, so that dwelling pays nothing."""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_comfort.tasks.hand.observation import of_target, target_lifted, tool_tilt
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import StateFunction, TransitionFunction

HIGHEST_M = 0.10
"""Height to which lifting pays; an object is picked there."""


def levelness(state: State) -> Tensor:
    """Return minus the angle (N,) rad of the line from one pad to the other with the horizontal."""
    return -tool_tilt(state)[..., 0].clamp(-1.0, 1.0).asin().abs()


def grasped(state: State) -> Tensor:
    """Return (N,) 1 where both pads touch the target, else 0."""
    return of_target(state.pads, state).all(dim=-1).to(state.tcp_pos.dtype)


def lifted(state: State) -> Tensor:
    """Return the height (N,) m of the target above where it lay, at most HIGHEST_M."""
    return target_lifted(state)[..., 0].clamp(0.0, HIGHEST_M)


def gain(potential: StateFunction, stages: Tensor, best: float) -> TransitionFunction:
    """Return how much `potential` grows over the step in the `stages` (S,) bool.

    A step that falls back to one of them pays as if the potential had been at its `best` before: to drop an object and
    pick it once more gains nothing.
    """

    def term(before: State, after: State) -> Tensor:
        fell = stages[after.stage] & (after.stage < before.stage)
        earlier = torch.where(fell, best, potential(before))
        return torch.where(stages[before.stage] | fell, potential(after) - earlier, 0.0)

    return term


def drop(before: State, after: State) -> Tensor:
    """Return 1 where a carried object leaves the hand away from its place."""
    return (after.drops - before.drops).to(after.tcp_pos.dtype)


def object_lost(before: State, after: State) -> Tensor:
    """Return 1 where an object begins to lie on the floor."""
    return (after.object_lost & ~before.object_lost).to(after.tcp_pos.dtype)


def hand_rewards(grasping: tuple[bool, ...]) -> dict[str, TransitionFunction]:
    """Return the terms by the names of their weights; `grasping` (S,) says in which stages an object is picked."""
    stages = torch.tensor([*grasping, False])
    return {
        "align": gain(levelness, stages, 0.0),
        "grasp": gain(grasped, stages, 1.0),
        "lift": gain(lifted, stages, HIGHEST_M),
        "drop": drop,
        "object_lost": object_lost,
    }
