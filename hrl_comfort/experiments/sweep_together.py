"""`hrl-comfort train -m --together`: the trainings of a sweep in one process, with one update for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.core.hydra_config import HydraConfig

from hrl_comfort.compose import compose, override
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments.again import Left, left
from hrl_comfort.experiments.preemption import Preempted
from hrl_comfort.experiments.sweep_job import Ended, failed
from hrl_comfort.experiments.sweep_record import Job

if TYPE_CHECKING:
    from hrl_comfort.experiments.train_together import Why


def check_together(verb: str, overrides: list[str]) -> None:
    """Raise ConfigError where a sweep cannot be trained together."""
    if verb != "train":
        raise ConfigError(f"{verb} cannot be run --together; train can")
    for line in overrides:
        if line.startswith(("hydra/launcher=", "hydra/sweeper=")):
            raise ConfigError(f"{line} does not go with --together, which trains in this process")


@dataclass(frozen=True)
class Asked:
    """A training of a sweep."""

    overrides: tuple[str, ...]
    folder: Path


def gather(asked: list[Asked], _: object) -> None:
    """Take down, for later, the job that Hydra launches."""
    hydra = HydraConfig.get()
    overrides = tuple(str(line) for line in hydra.overrides.task)
    asked.append(Asked(overrides, Path(hydra.runtime.output_dir)))


def train_all(asked: Sequence[Asked], command: str) -> list[tuple[Sequence[str], Ended]]:
    """Do what is left of the trainings of a sweep, in one process, with one update for all.

    Return the overrides of each, and how it ended.

    Raises:
      Preempted: SIGTERM came; each that had begun has written a checkpoint.
    """
    from hrl_comfort.experiments.train_cell import train_cells  # TorchRL: late, after every choice is checked

    records = [Job("train", each.overrides, "running", command=command) for each in asked]
    ended: dict[int, Ended] = {}
    how: dict[int, Left] = {}
    told: Preempted | None = None

    def end(index: int, why: Why) -> None:
        nonlocal told
        record, folder = records[index], asked[index].folder
        if why is None:
            replace(record, state="done").write(folder)
            ended[index] = Ended(how[index].value, str(folder))
        elif isinstance(why, Preempted):
            told = why
            replace(record, state="stopped", why=str(why)).write(folder)
        else:
            ended[index] = failed(record, folder, why)

    def turn(place: int, config: TrainConfig) -> TrainConfig | None:
        index = indices[place]
        how[index] = left(config)  # now: another command may have done it meanwhile
        if how[index] is Left.NOTHING:
            end(index, None)
            return None
        records[index].write(asked[index].folder)
        return replace(config, resume=config.output) if how[index] is Left.REST else config

    configs: dict[int, TrainConfig] = {}
    for index, each in enumerate(asked):
        try:
            config = compose("train", [*each.overrides, override("output", each.folder)])
            assert isinstance(config, TrainConfig)
            configs[index] = config
        except Exception as error:  # noqa: BLE001  whatever it was, it is reported and the other jobs go on
            end(index, error)
    indices = [*configs]
    for place, why in train_cells([*configs.values()], turn):
        end(indices[place], why)
    if told is not None:
        raise told
    return [(each.overrides, ended[index]) for index, each in enumerate(asked)]
