"""Configurations of run folders and policies: writing, and reading those of other versions."""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import OmegaConf
from yaml import YAMLError

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.config.checks import section
from hrl_comfort.config.commands import CommandConfig
from hrl_comfort.config.hydra_conf import run_folder, values_of
from hrl_comfort.config.overrides import NAMES, ROOTS, TOO_DEEP, choices, one_line, override
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.documents import read_yaml
from hrl_comfort.files.provenance import unfinished
from hrl_comfort.files.relative_paths import resolved, same, stored
from hrl_comfort.files.versions import converted, of_this_version

C = TypeVar("C", bound=CommandConfig)


def environment(config: EnvConfig) -> EnvConfig:
    """Return the sections of an environment alone."""
    return EnvConfig(**{field.name: getattr(config, field.name) for field in dataclasses.fields(EnvConfig)})


def save_config(config: CommandConfig, path: str | Path) -> None:
    """Write `config` as YAML, its paths relative to the folder of `path`; `load_config` reads an equal one."""
    write_text(Path(path), OmegaConf.to_yaml(OmegaConf.create(stored_config(config, Path(path).parent))))


def stored_config(config: CommandConfig, folder: Path) -> dict[str, Any]:
    """Return the values of `config` as a file in `folder` holds them (`files.relative_paths`)."""
    return stored(dataclasses.asdict(config), folder)


def is_same(config: CommandConfig, other: CommandConfig) -> bool:
    """Return whether two configurations differ in no more than `output` and the spelling of paths."""
    return type(config) is type(other) and same(dataclasses.asdict(config), dataclasses.asdict(other))


def yaml_of(config: CommandConfig) -> str:
    """Return `config` as YAML."""
    return OmegaConf.to_yaml(OmegaConf.create(dataclasses.asdict(config)))


def load_config(path: str | Path) -> CommandConfig:
    """Return the configuration in `path`, a config.yaml or the run folder that contains it.

    Its paths lead to the same files from any working directory, and its `output` is the folder of the file. Another
    version may have written it (`files.versions`).

    Raises:
      ConfigError: no such file, or one that is damaged or has other keys.
    """
    file = Path(path) / "config.yaml" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise ConfigError(f"{file} does not exist; a run folder holds a config.yaml")
    try:
        values = read_yaml(file)[1]
        root = _root_of(values)
        if root is not None:
            return _of_file(ROOTS[root], root, values, file.parent, file)
    except ConfigError:
        raise
    except (YAMLError, OverflowError, ValueError) as error:  # the last two at numbers of thousands of digits
        raise ConfigError(f"{file} is not YAML: {one_line(error)}") from error
    except RecursionError:
        raise ConfigError(f"{file} {TOO_DEEP}") from None
    except OSError as error:
        raise ConfigError(f"{file} cannot be read: {one_line(error)}") from error
    raise ConfigError(f"{file} does not have the keys of a {', '.join(ROOTS)} configuration")


def _root_of(values: Mapping[str, Any]) -> str | None:
    """Return the root whose keys differ least from those of `values`; None if most of them are missing."""
    nearest = min(ROOTS, key=lambda root: len(_keys(ROOTS[root]) ^ set(values)))
    return nearest if _has_most(ROOTS[nearest], values) else None


def _has_most(cls: type[CommandConfig], values: Mapping[str, Any]) -> bool:
    return 2 * len(_keys(cls) & set(values)) > len(_keys(cls))


def _keys(cls: type[CommandConfig]) -> set[str]:
    return {field.name for field in dataclasses.fields(cls)}


def _of_file(cls: type[C], root: str, values: Mapping[str, Any], folder: Path, file: Path) -> C:
    """Return the configuration `cls` of the `values` in a `file` of the run `folder`."""

    @cache
    def defaults() -> Mapping[str, Any]:
        sections = {group: values.get(group) for group in NAMES}
        named = {g: each.get(NAMES[g].split(".")[1]) for g, each in sections.items() if isinstance(each, Mapping)}
        return values_of(root, [override(group, name) for group, name in named.items() if name in choices(group)])

    try:
        return section(cls, of_this_version(cls, converted(resolved(values, folder)), defaults))
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from None


def trained_environment(source: str) -> EnvConfig | None:
    """Return the environment that the policy `source` was trained in; None if no run says so.

    A run folder's config.yaml and its policy.pt hold the same. A policy file that is alone has its own; start states
    and calibration files are where they were relative to it.

    Raises:
      ConfigError: what says so is damaged, or has keys that are gone.
    """
    folder, path = run_folder(source), Path(source)
    if folder is not None:
        config = load_config(folder)
        return environment(config) if isinstance(config, EnvConfig) else None
    file = path / "policy.pt" if path.is_dir() else path
    if file.suffix != ".pt" or not file.is_file():
        return None
    from hrl_comfort.files.state_file import load  # seconds, for torch

    try:
        spec = load(file).get("spec")
    except ConfigError:  # the policy's reader says what it is, with its key
        return None
    values = spec.get("config") if isinstance(spec, Mapping) else None
    if values is None:
        return None
    try:
        values = json.loads(json.dumps(values))
    except (TypeError, ValueError, RecursionError):
        values = None
    if not isinstance(values, Mapping) or not _has_most(EnvConfig, values):
        raise ConfigError(f"policy={str(file)!r} is damaged: its config is not that of an environment")
    home = file.parent.parent if file.parent.name == "checkpoints" else file.parent
    return _of_file(EnvConfig, "train", values, home, file)


def warn_unfinished(policy: str | None) -> None:
    """Warn if the training that `policy` belongs to is not finished."""
    folder = run_folder(policy) if policy else None
    if folder is not None and (line := unfinished(folder)):
        warnings.warn(line, stacklevel=3)
