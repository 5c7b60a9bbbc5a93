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

MINUTE_S, HOUR_S = 60.0, 3600.0


@dataclass(frozen=True)
class Course(Trajectory):
    """Further fields of `State` over the T + 1 instants of an episode, and what it came to."""

    level: NDArray[np.float64]
    stage: NDArray[np.int64]
    touching: NDArray[np.bool_]
    unsafe_contact: NDArray[np.bool_]
    table_collision: NDArray[np.bool_]
    self_collision: NDArray[np.bool_]
    objects_placed: int
    protective_stops: int

    def touched(self) -> dict[str, Any]:
        """Return what the arm touched in the episode, by the fields of `Episode`."""
        table, own = self.table_collision.any(), self.self_collision.any()
        return {
            "contact": bool(self.touching.any()),
            "unsafe_contact": bool(self.unsafe_contact.any()),
            "other_collision": "table" if table else "self" if own else "none",
        }


def discomfort_per_min(course: Course, config: EvaluateConfig) -> float | None:
    """Return the integral over time of `comfort.terms.discomfort`, s a minute; None without a level or a person."""
    level = torch.from_numpy(course.level[1:])
    if not course.human_here or bool(level.isnan().any()):
        return None
    increment = np.degrees(np.abs(np.diff(course.joint_target, axis=0)).max(axis=-1))
    told = torch.from_numpy(course.arm_distance[1:]), torch.from_numpy(increment), level
    return float(discomfort(*told, config.task.max_step_deg, config.comfort).mean()) * MINUTE_S


def shift_rates(course: Course, shielded: bool) -> dict[str, float | None]:
    """Return the rates of a shift by their column."""
    spent_s = (len(course.stage) - 1) * CONTROL_STEP_S
    collision = course.table_collision | course.self_collision
    return {
        "objects_lost": float((np.diff(course.stage) < 0).sum()),
        "objects_per_min": course.objects_placed * MINUTE_S / spent_s,
        "contacts_per_h": begun(course.touching) * HOUR_S / spent_s,
        "unsafe_contacts_per_h": begun(course.unsafe_contact) * HOUR_S / spent_s,
        "other_collisions_per_h": begun(collision) * HOUR_S / spent_s,
        "protective_stops_per_min": course.protective_stops * MINUTE_S / spent_s if shielded else None,
    }


def begun(flags: NDArray[np.bool_]) -> int:
    """Return how often flags (T + 1,) become true."""
    return int((flags[1:] & ~flags[:-1]).sum())
