"""Training in a run folder: from the beginning, or on from its newest good checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import torch
import torchrl

from hrl_comfort.agents import checkpoint
from hrl_comfort.config import HIERARCHY, ConfigError, MetaControllerTrainConfig, TrainConfig, TrainingConfig
from hrl_comfort.files.output import held_folder, output_folder
from hrl_comfort.files.provenance import RunState, is_finished, resumable, run_state
from hrl_comfort.files.run_config import load_config
from hrl_comfort.training.loop import TrainingLoop

C = TypeVar("C", bound=TrainingConfig)
WHAT: dict[type[TrainingConfig], tuple[str, str]] = {
    TrainConfig: ("a subtask", "train"),
    MetaControllerTrainConfig: ("a controller", "train meta_controller"),
}
"""Object of a training, and its command, by the class of its configuration."""
MISFITS = (AttributeError, IndexError, KeyError, TypeError, ValueError, RuntimeError)
"""Errors of torch, TorchRL and this program when a state does not fit."""


def train_in_folder(config: C, begin: Callable[[C, Path, bool], TrainingLoop]) -> Path:
    """Train in the folder that `config` names, or go on there; `begin` takes folder and whether it resumes.

    Raises:
        ConfigError: the folder is taken, or there is nothing to resume.
    """
    torch.set_num_threads(1)
    torchrl.logger.setLevel("WARNING")  # it logs every buffer that it allocates
    folder, resumes = Path(config.resume or config.output), config.resume is not None
    with claim(folder, resumes):
        training = begin(stopped_config(folder, type(config)) if resumes else config, folder, resumes)
        if resumes:
            load_checkpoint(training, folder)
        training.run()
    return folder


@contextmanager
def claim(folder: Path, resume: bool) -> Iterator[None]:
    """Hold `folder` for one training, as long as the context lasts (the process's end frees it too).

    Raises:
        ConfigError: another process writes in it, or it holds a run, or what is no training, and `resume` is
            false. A training that ended before its first checkpoint has left nothing to resume: its folder is free.
    """
    if resume:
        if not folder.is_dir():
            raise ConfigError(f"resume={folder} is not a run folder")
        with held_folder(folder):
            yield
        return
    if _holds_run(folder):
        stopped = resumable(folder)
        what = "a controller" if (folder / "meta_controller.pt").exists() and not stopped else "a run"
        remedy = f", or say resume={folder}" if stopped else ""
        raise ConfigError(f"output={folder} already holds {what}; choose another{remedy}")
    with output_folder(folder, TrainingConfig, "config.yaml", HIERARCHY):
        yield


def _holds_run(folder: Path) -> bool:
    """Return whether a run is there that is finished, or can be resumed."""
    if run_state(folder) is not RunState.NEW:
        return True
    policies = any((folder / name).exists() for name in ("policy.pt", "meta_controller.pt"))
    return policies and not (folder / "provenance.json").exists()


def stopped_config(folder: Path, kind: type[C]) -> C:
    """Return the configuration of the stopped training in `folder`.

    Raises:
        ConfigError: the folder has no such training, or it is finished.
    """
    config = load_config(folder)
    if not isinstance(config, TrainingConfig):
        raise ConfigError(f"resume={folder} is not the folder of a training")
    if not isinstance(config, kind):
        what, command = WHAT[type(config)]
        raise ConfigError(f"resume={folder} trains {what}; say {command} resume={folder}")
    if is_finished(folder):
        on = f"; train on from it with initial_policy={folder}" if kind is TrainConfig else ""
        raise ConfigError(f"resume={folder} is finished{on}")
    return replace(config, output=str(folder), resume=None)


def load_checkpoint(training: TrainingLoop, folder: Path) -> None:
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
        first: BaseException = error
        while first.__cause__ is not None:
            first = first.__cause__
        what = [*str(first).strip().splitlines(), type(first).__name__][0]
        raise ConfigError(f"resume={folder}: its checkpoint does not fit its config.yaml: {what}") from error
