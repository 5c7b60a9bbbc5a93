"""`hrl-comfort bench together`: the updates of several policies as one, beside one policy after the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from hrl_comfort.agents.sac import Sac
from hrl_comfort.agents.together import Together
from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.bench import medians
from hrl_comfort.experiments.bench_update import Update, learner, observation_width, rate
from hrl_comfort.experiments.measure import write_table
from hrl_comfort.experiments.statistics import Row, read_rows

BATCHES, POLICIES = (64, 256), (2, 4, 8)
ROUNDS = 5
TOGETHER, ONE_BY_ONE = "together", "one by one"
COLUMNS = ["batch × policies", "loop", "round", "updates_per_s"]


def bench_together(config: TrainConfig) -> Path:
    """Print updates a second, over all policies, together and one by one, and their ratio; return the CSV.

    An update is a sample of the replay buffer, all losses, the optimiser's step and the targets'. Rounds are
    interleaved. What is measured goes to together.csv.
    """
    torch.set_num_threads(1)
    width = observation_width(config)
    rates: list[list[object]] = []
    for batch in BATCHES:
        for count in POLICIES:
            apart = [learner(config.agent, width, batch) for _ in range(count)]
            together = Together([learner(config.agent, width, batch) for _ in range(count)])
            loops: dict[str, Update] = {TOGETHER: together.update, ONE_BY_ONE: one_by_one(apart)}
            for update in loops.values():
                update()
            for turn in range(ROUNDS):
                for name, update in loops.items():
                    rates.append([f"{batch} × {count}", name, turn, count * rate(update)])
    path = Path(config.output) / "together.csv"
    write_table(path, COLUMNS, rates)
    print(table(read_rows(path)), end="")
    return path


def one_by_one(learners: Sequence[Sac]) -> Update:
    """Return a call that updates one after the other."""

    def update() -> None:
        for one in learners:
            one.update()

    return update


def table(rows: Sequence[Row]) -> str:
    """Return the rows of together.csv as a Markdown table: medians, ranges and ratios."""
    return medians(rows, COLUMNS, ONE_BY_ONE, lambda together, apart: together / apart, "of one by one")
