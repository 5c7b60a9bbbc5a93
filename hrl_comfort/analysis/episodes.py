"""Terminations of episodes in words, and lengths of their chains of options."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd
from pandas import DataFrame

from hrl_comfort.analysis.intervals import SHARE, Clusters, Estimate
from hrl_comfort.files.tables import column

TERMINATIONS = (
    "success", "unsafe contact", "contact", "hit table", "self-collision", "object lost", "dropped", "time limit"
)  # fmt: skip
LEVEL = r"(?:_as_\d+)?"
"""End of the name of an option with a level of its own."""
PICK = re.compile(rf"pick_(\d+){LEVEL}")
"""An option that picks one of several objects."""


def terminations(episodes: DataFrame) -> pd.Series:
    """Return how each of n episodes ended, in words: one of TERMINATIONS or `other`."""
    contact, timed_out = column(episodes, "contact") > 0, column(episodes, "truncated") > 0
    other = episodes["other_collision"] if "other_collision" in episodes else pd.Series("none", episodes.index)
    conditions = [
        column(episodes, "success") > 0,
        column(episodes, "unsafe_contact") > 0,
        contact & ~timed_out & (other == "none").to_numpy(dtype=bool),
        (other == "table").to_numpy(dtype=bool),
        (other == "self").to_numpy(dtype=bool),
        column(episodes, "object_lost") > 0,
        timed_out & (column(episodes, "drops") > 0),
        timed_out,
    ]
    return pd.Series(np.select(conditions, TERMINATIONS, "other"), index=episodes.index)


def success(episodes: DataFrame) -> Estimate:
    """Return the share of episodes that succeeded, and its interval."""
    share = Clusters.of(episodes).estimate(column(episodes, "success"), bounds=SHARE)
    assert share is not None, "every episode succeeds or fails"
    return share


def kind_of(option: str) -> str:
    """Return what an option does: its name without the object and the level it is told."""
    return "pick" if PICK.fullmatch(option) else re.sub(f"{LEVEL}$", "", option)


def chain_lengths(episodes: DataFrame, options: DataFrame, least: int = 0) -> list[dict[str, Any]]:
    """Return, for 1, 2, ... options in a row, the share of episodes in which so many succeeded.

    As far as any episode got, and at least to `least`. What takes the task no further does not count: waits,
    a pick whose object was lost, and retreats, but for those that take the place of a return. What a retreat
    places on its way home does not count either, nor does the pick after it.
    """
    done = dict.fromkeys(episodes["episode"], 0)
    last: dict[Any, str] = {}
    for episode, option, ended in zip(options["episode"], options["option"], options["termination"], strict=True):
        kind, before = kind_of(option), last.get(episode)
        if kind == "retreat" and before == "place":
            kind = "return"
        if ended != "success" or kind in ("wait", "retreat"):
            continue
        if (kind, before) != ("pick", "pick"):  # else the object was lost, or placed on a way home
            done[episode] += 1
        last[episode] = kind
    lengths, clusters = episodes["episode"].map(done).to_numpy(), Clusters.of(episodes)
    found: list[dict[str, Any]] = []
    for length in range(1, max(least, int(lengths.max(initial=0))) + 1):
        share = clusters.estimate((lengths >= length).astype(float), bounds=SHARE)
        assert share is not None, "an episode gets so far, or not"
        found.append({"options": length, "success": share["mean"], "ci95": share["ci95"]})
    return found
