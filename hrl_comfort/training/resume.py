"""Resuming a training: its own configuration and its newest good checkpoint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from hrl_comfort.agents import checkpoint
from hrl_comfort.config import ConfigError, MetaControllerTrainConfig, TrainConfig
from hrl_comfort.config.compose import load_config
from hrl_comfort.files.provenance import read_provenance

C = TypeVar("C", TrainConfig, MetaControllerTrainConfig)
WHAT = {TrainConfig: "a subtask", MetaControllerTrainConfig: "a controller"}
VERB = {TrainConfig: "train", MetaControllerTrainConfig: "train meta_controller"}
MISFITS = (AttributeError, IndexError, KeyError, TypeError, ValueError, RuntimeError)
"""Errors of torch, TorchRL and this program when a state does not fit."""


class Resumable(Protocol):
    """A training that can continue bit for bit."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""


def stopped_config(folder: Path, kind: type[C]) -> C:
    """Return the configuration of the stopped training in `folder`.

    Raises:
        ConfigError: the folder has no such training, or it is finished.
    """
    config = load_config(folder)
    if not isinstance(config, TrainConfig | MetaControllerTrainConfig):
        raise ConfigError(f"resume={folder} is not the folder of a training")
    if not isinstance(config, kind):
        other = type(config)
        raise ConfigError(f"resume={folder} trains {WHAT[other]}; say {VERB[other]} resume={folder}")
    if (folder / "provenance.json").exists() and read_provenance(folder).finished:
        on = f"; train on from it with initial_policy={folder}" if kind is TrainConfig else ""
        raise ConfigError(f"resume={folder} is finished{on}")
    return replace(config, output=str(folder), resume=None)


def go_on(training: Resumable, folder: Path) -> None:
    """Continue `training` from the newest good checkpoint in `folder`.

    Raises:
        ConfigError: there is none, or it belongs to another configuration.
    """
    state = checkpoint.load_resumable(folder / "checkpoints")
    try:
        training.load_state_dict(state)
    except ConfigError:  # says it all
        raise
    except MISFITS as error:
        first = _first(error)
        what = [*str(first).strip().splitlines(), type(first).__name__][0]
        raise ConfigError(f"resume={folder}: its checkpoint does not fit its config.yaml: {what}") from error


def _first(error: BaseException) -> BaseException:
    """Return the first error in a chain of causes."""
    return error if error.__cause__ is None else _first(error.__cause__)
