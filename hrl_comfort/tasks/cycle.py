"""Cycle: pick, place and return. Trained, it is one network for all; chained, the meta-controller's task."""

from __future__ import annotations

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.pick import TAKE
from hrl_comfort.tasks.place import LEAVE
from hrl_comfort.tasks.return_home import GO_HOME
from hrl_comfort.tasks.subtask import Subtask

STAGES = (TAKE, LEAVE, GO_HOME)

CYCLE = Subtask(
    name="cycle",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="home",
)
