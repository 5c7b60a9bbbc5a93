"""Pick and place in one network: the paper's own division."""

from __future__ import annotations

from hrl_comfort.tasks.pick import PICK_STAGE
from hrl_comfort.tasks.place import PLACE_STAGE
from hrl_comfort.tasks.standard import standard_subtask

PICK_PLACE = standard_subtask("pick_place", (PICK_STAGE, PLACE_STAGE))
