"""The work left in a job whose folder exists already, so that a sweep can be started again."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from pathlib import Path

from hrl_comfort.agents import checkpoint
from hrl_comfort.config import ConfigError, EvaluateConfig, MetaControllerTrainConfig, TrainConfig
from hrl_comfort.config.compose import load_config
from hrl_comfort.files.provenance import read_provenance
from hrl_comfort.hierarchy.q_learning import choice_file
from hrl_comfort.policies.actor import policy_file


class OtherRunError(ConfigError):
    """The folder of a job holds a run of another sweep."""


class Left(Enum):
    """The work left in a job."""

    ALL = "done"
    REST = "resumed"
    NOTHING = "skipped, finished"


def left(config: TrainConfig | MetaControllerTrainConfig | EvaluateConfig) -> Left:
    """Return the work left in the job that `config` describes, by the content of its output folder.

    An evaluation is finished while its summary is newer than every policy of it.

    Raises:
      OtherRunError: the folder holds another training.
      ConfigError: it is damaged.
    """
    folder = Path(config.output)
    if not (folder / "config.yaml").is_file():
        return Left.ALL
    there = load_config(folder)
    same = isinstance(there, type(config)) and replace(there, output=config.output) == config
    if isinstance(config, EvaluateConfig):
        return Left.NOTHING if same and _is_newest(folder / "summary.json", config) else Left.ALL
    if not same:
        raise OtherRunError(f"output={folder} holds another run; choose another, or delete it")
    if (folder / "provenance.json").is_file() and read_provenance(folder).finished:
        return Left.NOTHING
    return Left.REST if checkpoint.resumable(folder / "checkpoints") else Left.ALL


def _is_newest(summary: Path, config: EvaluateConfig) -> bool:
    if not summary.is_file():
        return False
    named = {"policy": config.policy, **config.policies}
    paths = {name: Path(path) for name, path in named.items() if path is not None and Path(path).exists()}
    files = [choice_file(path) if name == "meta_controller" else policy_file(path) for name, path in paths.items()]
    return all(file.stat().st_mtime <= summary.stat().st_mtime for file in files)
