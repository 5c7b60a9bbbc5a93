"""Checks of configuration values; every failure is a ConfigError of one line."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar, get_type_hints

T = TypeVar("T")
MAX_LINE = 1000
"""Longest message in characters, without the ellipsis."""
FARTHEST = 1000.0
"""Largest coordinate, m, and angle, degrees; squares of larger values may overflow."""
Check = Callable[[str, Any], None]
"""(key, value): raises ConfigError if the value is not allowed."""


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


def filled(key: str, value: object) -> None:
    """Raise ConfigError if `value` is an empty text."""
    if value == "":
        raise ConfigError(f"{key}='' is empty; it takes a value")


def one_of(key: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {', '.join(allowed)}")


def between(key: str, value: float, low: float, high: float) -> None:
    """Raise ConfigError unless `value` is in [low, high]; NaN is not."""
    if not low <= value <= high:
        raise ConfigError(f"{key}={value!r} is outside its range [{low:g}, {high:g}]")


def widths(key: str, value: list[int]) -> None:
    """Raise ConfigError unless `value` is a list of hidden-layer widths."""
    if not value or any(not 1 <= width <= 8192 for width in value):
        raise ConfigError(f"{key}={list(value)!r} must be layer widths from 1 to 8192")


def point(key: str, value: list[float], size: int, farthest: float = FARTHEST) -> None:
    """Raise ConfigError unless `value` is `size` numbers within ±`farthest`."""
    if len(value) != size or not all(abs(v) <= farthest for v in value):
        raise ConfigError(f"{key}={list(value)!r} must be {size} finite numbers within ±{farthest:g}")


def unique(key: str, value: list[int]) -> None:
    """Raise ConfigError if `value` contains an entry twice."""
    if len(set(value)) < len(value):
        raise ConfigError(f"{key}={list(value)!r} contains an entry twice; leave one out")


def within(low: float, high: float) -> Check:
    """Return the check `between` of [low, high]."""
    return partial(between, low=low, high=high)


def choice(*names: str) -> Check:
    """Return the check `one_of` of `names`."""
    return partial(one_of, allowed=names)


def coordinates(size: int) -> Check:
    """Return the check `point` of `size` numbers."""
    return partial(point, size=size)


def each(check: Check) -> Check:
    """Return `check` for every entry of a list."""

    def entries(key: str, value: list[Any]) -> None:
        for index, entry in enumerate(value):
            check(f"{key}[{index}]", entry)

    return entries


def is_object(value: str) -> bool:
    """Return whether `value` has the form `package.module:name`."""
    return re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*", value) is not None


def import_object(key: str, value: str) -> Any:
    """Return the Python object `package.module:name`; modules of the working directory come last.

    Raises:
      ConfigError: there is no such module, it imports what is not installed, or it has no such name.
    """
    module, name = value.split(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found = import_module(module)
    except ImportError as error:
        raise ConfigError(f"{key}={value!r} cannot be imported: {error}") from error
    if not hasattr(found, name):
        raise ConfigError(f"{key}={value!r}: {found.__file__ or module} has no {name}")
    return getattr(found, name)


@cache
def plugins(key: str) -> dict[str, EntryPoint]:
    """Return the parts that installed packages offer for `key`: entry points of the group `hrl_comfort.KEY`."""
    return {point.name: point for point in entry_points(group=f"hrl_comfort.{key}")}


def part_name(key: str, value: str, known: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `known` or of `plugins`, or has the form `package.module:name`."""
    if value not in known and value not in plugins(key) and not is_object(value):
        names = ", ".join([*known, *plugins(key)])
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {names}, or package.module:name")


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


def named(*known: str) -> Check:
    """Return the check `part_name` of `known`."""
    return partial(part_name, known=known)


def check_fields(section: str, config: Any) -> None:
    """Run the checks in the `Annotated` types of a dataclass; null passes.

    Raises:
      ConfigError: a check of the field `section`.name fails.
    """
    for name, hint in get_type_hints(type(config), include_extras=True).items():
        value = getattr(config, name)
        for check in getattr(hint, "__metadata__", ()) if value is not None else ():
            check(f"{section}.{name}" if section else name, value)
