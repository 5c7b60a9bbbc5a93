"""What is checked of a choice; every mistake is a ConfigError of one line."""

from __future__ import annotations

LONGEST_LINE = 1000
"""Of a message; a value may be a whole file by mistake."""
FARTHEST = 1000.0
"""Of a coordinate in m and an angle in degrees; farther is a mistake, and squares of it may overflow."""


class ConfigError(ValueError):
    """A choice that is not allowed; the message names the key, its value and what is allowed.

    It is one line that can be read, whatever the value is: what cannot be printed is escaped, and of what is
    too long the middle, which is the value's, is left out.
    """

    def __init__(self, message: str) -> None:
        line = "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in message)
        half = LONGEST_LINE // 2
        super().__init__(line if len(line) <= LONGEST_LINE else f"{line[:half]} … {line[-half:]}")


def filled(key: str, value: object) -> None:
    """Raise ConfigError where `value` is an empty text, which names nothing."""
    if value == "":
        raise ConfigError(f"{key}='' is empty; it takes a value")


def one_of(key: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {', '.join(allowed)}")


def between(key: str, value: float, low: float, high: float) -> None:
    """Raise ConfigError unless `value` is in [low, high], which are finite; NaN is in no range."""
    if not low <= value <= high:
        raise ConfigError(f"{key}={value!r} is outside its range [{low:g}, {high:g}]")


def widths(key: str, value: list[int]) -> None:
    """Raise ConfigError unless `value` is widths of hidden layers."""
    if not value or any(not 1 <= width <= 8192 for width in value):
        raise ConfigError(f"{key}={list(value)!r} must be layer widths from 1 to 8192")


def point(key: str, value: list[float], size: int, farthest: float = FARTHEST) -> None:
    """Raise ConfigError unless `value` is `size` numbers within ±`farthest`."""
    if len(value) != size or not all(abs(v) <= farthest for v in value):
        raise ConfigError(f"{key}={list(value)!r} must be {size} finite numbers within ±{farthest:g}")
