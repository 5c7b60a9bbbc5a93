"""`hrl-comfort train -m --together`: the trainings of a sweep in one process, with one update for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hydra.core.hydra_config import HydraConfig

from hrl_comfort.compose import compose, override
from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.experiments.again import Left, left
from hrl_comfort.experiments.preemption import Preempted
from hrl_comfort.experiments.sweep_job import Ended, failed
from hrl_comfort.experiments.sweep_record import Job


def check_together(verb: str, overrides: list[str]) -> list[str]:
    """Return the overrides; raise ConfigError where trainings cannot be run together so."""
    if verb != "train":
        raise ConfigError(f"{verb} cannot be run --together; train can")
    for line in overrides:
        if line.startswith(("hydra/launcher=", "hydra/sweeper=")):
            raise ConfigError(f"{line} does not go with --together, which trains in this process")
    return overrides


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


def train_all(asked: Sequence[Asked], command: str) -> list[Ended]:
    """Do what is left of the trainings of a sweep, in one process, with one update for all.

    Raises:
      Preempted: SIGTERM came; each has written a checkpoint.
    """
    from hrl_comfort.experiments.train_cell import train_cells  # TorchRL: late, after every choice is checked

    records = [Job("train", each.overrides, "running", command=command) for each in asked]
    ended: dict[int, Ended] = {}
    waiting: dict[int, tuple[TrainConfig, Left]] = {}
    for index, (each, record) in enumerate(zip(asked, records, strict=True)):
        try:
            config = compose("train", [*each.overrides, override("output", each.folder)])
            assert isinstance(config, TrainConfig)
            rest = left(config)
            record.write(each.folder)
            if rest is Left.REST:
                config = replace(config, resume=str(each.folder))
            if rest is Left.NOTHING:
                ended[index] = Ended(rest.value, str(each.folder))
            else:
                waiting[index] = config, rest
        except Exception as error:  # noqa: BLE001  whatever it was, it is reported and the other jobs go on
            ended[index] = failed(record, each.folder, error)
    stopped = train_cells([config for config, _ in waiting.values()])
    for place, (index, (_, rest)) in enumerate(waiting.items()):
        folder, why = asked[index].folder, stopped.get(place)
        if isinstance(why, Preempted):
            replace(records[index], state="stopped", why=str(why)).write(folder)
        elif why is not None:
            ended[index] = failed(records[index], folder, why)
        else:
            ended[index] = Ended(rest.value, str(folder))
    for index, done in ended.items():
        if done.problem is None:
            replace(records[index], state="done").write(asked[index].folder)
    preempted = [why for why in stopped.values() if isinstance(why, Preempted)]
    if preempted:
        raise preempted[0]
    return [ended[index] for index in range(len(asked))]
