"""Checks of configuration values; every failure is a ConfigError of one line."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import signature
from numbers import Real
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

T = TypeVar("T")
adapter = cache(TypeAdapter)
EXACT = 2.0**53
"""Below it a float holds every whole number."""
MAX_LINE = 1000
"""Longest message in characters, without the ellipsis."""
FARTHEST = 1000.0
"""Largest coordinate, m, and angle, degrees; squares of larger values may overflow."""


class ConfigError(ValueError):
    """A value that is not allowed; the message names the key, the value and the allowed values.

    The message is one printable line: other characters are escaped, and the middle of a long line is omitted.
    """

    def __init__(self, message: str) -> None:
        line = "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in message)
        half = MAX_LINE // 2
        super().__init__(line if len(line) <= MAX_LINE else f"{line[:half]} … {line[-half:]}")


class UnknownKeyError(ConfigError):
    """A `key` that the configuration does not have."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


def one_of(key: str, value: str, names: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `names`."""
    if value not in names:
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {', '.join(names)}")


def between(key: str, value: float, low: float, high: float) -> None:
    """Raise ConfigError unless `value` is a number in [low, high]; NaN is not."""
    if isinstance(value, bool) or not isinstance(value, Real) or not low <= value <= high:
        raise ConfigError(f"{key}={value!r} is outside its range [{low:g}, {high:g}]")


def _passed(value: Any, check: Callable[..., None], key: str = "", **allowed: Any) -> Any:
    """Return a field's value; raise the ConfigError of `check` for one that is not allowed."""
    check(key, value, **allowed)
    return value


def _unique(value: list[Any]) -> list[Any]:
    if len(set(value)) < len(value):
        raise ConfigError(f"={value!r} contains an entry twice; leave one out")
    return value


def within(low: float, high: float) -> AfterValidator:
    """Return the check of a field that its value is in [low, high]."""
    return AfterValidator(partial(_passed, check=between, low=low, high=high))


def choice(*names: str) -> AfterValidator:
    """Return the check of a field that its value is one of `names`."""
    return AfterValidator(partial(_passed, check=one_of, names=names))


def choice_of(*numbers: int) -> AfterValidator:
    """Return the check of a field that its value is one of `numbers`."""
    return AfterValidator(partial(_passed, check=_one_number, numbers=numbers))


def _one_number(key: str, value: int, numbers: tuple[int, ...]) -> None:
    if value not in numbers:
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {', '.join(map(str, numbers))}")


def _plain_name(value: str) -> str:
    if re.fullmatch(r"[A-Za-z_]\w*", value, re.ASCII) is None:
        raise ConfigError(f"={value!r} is not a name; it takes letters, digits and _, and begins with no digit")
    return value


Name = Annotated[str, AfterValidator(_plain_name)]
"""Name of a part of a cell."""
unique = AfterValidator(_unique)
"""Check of a list that no entry is in it twice."""
Coordinate = Annotated[float, within(-FARTHEST, FARTHEST)]
XY = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
XYZ = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
Widths = Annotated[list[Annotated[int, within(1, 8192)]], Field(min_length=1, max_length=64)]
"""Widths of hidden layers."""


def is_object(value: str) -> bool:
    """Return whether `value` has the form `package.module:name`."""
    return re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*", value) is not None


def import_object(key: str, value: str) -> Any:
    """Return the Python object `package.module:name`; modules of the working directory come last.

    Raises:
      ConfigError: there is no such module, it fails on import, or it has no such name.
    """
    module, name = value.split(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found = import_module(module)
    except ConfigError:
        raise
    except Exception as error:
        reason = str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise ConfigError(f"{key}={value!r} cannot be imported: {reason}") from error
    if not hasattr(found, name):
        raise ConfigError(f"{key}={value!r}: {found.__file__ or module} has no {name}")
    return getattr(found, name)


@cache
def plugins(key: str) -> dict[str, EntryPoint]:
    """Return the parts that installed packages offer for `key`: entry points of the group `hrl_comfort.KEY`."""
    return {point.name: point for point in entry_points(group=f"hrl_comfort.{key}")}


def part_name(key: str, value: str, names: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `names` or of `plugins`, or has the form `package.module:name`."""
    if value not in names and value not in plugins(key) and not is_object(value):
        known = f"one of {', '.join(each)}, or " if (each := [*names, *plugins(key)]) else ""
        raise ConfigError(f"{key}={value!r} is not allowed; choose {known}package.module:name")


def part(key: str, name: str, known: Mapping[str, T]) -> T:
    """Return the part `name`: one of `known` or of `plugins`, or the object `package.module:name`.

    Raises:
      ConfigError: there is no such part.
    """
    part_name(key, name, tuple(known))
    if name in known:
        return known[name]
    found: T = plugins(key)[name].load() if name in plugins(key) else import_object(key, name)
    return found


def function(key: str, name: str, known: Mapping[str, T]) -> T:
    """Return the function `name` as `part` does; raise ConfigError also if it cannot be called."""
    found = part(key, name, known)
    if not callable(found):
        raise ConfigError(f"{key}={name!r} is of type {type(found).__name__}; it must be a function")
    return found


def takes(key: str, function: Any, arguments: str) -> None:
    """Raise ConfigError unless a function can be called with `arguments`, names with commas; builtins do not say."""
    try:
        found = signature(function)
    except ValueError:
        return
    except TypeError:
        raise ConfigError(f"{key} is of type {type(function).__name__}; it must be a function of {arguments}") from None
    try:
        found.bind(*arguments.split(", "))
    except TypeError as error:
        raise ConfigError(f"{key} must be a function of {arguments}; its own are {found}: {error}") from None


def implemented(names: tuple[str, ...], parts: Mapping[str, T]) -> dict[str, T]:
    """Return the registry of `names`, those that the configuration allows: `parts`, in that order.

    A package fills its registries with it when it is imported.

    Raises:
      LookupError: a name has no part, or a part has no name.
    """
    if odd := set(names) ^ set(parts):
        raise LookupError(f"{', '.join(sorted(odd))}: the configuration allows {', '.join(names)}")
    return {name: parts[name] for name in names}


def named(key: str, *known: str) -> AfterValidator:
    """Return the check `part_name` of the field `key`."""
    return AfterValidator(partial(_passed, check=part_name, key=key, names=known))


def first_error(error: ValidationError) -> str:
    """Return the first error of pydantic with its place and value, on one line."""
    first = error.errors(include_url=False)[0]
    key, own = ".".join(map(str, first["loc"])), first.get("ctx", {}).get("error")
    if own is not None:  # our own checks of a field begin with `=`, those of several fields with a key
        return f"{key}{own}" if str(own).startswith("=") else str(own)
    if first["type"] == "missing":
        return f"{key} must be set"
    if first["type"] == "string_too_short":
        return f"{key}='' is empty; it takes a value"
    if first["type"] == "too_short":
        return f"{key}={first['input']!r:.200} must name at least {first['ctx']['min_length']}"
    return f"{key}={first['input']!r:.200}: {first['msg']}" if key else first["msg"]


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


def own_keys(key: str, name: str, cls: type[T], values: Mapping[str, Any]) -> T:
    """Return the dataclass `cls` of the own keys of `KEY.name`, given as `KEY.own`; others have their defaults.

    Raises:
      ConfigError: the part has no such key, or a value is not allowed.
    """
    known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for each in values:
        if each not in known:
            has = ", ".join(f"{key}.own.{one}" for one in known) or "none of its own"
            raise ConfigError(f"{key}.own.{each} is not a key; {key}.name={name} has {has}")
    try:
        return section(cls, dict(values))
    except ConfigError as error:
        raise ConfigError(f"{key}.own.{error}") from None
