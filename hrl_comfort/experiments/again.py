"""What is left to do of a job whose folder is there already: so a sweep can be started again."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from hrl_comfort.compose import load_config
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig
from hrl_comfort.experiments.training_log import read_provenance


class Left(Enum):
    """What is left to do of a job."""

    ALL = "done"
    REST = "resumed"
    NOTHING = "skipped, finished"


def left(config: TrainConfig | EvaluateConfig) -> Left:
    """Return what is left of the job that `config` describes, by what is in its output folder.

    Raises:
      ConfigError: the folder holds another run, or is damaged.
    """
    folder = Path(config.output)
    if not (folder / "config.yaml").is_file():
        return Left.ALL
    if load_config(folder) != config:
        raise ConfigError(f"output={folder} holds another run; choose another, or delete it")
    if isinstance(config, EvaluateConfig):
        return Left.NOTHING if (folder / "summary.json").is_file() else Left.ALL
    if (folder / "provenance.json").is_file() and read_provenance(folder)["finished"]:
        return Left.NOTHING
    checkpoints = folder / "checkpoints"
    resumable = any((checkpoints / name).is_file() for name in ("latest.pt", "previous.pt"))
    return Left.REST if resumable else Left.ALL
