"""Constants of more than one package."""

from __future__ import annotations

CONTROL_STEP_S = 0.02
"""Length of a control step, s; joints move by at most 2 degrees in it, as in the paper."""
MAX_ENVS = 65536
"""Largest number of cells of a batch."""
SCRIPTED_POLICIES = ("expert", "direct", "potential_field", "predictive_sampling", "random")
"""Policies that no training made, by the name that `policy=` takes."""
PREGRASP = "pregrasp"
"""Value of `task.start`: the hand in front of the object."""
STARTS = ("ik", PREGRASP)
"""Values of `task.start` that are no file."""
POLICIES = (
    "a run folder, a checkpoint, a policy.pt, package.module:callable, sb3:FILE.zip, onnx:FILE, "
    f"{' or '.join(SCRIPTED_POLICIES)}"
)
"""The forms of `policy=`."""
HIERARCHY = "hierarchy.yaml"
"""Configuration of a hierarchy, in its folder."""
FAR_AWAY_M = 50.0
"""x coordinate of everything that is not in the cell, m."""

VALIDATION_SEED = 850_000
"""First episode seed of the validation split; training uses the seeds below it."""
TERMINAL_STATES_SEED = 900_000
"""First episode seed of recorded terminal states."""
TRAIN_SEED, TEST_SEED = 920_000, 950_000
"""First episode seeds of the splits `train` and `test`."""
FIRST_SEED = 1_000_000
"""First episode seed of the evaluation set."""
EVALUATION_EPISODES = 1000
"""Entries of the evaluation set."""
DRAWN_EPISODES = 10_000
SPLITS = {
    "paper": (FIRST_SEED, 2**31, EVALUATION_EPISODES),
    "train": (TRAIN_SEED, TEST_SEED - DRAWN_EPISODES, DRAWN_EPISODES),
    "validation": (VALIDATION_SEED, TERMINAL_STATES_SEED - DRAWN_EPISODES, DRAWN_EPISODES),
    "test": (TEST_SEED, FIRST_SEED - DRAWN_EPISODES, DRAWN_EPISODES),
}
"""Smallest and largest seed of the first episode, and the largest number of episodes, by split."""
