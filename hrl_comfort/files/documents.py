"""JSON and YAML files of a run folder, checked by pydantic."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, FiniteFloat, TypeAdapter, ValidationError

from hrl_comfort.config.checks import ConfigError, first_error

T = TypeVar("T")


class Metric(BaseModel):
    """Mean and 95 % interval of one metric."""

    model_config = ConfigDict(extra="allow")

    mean: FiniteFloat
    ci95: tuple[FiniteFloat, FiniteFloat] | None


class Group(BaseModel):
    """One group of episodes in summary.json; its labels are extra fields."""

    model_config = ConfigDict(extra="allow")

    episodes: int
    metrics: dict[str, Metric]


class Summary(BaseModel):
    """The content of summary.json."""

    groups: list[Group]


def damaged(path: Path, reason: object) -> ConfigError:
    """Return the error, in one line, that names a damaged file and what is wrong in it."""
    return ConfigError(f"{path} is damaged: {' '.join(str(reason).split())}")


def read_json(path: Path, kind: type[T]) -> T:
    """Return the content of a JSON file; raise ConfigError if the file does not exist, or is not of this kind."""
    try:
        return TypeAdapter(kind).validate_json(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist") from None
    except ValidationError as error:
        raise damaged(path, first_error(error)) from None


def read_yaml(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the text of a YAML mapping and its content.

    Raises:
      ConfigError: the file is not UTF-8, not YAML, or not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = yaml.safe_load(text)
    except (ValueError, yaml.YAMLError) as error:
        raise damaged(path, error) from None
    if not isinstance(content, dict):
        raise damaged(path, f"it holds a {type(content).__name__}, not a mapping")
    return text, content
