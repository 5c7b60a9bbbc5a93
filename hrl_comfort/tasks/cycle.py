"""Cycle: pick, place and return, and its first half, by one network or by a chain of options."""

from __future__ import annotations

from hrl_comfort.tasks.pick import PICK_STAGE
from hrl_comfort.tasks.place import PLACE_STAGE
from hrl_comfort.tasks.return_home import RETURN_STAGE
from hrl_comfort.tasks.standard import standard_subtask

CYCLE = standard_subtask("cycle", (PICK_STAGE, PLACE_STAGE, RETURN_STAGE))
PICK_PLACE = standard_subtask("pick_place", (PICK_STAGE, PLACE_STAGE))
"""The paper's own division has it in one network."""
