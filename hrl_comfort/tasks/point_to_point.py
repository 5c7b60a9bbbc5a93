"""Point to point: bring the tool to a first point and then to a second."""

from __future__ import annotations

from hrl_comfort.tasks.reach import reach_point
from hrl_comfort.tasks.standard import standard_subtask

POINT_TO_POINT = standard_subtask("point_to_point", (reach_point(0), reach_point(1)))
