"""Files of a user's own in the place of a choice of conf/."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from hrl_comfort.config import ConfigError
from hrl_comfort.config.overrides import choices, override
from hrl_comfort.files.documents import read_yaml


def with_own_files(overrides: Iterable[str]) -> list[str]:
    """Return `overrides` with `cell=FILE.yaml` replaced by what the file holds.

    Raises:
      ConfigError: there is no such file, or it is damaged.
    """
    return [each for line in overrides for each in _of_file(line)]


def _of_file(line: str) -> list[str]:
    """Return the overrides that a cell's own file, `cell=FILE.yaml`, stands for; `line` itself where it is none.

    Raises:
      ConfigError: there is no such file, or it is damaged.
    """
    if (match := re.fullmatch(r"cell=(['\"]?)([^'\"]+\.ya?ml)\1", line)) is None:
        return [line]
    if not (file := Path(match[2])).is_file():
        raise ConfigError(f"{line}: there is no such file; give one, or choose one of {', '.join(choices('cell'))}")
    content = {"stations_m": None, **read_yaml(file)[1]}  # those of the default cell are of no use elsewhere
    # Without `++` a mapping is set as a whole; with it Hydra would add to the entries of the default cell.
    return [override(f"cell.{key}", value).lstrip("+") for key, value in content.items()]
