"""job.json: the overrides, state and error of one job of a sweep."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Literal

from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic.dataclasses import dataclass
from yaml import YAMLError

from hrl_comfort.config.overrides import check_jobs, parse
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.documents import damaged, read_json, read_yaml

FILE = "job.json"
DAMAGED = (
    HydraException, OmegaConfBaseException, YAMLError, AttributeError, TypeError, ValueError, RecursionError
)  # fmt: skip
"""Errors of Hydra and OmegaConf at a damaged record."""
JobState = Literal["running", "done", "stopped", "failed"]
"""A job that was killed stays `running`: it could not record its end."""


@dataclass(frozen=True)
class Job:
    """One job of a sweep."""

    verb: str
    overrides: tuple[str, ...]
    """Without `output` and Hydra's own: `task=pick`, `train_seed=0`."""
    state: JobState
    why: str = ""
    """The reason why it failed or stopped, in one line."""
    command: str = ""
    """The command that ran it: a sweep can be started several times."""

    def write(self, folder: Path) -> None:
        """Write the job into its folder."""
        write_json(folder / FILE, asdict(self))


def read_job(folder: Path) -> Job:
    """Return the job of a folder; raise ConfigError where its record is missing or damaged."""
    return read_json(folder / FILE, Job)


def find_jobs(folder: Path) -> dict[Path, Job]:
    """Return the jobs of a sweep by their folders: those in `folder`, or one deeper when none is there.

    Deeper only where a sweep was begun in `folder` itself: a folder of runs may hold sweeps, and is none. A run is
    none either; its `eval/` may be a job of `evaluate -m`.
    """
    if (folder / "config.yaml").is_file():
        return {}
    files = list(folder.glob(f"*/{FILE}"))
    if not files and (folder / "multirun.yaml").is_file():
        files = list(folder.glob(f"*/*/{FILE}"))
    return {file.parent: read_job(file.parent) for file in sorted(files, key=_numbers_by_size)}


def _numbers_by_size(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", str(path))]


def planned(folder: Path) -> list[tuple[str, ...]]:
    """Return the overrides of every job that the last sweep in `folder` was asked for.

    Empty where they are not known beforehand: Optuna chooses them as it goes on.

    Raises:
      ConfigError: Hydra's record of it, multirun.yaml, is damaged.
    """
    file = folder / "multirun.yaml"
    if not file.is_file():
        return []
    try:
        parsed = [parse(str(line)) for line in OmegaConf.create(read_yaml(file)[0]).hydra.overrides.task]
        check_jobs(parsed)
        return list(product(*{each.get_key_element(): _values(each) for each in parsed}.values()))
    except DAMAGED as error:
        raise damaged(file, error) from None


def _values(asked: Override) -> Iterator[str]:
    """Yield an override for each value that `asked` sweeps over, as Hydra's own sweeper writes them."""
    swept = asked.sweep_string_iterator() if asked.is_sweep_override() else [asked.get_value_element_as_str()]
    return (f"{asked.get_key_element()}={value}" for value in swept)
