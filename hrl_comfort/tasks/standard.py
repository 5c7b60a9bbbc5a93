"""Subtasks with the standard observations and rewards of their stages."""

from __future__ import annotations

from hrl_comfort.tasks import rewards
from hrl_comfort.tasks.observations.standard import standard
from hrl_comfort.tasks.subtask import Stage, Start, Subtask


def standard_subtask(name: str, stages: tuple[Stage, ...], start: Start = Start.HOME) -> Subtask:
    """Return the subtask of these stages."""
    return Subtask(name, stages, standard(stages), rewards.standard(stages), start)
