"""Generation of evaluation_set.csv from conf/: `python -m hrl_comfort.humans.make_evaluation_set > FILE`.

Seen and unseen spawns alternate, so every prefix of the set is balanced. Seen spawns lie within `spawn_jitter_m`
of a training point, unseen ones within UNSEEN_JITTER_M of a held-out point.
"""

from __future__ import annotations

import csv
import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from pydantic import TypeAdapter

from hrl_comfort.config import EVALUATION_EPISODES, FIRST_SEED, CellConfig, HumanConfig
from hrl_comfort.humans import around, jittered_spawn, moved_spawns, outside, training_spawns

COLUMNS = ("episode", "episode_seed", "spawn_id", "x", "y", "motion_id", "seen")
UNSEEN_JITTER_M = 0.05


def evaluation_set(human: HumanConfig, cell: CellConfig) -> str:
    """Return the evaluation set as CSV text."""
    goals = np.array(list(cell.goals.values()))[:, :2]
    spawns = moved_spawns(human, goals)
    rng = np.random.default_rng(FIRST_SEED)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for episode in range(EVALUATION_EPISODES):
        seen = episode % 2 == 0
        indices = training_spawns(human) if seen else np.array(sorted(human.held_out))
        spawn = int(indices[episode // 2 % len(indices)])
        disc = human if seen else replace(human, spawn_jitter_m=UNSEEN_JITTER_M)
        place = jittered_spawn(disc, spawns[spawn][None], rng.random((1, 2)))
        x, y = outside(place, around(goals, human.keep_out_m, 1))[0]
        writer.writerow([episode, FIRST_SEED + episode, spawn, f"{x:.6f}", f"{y:.6f}", FIRST_SEED + episode, seen])
    return text.getvalue()


def default_choices(conf: Path) -> tuple[HumanConfig, CellConfig]:
    """Return the default human and the paper's cell of the YAML files in `conf`, read without Hydra."""
    human, shared, cell = (
        yaml.safe_load((conf / name).read_text(encoding="utf-8"))
        for name in ("human/_shared.yaml", "cell/_shared.yaml", "cell/paper.yaml")
    )
    del cell["defaults"]
    return HumanConfig(motion="random_walk", **human), TypeAdapter(CellConfig).validate_python({**shared, **cell})


if __name__ == "__main__":
    sys.stdout.write(evaluation_set(*default_choices(Path("conf"))))
