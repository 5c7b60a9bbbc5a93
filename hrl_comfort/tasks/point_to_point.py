"""Point to point: bring the tool to a first point and then to a second."""

from __future__ import annotations

from hrl_comfort.tasks import observations, rewards
from hrl_comfort.tasks.reach import reach_point
from hrl_comfort.tasks.subtask import Subtask

STAGES = (reach_point(0), reach_point(1))

POINT_TO_POINT = Subtask(
    name="point_to_point",
    stages=STAGES,
    observations=observations.standard(STAGES),
    rewards=rewards.standard(STAGES),
    start="home",
)
