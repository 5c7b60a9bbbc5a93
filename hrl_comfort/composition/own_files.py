"""Choices that are a user's own file: `human=FILE.yaml` has keys of `human`, on top of the motion that it names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from hrl_comfort.config import ConfigError
from hrl_comfort.config.overrides import choices, override
from hrl_comfort.files.documents import read_yaml


def with_own_files(overrides: Iterable[str]) -> list[str]:
    """Return `overrides` with what a user's own files say in the place of those that name one.

    Raises:
      ConfigError: there is no such file, or it is damaged.
    """
    return [each for line in overrides for each in _of_file(line)]


def _of_file(line: str) -> list[str]:
    if (match := re.fullmatch(r"human=(['\"]?)([^'\"]+\.ya?ml)\1", line)) is None:
        return [line]
    if not (file := Path(match[2])).is_file():
        raise ConfigError(f"{line}: there is no such file; give one, or choose one of {', '.join(choices('human'))}")
    said = read_yaml(file)[1]
    found = [f"human={motion}"] if (motion := said.get("motion")) in choices("human") else []
    for key, value in said.items():
        found += [override(f"human.{key}", None)] if isinstance(value, dict) else []  # Hydra would add its entries
        found += [] if key == "motion" and motion in choices("human") else [override(f"human.{key}", value)]
    return found
