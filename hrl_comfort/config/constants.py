"""Constants that more than one part of the program needs."""

from __future__ import annotations

CONTROL_STEP_S = 0.02
"""Length of a control step: joints move by at most 2 degrees in it (the paper's unit)."""
FAR_AWAY_M = 50.0
"""Where everything stands, along x, that is not in the cell."""

FIRST_SEED = 1_000_000
"""Episode seeds from here on are those of the evaluation set; training has those below `TERMINAL_STATES_SEED`."""
EVALUATION_EPISODES = 1000
"""Entries of the evaluation set."""
TERMINAL_STATES_SEED = 900_000
"""Episode seeds from here on, below `FIRST_SEED`, are those of recorded endings."""
