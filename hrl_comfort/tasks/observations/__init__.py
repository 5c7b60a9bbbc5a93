"""Layouts of the observation: what a policy observes of the state."""

from __future__ import annotations

from hrl_comfort.config.checks import implemented
from hrl_comfort.config.task import OBSERVATIONS
from hrl_comfort.tasks.observations.sight import sight
from hrl_comfort.tasks.observations.standard import paper, set_points, standard

LAYOUTS = implemented(
    OBSERVATIONS,
    {"default": standard, "set_points": set_points, "sight": sight, "paper": paper},
)
"""Layout by its name: stages -> terms."""

__all__ = ["LAYOUTS"]
