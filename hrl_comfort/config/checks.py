"""What is checked of a choice; every mistake is a ConfigError of one line."""

from __future__ import annotations

import math


class ConfigError(ValueError):
    """A choice that is not allowed; the message names the key, its value and what is allowed."""


def one_of(key: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ConfigError(f"{key}={value!r} is not allowed; choose one of {', '.join(allowed)}")


def between(key: str, value: float, low: float, high: float) -> None:
    """Raise ConfigError unless `value` is finite and in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise ConfigError(f"{key}={value!r} is outside its range [{low:g}, {high:g}]")


def widths(key: str, value: list[int]) -> None:
    """Raise ConfigError unless `value` is widths of hidden layers."""
    if not value or any(not 1 <= width <= 8192 for width in value):
        raise ConfigError(f"{key}={list(value)!r} must be layer widths from 1 to 8192")


def point(key: str, value: list[float], size: int) -> None:
    """Raise ConfigError unless `value` is `size` finite numbers."""
    if len(value) != size or not all(math.isfinite(v) for v in value):
        raise ConfigError(f"{key}={list(value)!r} must be {size} finite numbers")
