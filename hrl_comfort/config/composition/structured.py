"""Frozen dataclasses from the trees that Hydra composes, checked by pydantic."""

from __future__ import annotations

import json
from functools import cache
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import MissingMandatoryValue
from pydantic import TypeAdapter, ValidationError

from hrl_comfort.config.checks import ConfigError, first_error

T = TypeVar("T")
adapter = cache(TypeAdapter)
EXACT = 2.0**53
"""Below it a float holds every whole number."""


def freeze(cls: type[T], node: Any) -> T:
    """Return the dataclass `cls` for `node`; raise ConfigError if a value is missing or not allowed."""
    try:
        return section(cls, OmegaConf.to_container(node, resolve=True, throw_on_missing=True))
    except MissingMandatoryValue:
        raise ConfigError(f"{min(OmegaConf.missing_keys(node))} must be set") from None


def section(cls: type[T], values: Any) -> T:
    """Return the dataclass `cls` for plain `values`; raise ConfigError if one is missing or not allowed."""
    # As JSON, for pydantic's strict mode takes a dict for a dataclass only from there.
    text = json.dumps(_whole(values), default=repr)
    try:
        frozen: T = adapter(cls).validate_json(text, strict=True)  # type: ignore[arg-type]
    except ValidationError as error:
        raise ConfigError(first_error(error)) from None
    return frozen


def _whole(value: Any) -> Any:
    """Return `value` with whole numbers as integers: 1e4 is one, and a float's field takes integers too."""
    match value:
        case dict():
            return {key: _whole(each) for key, each in value.items()}
        case list():
            return [_whole(each) for each in value]
        case float() if value.is_integer() and abs(value) < EXACT:
            return int(value)
    return value
