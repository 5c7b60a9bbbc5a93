"""Remake people/evaluation_set.csv: `python -m hrl_comfort.people.make_evaluation_set > FILE`.

Seen and unseen spawns alternate, so that any prefix of the set is half and half. A seen entry stands anywhere in
the training disc of a training spawn; an unseen one at a held-out spawn, within `UNSEEN_JITTER_M` of it.
"""

from __future__ import annotations

import csv
import io
import sys
from dataclasses import replace

import numpy as np

from hrl_comfort.compose import compose
from hrl_comfort.config import CellConfig, HumanConfig, TrainConfig
from hrl_comfort.people import around, jittered_spawn, moved_spawns, outside, training_spawns
from hrl_comfort.people.evaluation import COLUMNS, FIRST_SEED

EPISODES = 1000
UNSEEN_JITTER_M = 0.05


def evaluation_set(human: HumanConfig, cell: CellConfig) -> str:
    """Return the file's text."""
    goals = np.array([cell.ball_m, cell.orange_drop_m, cell.pink_drop_m])[:, :2]
    spawns = moved_spawns(human, goals)
    rng = np.random.default_rng(FIRST_SEED)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for episode in range(EPISODES):
        seen = episode % 2 == 0
        indices = training_spawns(human) if seen else np.array(sorted(human.held_out))
        spawn = int(indices[episode // 2 % len(indices)])
        disc = human if seen else replace(human, spawn_jitter_m=UNSEEN_JITTER_M)
        place = jittered_spawn(disc, spawns[spawn][None], rng.random((1, 2)))
        x, y = outside(place, around(goals, human.keep_out_m, 1))[0]
        writer.writerow([episode, FIRST_SEED + episode, spawn, f"{x:.6f}", f"{y:.6f}", FIRST_SEED + episode, seen])
    return text.getvalue()


if __name__ == "__main__":
    config = compose("train", ["task=pick"])
    assert isinstance(config, TrainConfig)
    sys.stdout.write(evaluation_set(config.human, config.cell))
