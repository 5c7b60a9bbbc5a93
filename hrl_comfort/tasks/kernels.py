"""Stages and reward terms that are built in, compiled; see `hrl_comfort.compiled`.

`Stage` and `rewards` define them. Lengths and sums over joints are torch's, which rounds them in its own way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.tasks import rewards
from hrl_comfort.tasks.pick import PICK_STAGE
from hrl_comfort.tasks.place import PLACE_STAGE
from hrl_comfort.tasks.reach import reach_point
from hrl_comfort.tasks.return_home import RETURN_STAGE
from hrl_comfort.tasks.shift import WithinRound
from hrl_comfort.tasks.subtask import Stage, Subtask, TransitionFunction

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Truths = NDArray[np.bool_]

STAGES: tuple[Stage, ...] = (PICK_STAGE, PLACE_STAGE, RETURN_STAGE, reach_point(0), reach_point(1))
OBJECT, PLACE, HOME, POINT = range(4)
"""Indices of STAGES; those from POINT on go to the points."""
OTHER, PROGRESS, COMPLETION, ARRIVAL_SPEED, CONTACT, COLLISION, STEP, OVERTIME = range(-1, 7)
"""Kinds of terms: OTHER is none of `rewards`, or not compiled."""
_TERMS: dict[TransitionFunction, int] = {
    rewards.arrival_speed: ARRIVAL_SPEED,
    rewards.contact: CONTACT,
    rewards.other_collision: COLLISION,
    rewards.step: STEP,
    rewards.overtime: OVERTIME,
}
LATE_STEPS = rewards.LATE_STEPS


def compiled_stages(task: Subtask) -> Ints | None:
    """Return the indices (S,) of a subtask's stages in STAGES; None if one is not there, or a loss is a failure."""
    if type(task) is not Subtask or task.losses or any(stage not in STAGES for stage in task.stages):
        return None
    return np.array([STAGES.index(stage) for stage in task.stages])


def compiled_terms(task: Subtask) -> tuple[Ints, Truths]:
    """Return the kinds (T,) of a subtask's reward terms, and in which of its stages (T, S) they pay."""
    kinds, paid = [], np.ones((len(task.rewards), len(task.stages)), dtype=bool)
    for index, term in enumerate(task.rewards.values()):
        if type(term) is WithinRound and task.repeats and term.stages == len(task.stages):
            term = term.term
        if type(term) is rewards.Progress and term.stages == task.stages:
            kinds.append(PROGRESS)
            paid[index] = [stage.joint_space is term.joint_space for stage in task.stages]
        elif type(term) is rewards.Completion:
            kinds.append(COMPLETION)
            paid[index] = [stage in term.paid for stage in range(len(task.stages))]
        else:
            kinds.append(next((kind for each, kind in _TERMS.items() if each is term), OTHER))
    return np.array(kinds, dtype=np.int64), paid


@kernel
def offsets(
    goals: Ints, stage: Ints, tcp_before: Array, tcp: Array, objects: Array, kind_places: Array, kinds: Ints,
    target: Ints, points: Array,
) -> Array:  # fmt: skip
    """Return the ways (N, 1 + K, 3) m from the tool to the goal of the stage in force; 0 where that is a posture.

    `goals` (S,) are indices of STAGES, the other arguments fields of State before a decision and `tcp` (N, K, 3) in it.
    """
    (n, count), ways = tcp.shape[:2], np.zeros((tcp.shape[0], 1 + tcp.shape[1], 3))
    for m in range(n):
        goal = goals[stage[m] % len(goals)]
        if goal == HOME:
            continue
        for axis in range(3):
            if goal == OBJECT:
                at = objects[m, target[m], axis]
            elif goal == PLACE:
                at = kind_places[m, kinds[m, target[m]], axis]
            else:
                at = points[m, goal - POINT, axis]
            ways[m, 0, axis] = at - tcp_before[m, axis]
            for k in range(count):
                ways[m, 1 + k, axis] = at - tcp[m, k, axis]
    return ways


@kernel
def errors(before: Array, angles: Array, home: Array) -> Array:
    """Return how far (N, 1 + K, J) rad joints are from home (N, J), `before` (N, J) and in a decision (N, K, J)."""
    n, count, joints = angles.shape
    found = np.empty((n, 1 + count, joints))
    for m in range(n):
        for j in range(joints):
            found[m, 0, j] = abs(before[m, j] - home[m, j])
            for k in range(count):
                found[m, 1 + k, j] = abs(angles[m, k, j] - home[m, j])
    return found


@kernel
def judge(
    goals: Ints, repeats: bool, slow_rad_s: float, stage: Ints, distance: Array, bent: Array, error: Array,
    speed: Array, tolerances: tuple[Array, Array, Array], begun: tuple[Truths, Truths, Truths, Truths],
    harms: tuple[Truths, Truths, Truths, Truths], steps: Ints, limits: Ints, terms: Ints, paid: Truths, weights: Array,
) -> tuple[Ints, Truths, Ints, Array]:  # fmt: skip
    """Return stages (N, K), failures (N, K), the last valid step (N,) and weighted rewards (N, K, T) of a decision.

    `distance` and `bent` (N, 1 + K) are those of tool and joints from the goal, `error` (N, 1 + K, J) those of each
    joint, `speed` (N, K) rad/s that of all; `tolerances` (N,) those of grasp, place and home; `harms` (N, K) a failing
    contact, collisions with the cell and the arm itself, and touches, `begun` (N,) the same before. A row fails in the
    first three. Rewards after the last step, and those of terms that are OTHER, are 0.
    """
    (n, count), last_stage = steps.shape, len(goals)
    after, failing = np.empty((n, count), np.int64), np.zeros((n, count), np.bool_)
    last, gained = np.empty(n, np.int64), np.zeros((n, count, len(terms)))
    for m in range(n):
        own = stage[m] % last_stage if repeats else stage[m]
        staged = own < last_stage
        goal = goals[own] if staged else HOME
        tolerance = tolerances[1 if goal == PLACE else 2 if goal == HOME else 0][m]
        last[m] = -1
        for k in range(count):
            if goal == HOME:
                done = staged
                for j in range(error.shape[2]):
                    done &= error[m, 1 + k, j] < tolerance
            else:
                done = distance[m, 1 + k] < tolerance
            done &= speed[m, k] < slow_rad_s
            after[m, k] = stage[m] + done
            for harm in range(3):
                held = harms[harm][m, k - 1] if k else begun[harm][m]
                failing[m, k] |= harms[harm][m, k] and not (repeats and held)
            if last[m] >= 0:
                continue
            if done or failing[m, k] or steps[m, k] >= limits[m] or k == count - 1:
                last[m] = k
            for index in range(len(terms)):
                kind, gain = terms[index], 0.0
                if kind == OTHER or weights[index] == 0.0:
                    continue
                if kind == PROGRESS:
                    if staged and paid[index, own]:
                        here = bent if goal == HOME else distance
                        gain = here[m, k] - here[m, 1 + k]
                elif kind == COMPLETION:
                    gain = 1.0 if done and paid[index, own] else 0.0
                elif kind == ARRIVAL_SPEED:
                    gain = speed[m, k] if done else 0.0
                elif kind == CONTACT:
                    touched = harms[3][m, k - 1] if k else begun[3][m]
                    gain = 1.0 if harms[3][m, k] and not touched else 0.0
                elif kind == COLLISION:
                    gain = 1.0 if harms[1][m, k] or harms[2][m, k] else 0.0
                elif kind == STEP:
                    gain = 1.0
                elif kind == OVERTIME:
                    gain = 1.0 if steps[m, k] > LATE_STEPS else 0.0
                gained[m, k, index] = gain * weights[index]
    return after, failing, last, gained
