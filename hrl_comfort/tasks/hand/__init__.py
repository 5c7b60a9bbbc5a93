"""Subtasks with a hand that holds: when an object is picked and placed, what is observed of it, and what it pays."""

from __future__ import annotations

from hrl_comfort.tasks.hand.grasp import CARRIED_M, FREE_STEPS, LIFT_M, with_hand

__all__ = ["CARRIED_M", "FREE_STEPS", "LIFT_M", "with_hand"]
