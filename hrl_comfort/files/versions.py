"""Configurations that another version of the program wrote, in config.yaml and in policy.pt, as this one has them.

Files are never rewritten: what differs is settled in reading. A key that has come since takes its value in BEFORE, or
else its default in conf/ for the task, the robot and the people of the file. So a new key whose default changes what
older runs do needs an entry in BEFORE. A key that is gone is refused, unless it had its value in GONE, which did
nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

from hrl_comfort.config.checks import UnknownKeyError

BEFORE: dict[str, Any] = {}
"""Value, by dotted key, that does what was done before the key came; where it is the default of conf/, none."""
GONE: dict[str, Any] = {"reward.human_collision": 0.0}
"""Value, by dotted key, with which a key that is gone did nothing."""


def of_this_version(
    cls: type, values: Mapping[str, Any], defaults: Callable[[], Mapping[str, Any]], section: str = ""
) -> dict[str, Any]:
    """Return `values` with exactly the keys of the dataclass `cls`, in its sections too.

    Args:
      cls: the dataclass.
      values: what a file holds.
      defaults: returns the values of conf/ for `cls`; called if a key is missing.
      section: the dotted key of `values`.

    Raises:
      UnknownKeyError: there is a key that this version does not have.
    """
    before = f"{section}." if section else ""
    hints = get_type_hints(cls)
    for key in values.keys() - hints.keys():
        if f"{before}{key}" not in GONE or values[key] != GONE[f"{before}{key}"]:
            raise UnknownKeyError(
                f"{before}{key} is not a key of this version, which cannot do what it did; use the version whose "
                "commit is in provenance.json, or train again",
                f"{before}{key}",
            )
    found = {}
    for key, kind in hints.items():
        if key not in values:
            found[key] = BEFORE[f"{before}{key}"] if f"{before}{key}" in BEFORE else defaults()[key]
        elif isinstance(kind, type) and dataclasses.is_dataclass(kind) and isinstance(values[key], Mapping):
            inside = lambda key=key: defaults()[key]  # noqa: E731
            found[key] = of_this_version(kind, values[key], inside, f"{before}{key}")
        else:
            found[key] = values[key]
    return found
