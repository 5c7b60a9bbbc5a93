"""Frozen dataclasses as OmegaConf nodes that check types, and back."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from hrl_comfort.config.checks import ConfigError, filled
from hrl_comfort.config.overrides import ROOTS

T = TypeVar("T")


def schema(cls: Any) -> Any:
    """Return a mutable twin of the frozen dataclass `cls`: OmegaConf cannot merge into a frozen one.

    The twin is an attribute of this module, so that other processes can unpickle it.
    """
    name = f"{cls.__name__}Schema"
    if name not in globals():
        hints = get_type_hints(cls)
        twins = [(field.name, _twin(hints[field.name]), _default(field)) for field in dataclasses.fields(cls)]
        globals()[name] = twin = dataclasses.make_dataclass(name, twins)
        twin.__module__ = __name__
    return globals()[name]


def _twin(hint: Any) -> Any:
    if listed := _listed_class(hint):
        return list[schema(listed)]  # type: ignore[misc]
    if get_origin(hint) is list and get_origin(get_args(hint)[0]) is list:
        return list[Any]  # OmegaConf refuses whole numbers in list[list[float]]; `_check_entries` has the types
    return schema(hint) if dataclasses.is_dataclass(hint) else hint


def _default(field: dataclasses.Field) -> Any:
    return dataclasses.field(default=field.default, default_factory=field.default_factory)  # type: ignore[call-overload]


def _listed_class(hint: Any) -> Any:
    """Return the dataclass that `hint` is a list of, if it is one."""
    kind = get_args(hint)[0] if get_origin(hint) is list else None
    return kind if dataclasses.is_dataclass(kind) else None


def freeze(cls: type[T], node: Any) -> T:
    """Return the dataclass `cls` for `node`; raise ConfigError if a value is missing or not allowed."""
    missing = sorted(OmegaConf.missing_keys(node))
    if missing:
        raise ConfigError(f"{missing[0]} must be set: {missing[0]}=VALUE")
    frozen: T = _frozen(cls, OmegaConf.to_container(node, resolve=True))
    return frozen


def _frozen(cls: Any, tree: Any, prefix: str = "") -> Any:
    values = {}
    for name, hint in get_type_hints(cls).items():
        key, value = prefix + name, tree[name]
        if dataclasses.is_dataclass(hint):
            values[name] = _frozen(hint, value, f"{key}.")
        elif listed := _listed_class(hint):
            values[name] = [_frozen(listed, entry, f"{key}.{i}.") for i, entry in enumerate(value)]
        else:
            _check_entries(key, value, hint)
            values[name] = value
    return cls(**values)


def _check_entries(key: str, value: Any, hint: Any) -> None:
    """Raise ConfigError at empty texts and at misplaced lists and dicts, which OmegaConf accepts."""
    filled(key, value)
    if get_origin(hint) not in (list, dict):
        return
    kind = get_args(hint)[-1]
    if kind is Any:
        return
    for name, entry in value.items() if isinstance(value, dict) else enumerate(value):
        if not _fits(entry, kind):
            wanted = getattr(kind, "__name__", kind)
            raise ConfigError(f"{key}={value!r} holds {entry!r}, which is not of type {wanted}")
        _check_entries(f"{key}.{name}" if isinstance(value, dict) else f"{key}[{name}]", entry, kind)


def _fits(entry: Any, kind: Any) -> bool:
    if kind is float:
        return isinstance(entry, (int, float)) and not isinstance(entry, bool)
    return not isinstance(entry, dict) and isinstance(entry, list) is (get_origin(kind) is list)


for _root, _cls in ROOTS.items():
    ConfigStore.instance().store(f"{_root}_schema", schema(_cls))
