"""Several trainings in one process, side by side, with one batched update for all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack

from torchrl.envs import EnvBase

from hrl_comfort.agents.together import Diverged, Together, kind
from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.preemption import Preempted, asked_to_stop
from hrl_comfort.experiments.progress import training_line
from hrl_comfort.experiments.train import Make, Training, begun

Stop = Exception | Preempted
"""What kept a training from its end."""


def train_together(
    configs: Sequence[TrainConfig],
    make_env: Callable[[TrainConfig], EnvBase],
    make_guide: Make | None = None,
    make_successor: Make | None = None,
) -> dict[int, Stop]:
    """Train as each of `configs` says, as `train` would; return what stopped those that did not end.

    Each has its own environment, folder and random numbers, and so becomes what it would be alone, up to
    the rounding of products. One that fails leaves the others alone. Those that cannot share an update, for
    they differ in more than seeds, people, comfort or rewards, or are not equally far, take turns.
    """
    trainings: dict[int, Training] = {}
    stopped: dict[int, Stop] = {}
    with ExitStack() as folders:
        for index, config in enumerate(configs):
            try:
                begins = begun(config, make_env, make_guide, make_successor)
                trainings[index] = folders.enter_context(begins)
            except Exception as error:  # noqa: BLE001  it is returned, and the others go on
                stopped[index] = error
        for group in _alike(trainings):
            if any(isinstance(why, Preempted) for why in stopped.values()):
                stopped |= {index: Preempted("stopped by SIGTERM before its turn") for index in group}
            else:
                stopped |= _side_by_side(group) if len(group) > 1 else _alone(*group.popitem())
    return stopped


def _alone(index: int, training: Training) -> dict[int, Stop]:
    """Run a training to its end, as `train` would; return what stopped it, if anything did."""
    try:
        training.run()
    except (Exception, Preempted) as error:  # noqa: BLE001  it is returned, and the others go on
        return {index: error}
    return {}


def _alike(trainings: dict[int, Training]) -> list[dict[int, Training]]:
    """Return the trainings in groups that can share their updates; whoever is guided is a group."""
    groups: dict[object, dict[int, Training]] = {}
    for index, each in trainings.items():
        alone = index if each.guide is not None else None
        groups.setdefault((kind(each.learner), each.decisions, each.rows, alone), {})[index] = each
    return [*groups.values()]


def _side_by_side(trainings: dict[int, Training]) -> dict[int, Stop]:
    """Run trainings of one kind to their end; return what stopped those that did not get there."""
    stopped: dict[int, Stop] = {}
    first = next(iter(trainings.values()))
    name = f"{first.config.task.name} × {len(trainings)}"
    together = Together([each.learner for each in trainings.values()])
    with (
        training_line(name, first.config.agent.decisions, first.decisions) as show,
        asked_to_stop() as stop,
    ):
        rounds = {index: each.rounds(stop, show) for index, each in trainings.items()}
        while rounds:
            due = 0
            for index in list(rounds):
                try:
                    due = next(rounds[index])
                except StopIteration:
                    del rounds[index]
                except (Exception, Preempted) as error:  # noqa: BLE001  it is returned, and the others go on
                    stopped[index] = error
                    del rounds[index]
            while due and rounds:
                if len(together.learners) > len(rounds):
                    together = Together([trainings[index].learner for index in rounds])
                try:
                    terms = together.update()
                except Diverged as error:
                    (index,) = (each for each in rounds if trainings[each].learner is error.learner)
                    stopped[index] = error
                    rounds.pop(index).close()
                    continue
                for index, each in zip(rounds, terms, strict=True):
                    trainings[index].log.update(each)
                due -= 1
    return stopped
