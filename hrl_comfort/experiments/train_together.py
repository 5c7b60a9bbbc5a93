"""Several trainings in one process, side by side, with one batched update for all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack

from hrl_comfort.agents.together import OWN, Diverged, Together, kind
from hrl_comfort.config import TrainConfig
from hrl_comfort.experiments.preemption import Preempted, asked_to_stop
from hrl_comfort.experiments.progress import training_line
from hrl_comfort.experiments.train import Make, Training, begun

Why = Exception | Preempted | None
"""What kept a training from its end, if anything did."""
Turn = Callable[[int, TrainConfig], TrainConfig | None]
"""(index, configuration) -> how to train when its turn has come; None if nothing is left to do."""


def as_it_is(_: int, config: TrainConfig) -> TrainConfig:
    """Return the configuration."""
    return config


def train_together(
    configs: Sequence[TrainConfig],
    make: Make,
    turn: Turn = as_it_is,
) -> Iterator[tuple[int, Why]]:
    """Train as each of `configs` says, as `train` would; yield each one's index as it ends, and why it did.

    Each has its own environment, folder and random numbers; only the rounding of products tells an update
    from one made alone. One that fails leaves the others alone. Those that cannot share an update, for they
    differ in more than seeds, people, comfort or rewards, or are not equally far, take turns.
    """
    with asked_to_stop() as stop:
        for indices in _alike({index: _settings(config, index) for index, config in enumerate(configs)}):
            trainings: dict[int, Training] = {}
            held: dict[int, ExitStack] = {}
            with ExitStack() as all_held:
                for index in indices:
                    if stop():
                        yield index, Preempted("stopped by SIGTERM before its turn")
                        continue
                    try:
                        config = turn(index, configs[index])
                        if config is None:
                            continue
                        held[index] = all_held.enter_context(ExitStack())
                        begins = begun(config, make)
                        trainings[index] = held[index].enter_context(begins)
                    except Exception as error:  # noqa: BLE001  it is yielded, and the others go on
                        yield index, error
                keys = {index: (kind(each.learner), each.decisions) for index, each in trainings.items()}
                for group in _alike(keys):
                    for index, why in _side_by_side({each: trainings.pop(each) for each in group}, stop):
                        yield index, why
                        held[index].close()  # whoever reads how it ended can have its folder


def _alike(keys: Mapping[int, object]) -> list[list[int]]:
    """Return the indices in groups of the same key, in order."""
    groups: dict[object, list[int]] = {}
    for index, key in keys.items():
        groups.setdefault(key, []).append(index)
    return [*groups.values()]


def _settings(config: TrainConfig, index: int) -> object:
    """Return what trainings have to have in common to share updates, as far as it is configured."""
    agent = {name: value for name, value in vars(config.agent).items() if name not in OWN}
    return config.engine.rows, str(agent), index if config.agent.guide is not None else None


def _side_by_side(trainings: dict[int, Training], stop: Callable[[], bool]) -> Iterator[tuple[int, Why]]:
    """Run trainings of one kind to their end; yield each one's index as it ends, and why it did."""
    first = next(iter(trainings.values()))
    count, asked = len(trainings), False
    name = f"{first.config.task.name} × {count}" if count > 1 else first.config.task.name
    for each in trainings.values():
        each.together = count
    together: Together | None = None
    with training_line(name, first.config.agent.decisions, first.decisions) as show:
        rounds = {index: each.rounds(lambda: asked, show) for index, each in trainings.items()}
        while rounds:
            asked, due = stop(), 0  # asked once, so that all stop after the same decision
            for index in list(rounds):
                try:
                    due = next(rounds[index])
                except StopIteration:
                    del rounds[index]
                    yield index, None
                except (Exception, Preempted) as error:  # noqa: BLE001  it is yielded, and the others go on
                    del rounds[index]
                    yield index, error
            while due and rounds:
                due -= 1
                try:
                    if len(rounds) == 1:
                        (index,) = rounds
                        trainings[index].learn(1)
                        continue
                    if together is None or len(together.learners) > len(rounds):
                        together = Together([trainings[index].learner for index in rounds])
                    for index, terms in zip(rounds, together.update(), strict=True):
                        trainings[index].log.update(terms)
                except Exception as error:  # noqa: BLE001  it is yielded, and whoever is left goes on
                    who = error.learner if isinstance(error, Diverged) else None
                    for index in [each for each in rounds if who in (None, trainings[each].learner)]:
                        rounds.pop(index).close()
                        yield index, error
                    due += 1  # for the others, who have not been updated
