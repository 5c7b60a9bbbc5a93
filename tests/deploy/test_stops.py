"""At every stop the arm comes to rest in its rated time, a line says why, the log is complete, the next run starts.

`python -m tests.deploy.stops` does this 50 times a kind.
"""

from __future__ import annotations

import pytest

from tests.deploy.stops import SAYS, kind_line


@pytest.mark.parametrize("kind", SAYS)
def test_every_stop_ends_the_run_as_it_should(kind: str) -> None:
    line = kind_line(kind, 1)
    assert (line["said_in_one_line"], line["log_complete"], line["restarted"]) == (1, 1, 1)
    # The set-point at which the robot tells of its stop is already sent.
    assert line["longest_brake_ms"] > 0.0 and line["most_over_rated_ms"] <= 4.0
    assert line["acceleration_share"] <= 1 + 1e-6
