"""Work, discomfort and contacts by the time (see docs/metrics.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.terms import discomfort
from hrl_comfort.comfort.trajectory import Trajectory
from hrl_comfort.config import CONTROL_STEP_S, EvaluateConfig
from hrl_comfort.sim.hand.sensors import Losses
from hrl_comfort.sim.step_result import StepResult

MINUTE_S, HOUR_S = 60.0, 3600.0
DISCOMFORTS = (
    "discomfort_per_min", "avoidable_discomfort_per_min", "idle_discomfort_per_min", "excess_closeness_mean_m",
)  # fmt: skip


@dataclass(frozen=True)
class Course(Trajectory):
    """Further fields of `State` over the T + 1 instants of an episode, and what it came to."""

    home_distance: NDArray[np.float64]
    """(T + 1,) m, smallest distance between any link and any body part if the arm were at home."""
    level: NDArray[np.float64]
    stage: NDArray[np.int64]
    touching: NDArray[np.bool_]
    unsafe_contact: NDArray[np.bool_]
    table_collision: NDArray[np.bool_]
    self_collision: NDArray[np.bool_]
    objects_placed: int
    protective_stops: int
    orders_missed: int | None
    """None in a task without orders."""
    objects_lost: int | None
    """None without a gripper: then it is told by the stages, which go back."""

    def touched(self) -> dict[str, Any]:
        """Return what the arm touched in the episode, by the fields of `Episode`."""
        table, own = self.table_collision.any(), self.self_collision.any()
        return {
            "contact": bool(self.touching.any()),
            "unsafe_contact": bool(self.unsafe_contact.any()),
            "other_collision": "table" if table else "self" if own else "none",
        }


def discomforts(course: Course, config: EvaluateConfig) -> dict[str, float | None]:
    """Return discomfort by its column; None without a person, or without a level where one is needed.

    Integrals over time of `comfort.terms.discomfort`, s a minute: of the arm, of one that rests at home beside the same
    people, and what the arm could avoid by resting: where it is nearer than home, and its speed.
    """
    level, found = torch.from_numpy(course.level[1:]), dict.fromkeys(DISCOMFORTS)
    if not course.human_here:
        return found
    home, arm = (torch.from_numpy(each[1:]) for each in (course.home_distance, course.arm_distance))
    found["excess_closeness_mean_m"] = float((home - arm).mean())
    if bool(level.isnan().any()):
        return found
    increment = torch.from_numpy(np.degrees(np.abs(np.diff(course.joint_target, axis=0)).max(axis=-1)))
    own, near, idle = (
        discomfort(*told, level, config.task.max_step_deg, config.comfort)
        for told in ((arm, increment), (arm, torch.zeros_like(increment)), (home, torch.zeros_like(increment)))
    )
    avoidable = own - torch.minimum(near, idle)
    rates = dict(zip(DISCOMFORTS, (own, avoidable, idle), strict=False))
    return found | {name: float(each.mean()) * MINUTE_S for name, each in rates.items()}


def shift_rates(course: Course, shielded: bool) -> dict[str, float | None]:
    """Return the rates of a shift by their column."""
    spent_s = (len(course.stage) - 1) * CONTROL_STEP_S
    collision = course.table_collision | course.self_collision
    lost = course.objects_lost
    return {
        "objects_lost": float((np.diff(course.stage) < 0).sum() if lost is None else lost),
        "objects_per_min": course.objects_placed * MINUTE_S / spent_s,
        "contacts_per_h": begun(course.touching) * HOUR_S / spent_s,
        "unsafe_contacts_per_h": begun(course.unsafe_contact) * HOUR_S / spent_s,
        "other_collisions_per_h": begun(collision) * HOUR_S / spent_s,
        "protective_stops_per_min": course.protective_stops * MINUTE_S / spent_s if shielded else None,
        "orders_missed_per_min": None if course.orders_missed is None else course.orders_missed * MINUTE_S / spent_s,
    }


def newly_lost(losses: Losses, result: StepResult) -> NDArray[np.int64]:
    """Return how many objects (N,) of a cell with a gripper were lost in a decision, whatever was lost before it."""
    rows, last = np.arange(len(result.decision_steps)), result.decision_steps.numpy() - 1
    before, kinds = result.before, result.before.kinds.numpy()
    now = losses(result.moving["objects"][rows, last], kinds, result.moving["carried"][rows, last])
    return np.asarray((now & ~losses(before.objects.numpy(), kinds, before.carried.numpy())).sum(axis=1))


def begun(flags: NDArray[np.bool_]) -> int:
    """Return how often flags (T + 1,) become true."""
    return int((flags[1:] & ~flags[:-1]).sum())
