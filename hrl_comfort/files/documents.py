"""JSON and YAML files of a run folder, checked by pydantic."""

from __future__ import annotations

from pathlib import Path
from typing import (
    Annotated,
    Any,
    NotRequired,  # pydantic takes those of typing from Python 3.12 on
    TypeVar,
)

import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveInt, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict

from hrl_comfort.config.checks import XYZ, ConfigError, first_error
from hrl_comfort.files.reading import read_bytes, read_text
from hrl_comfort.files.relative_paths import resolved
from hrl_comfort.files.versions import converted

MOST_BYTES = 10**6
"""Largest YAML file; those of a run are of some kB."""
T = TypeVar("T")


class Estimate(TypedDict):
    """A mean and its 95 % interval, None where none can be told."""

    mean: FiniteFloat
    ci95: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] | None


class Group(BaseModel):
    """One group of episodes in summary.json; labels by `group_by` are extra fields."""

    model_config = ConfigDict(extra="allow")

    task: str
    policy: str
    human: str
    comfort_level: int | None = None
    precision_m: FiniteFloat | None = None
    split: str | None = None
    episodes: int
    metrics: dict[str, Estimate]


class Summary(BaseModel):
    """The content of summary.json."""

    groups: list[Group]


@with_config(ConfigDict(extra="allow"))
class PlaceSection(TypedDict):
    """Keys of a place that pictures need."""

    top_m: XYZ
    size_m: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
    yaw_deg: NotRequired[FiniteFloat]


@with_config(ConfigDict(extra="allow"))
class ObjectSection(TypedDict):
    """Keys of a kind of object that pictures need."""

    arrives_at: str
    belongs_at: str
    rgb: NotRequired[Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=3, max_length=3)]]


@with_config(ConfigDict(extra="allow"))
class CellSection(TypedDict, total=False):
    """Keys of the section `cell` that pictures need."""

    places: dict[str, PlaceSection]
    objects: dict[str, ObjectSection]


@with_config(ConfigDict(extra="allow"))
class TaskSection(TypedDict, total=False):
    """Keys that reports need of the section `task`."""

    name: str
    objects: int
    object_jitter_m: FiniteFloat
    max_episode_steps: PositiveInt


@with_config(ConfigDict(extra="allow"))
class ComfortSection(TypedDict, total=False):
    """Keys that reports need of the section `comfort`."""

    levels: PositiveInt
    beta: FiniteFloat


@with_config(ConfigDict(extra="allow"))
class RunConfig(TypedDict, total=False):
    """Keys that reports need of a config.yaml; unlike `load_config`, they take one with keys that are gone."""

    robot: dict[str, Any]
    cell: CellSection
    task: TaskSection
    comfort: ComfortSection
    reward: dict[str, FiniteFloat]
    policy: str | None
    policies: dict[str, str | None] | None
    levels: list[int]


def damaged(path: Path, reason: object) -> ConfigError:
    """Return the error, in one line, that names a damaged file and what is wrong in it."""
    return ConfigError(f"{path} is damaged: {' '.join(str(reason).split())}")


def read_json(path: Path, kind: type[T]) -> T:
    """Return the content of a JSON file; raise ConfigError if the file does not exist, or is not of this kind."""
    if not path.is_file():
        raise ConfigError(f"{path} does not exist")
    try:
        return TypeAdapter(kind).validate_json(read_bytes(path))
    except ValidationError as error:
        raise damaged(path, first_error(error)) from None
    except ValueError as error:
        raise damaged(path, error) from None


def read_config(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the text of a config.yaml and its content, checked as far as `RunConfig` names it.

    Paths in the content lead to the same files from any working directory.

    Raises:
      ConfigError: it is damaged.
    """
    text, content = read_yaml(path)
    try:
        return text, dict(TypeAdapter(RunConfig).validate_python(converted(resolved(content, path.parent))))
    except ValidationError as error:
        raise damaged(path, first_error(error)) from None


def read_yaml(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the text of a YAML mapping and its content.

    Raises:
      ConfigError: it is not UTF-8, not YAML, not a mapping, too large, or has aliases, by which few lines stand for
        any number.
    """
    try:
        text = read_text(path, MOST_BYTES)
        aliases = [event for event in yaml.parse(text, yaml.CSafeLoader) if isinstance(event, yaml.AliasEvent)]
        # libyaml's limit of the depth keeps it off the end of the stack.
        content = None if aliases else yaml.load(text, yaml.CSafeLoader)
    # Of tags on other values, such as `!!int ''`, the parser lets errors of Python through.
    except (ValueError, OverflowError, RecursionError, LookupError, AttributeError, OSError, yaml.YAMLError) as error:
        raise damaged(path, error) from None
    if aliases:
        raise damaged(path, f"line {aliases[0].start_mark.line + 1} has an alias, *{aliases[0].anchor}")
    if not isinstance(content, dict):
        raise damaged(path, f"it holds a {type(content).__name__}, not a mapping")
    if again := _given_again(yaml.compose(text, yaml.CSafeLoader)):
        raise damaged(path, f"line {again.start_mark.line + 1} gives {again.value} again")
    return text, content


def _given_again(node: yaml.Node) -> yaml.ScalarNode | None:
    """Return the first key that a mapping in `node` has twice, whose earlier value would be lost without a word."""
    if isinstance(node, yaml.SequenceNode):
        return next(filter(None, map(_given_again, node.value)), None)
    if not isinstance(node, yaml.MappingNode):
        return None
    names: set[str] = set()
    for key, value in node.value:
        if isinstance(key, yaml.ScalarNode):
            if key.value in names:
                return key
            names.add(key.value)
        if found := _given_again(value):
            return found
    return None
