"""Picking and placing with a hand that holds: stages end once an object is lifted, or lies where it belongs."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.tasks.hand.observation import hand_terms, of_target
from hrl_comfort.tasks.hand.rewards import hand_rewards
from hrl_comfort.tasks.rewards import Progress
from hrl_comfort.tasks.shift import WithinRound
from hrl_comfort.tasks.state import State
from hrl_comfort.tasks.subtask import Stage, Subtask

LIFT_M = 0.10
"""Height above where it lay from which an object counts as lifted."""
CARRIED_M = 0.02
"""Height above where it lay from which an object in the hand counts as carried."""
HELD_STEPS = 10
"""Control steps (0.2 s) for which it is held aloft until it is picked."""
FREE_STEPS = 3
"""Control steps without a touch of a pad after which a carried object has left the hand."""
REST_STEPS = 25
"""Control steps (0.5 s) for which it is let go until it is placed."""
REST_M_S = 0.02
"""Speed below which an object is at rest."""


def picked(state: State) -> Tensor:
    """Return (N,) bool: the target has been held aloft for HELD_STEPS."""
    return of_target(state.aloft_steps, state) >= HELD_STEPS


def to_place(state: State) -> Tensor:
    """Return the distance (N,) m of the target from where it belongs."""
    return vector_norm(state.target_place - state.target_object, dim=-1)


def lies(state: State) -> Tensor:
    """Return (N,) bool: the target has been let go for REST_STEPS, and rests."""
    calm = vector_norm(of_target(state.objects_vel, state), dim=-1) < REST_M_S
    return (of_target(state.free_steps, state) >= REST_STEPS) & calm


def placed(state: State) -> Tensor:
    """Return (N,) bool: the target lies within its tolerance of its place."""
    return lies(state) & (to_place(state) < state.place_tolerance)


def dropped(state: State) -> Tensor:
    """Return (N,) bool: the target lies elsewhere."""
    return lies(state) & ~(to_place(state) < state.place_tolerance)


def with_hand(task: Subtask) -> Subtask:
    """Return `task` for a cell with a gripper: an object is picked by a grasp, again if dropped, and lost on the floor.

    Terms of hand and object are the last ones of its observations and rewards.
    """
    stages = tuple(_with_hand(stage) for stage in task.stages)
    further = hand_rewards(tuple(stage.grasps for stage in stages))
    if "progress" in task.rewards:
        further["progress"] = Progress(stages, joint_space=False)
    if task.repeats:
        further = {name: WithinRound(term, len(stages)) for name, term in further.items()}
    seen = replace(task, stages=stages, rewards={**task.rewards, **further}, losses=("object_lost",))
    return seen.observing(**hand_terms())


def _with_hand(stage: Stage) -> Stage:
    if stage.grasps:
        return replace(stage, done=picked)
    return replace(stage, distance=to_place, done=placed, dropped=dropped) if stage.releases else stage
