"""Pick and place in one network: the paper's own division."""

from __future__ import annotations

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.pick import TAKE
from hrl_comfort.tasks.place import LEAVE
from hrl_comfort.tasks.subtask import Subtask

STAGES = (TAKE, LEAVE)

PICK_PLACE = Subtask(
    name="pick_place",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="home",
)
