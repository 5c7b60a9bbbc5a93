"""What a job of a sweep leaves in its folder (job.json): its overrides, how it stands, and why it failed."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from hrl_comfort.config import ConfigError
from hrl_comfort.files.atomic import write_text

FILE = "job.json"
State = Literal["running", "done", "stopped", "failed"]
"""`running` stays with a job that was killed: it could not say so any more."""


@dataclass(frozen=True)
class Job:
    """One job of a sweep."""

    verb: str
    overrides: tuple[str, ...]
    """Without `output` and what is Hydra's own: `task=pick`, `train_seed=0`."""
    state: State
    why: str = ""
    """What made it fail or stop, in one line."""
    command: str = ""
    """Which command ran it: a sweep can be started several times."""

    def write(self, folder: Path) -> None:
        """Write the job into its folder."""
        write_text(folder / FILE, json.dumps(asdict(self), indent=2) + "\n")


def read_job(folder: Path) -> Job:
    """Return the job of a folder.

    Raises:
      ConfigError: the file is not there, or damaged.
    """
    file = folder / FILE
    try:
        found = Job(**json.loads(file.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise ConfigError(f"{file} does not exist; a job of a sweep writes one") from None
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{file} is damaged: {error}") from error
    if found.state not in get_args(State):
        raise ConfigError(f"{file} is damaged: state={found.state!r} is none of {', '.join(get_args(State))}")
    return Job(found.verb, tuple(found.overrides), found.state, found.why, found.command)


def find_jobs(folder: Path) -> dict[Path, Job]:
    """Return the jobs of a sweep by their folders: those in `folder`, or one deeper when none is there.

    Deeper only where a sweep was begun in `folder` itself: a folder of runs may hold sweeps, and is none.
    """
    files = list(folder.glob(f"*/{FILE}"))
    if not files and (folder / "multirun.yaml").is_file():
        files = list(folder.glob(f"*/*/{FILE}"))
    return {file.parent: read_job(file.parent) for file in sorted(files, key=_numbers_by_size)}


def _numbers_by_size(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", str(path))]


def planned(folder: Path) -> list[tuple[str, ...]]:
    """Return the overrides of every job that the last sweep in `folder` was asked for.

    Empty when nobody can tell: Optuna chooses as it goes on, and says nothing beforehand.

    Raises:
      ConfigError: multirun.yaml, in which Hydra notes it, is damaged.
    """
    file = folder / "multirun.yaml"
    if not file.is_file():
        return []
    try:
        asked = [str(line) for line in OmegaConf.load(file).hydra.overrides.task]
        parsed = OverridesParser.create().parse_overrides(asked)
        (jobs,) = BasicSweeper.split_arguments(parsed, None)
    except (HydraException, OmegaConfBaseException, YAMLError, AttributeError, ValueError) as error:
        raise ConfigError(f"{file} is damaged: {' '.join(str(error).split())}") from error
    return [tuple(job) for job in jobs]
