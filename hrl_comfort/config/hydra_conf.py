"""Hydra over `conf/`, and the frozen dataclasses that pydantic makes of the trees that it composes."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue

from hrl_comfort.config import HIERARCHY
from hrl_comfort.config.checks import ConfigError, section
from hrl_comfort.config.overrides import config_dir, parse

T = TypeVar("T")
ALONE = threading.RLock()
"""Hydra composes in one thread at a time."""


def composed(root: str, known: Iterable[str]) -> DictConfig:
    """Return what Hydra makes of `conf/ROOT.yaml` and overrides from `check_overrides`.

    Hydra composes equal choices once a process, which takes a tenth of a second. Values are set in a copy, in order, as
    Hydra does it; with a value that is added (`+`) or deleted (`~`) Hydra composes all of them.
    """
    with ALONE:
        parsed = [parse(line) for line in known]
        values = [each for each in parsed if not _is_choice(each)]
        if any(each.is_add() or each.is_delete() for each in values):
            values = []
        whole = _composed(root, tuple(str(each.input_line) for each in parsed if each not in values))
        node = deepcopy(whole)  # a copy resolves `${now:}` anew
        for each in values:
            OmegaConf.update(node, each.key_or_group, each.value(), force_add=each.is_force_add())
        return node


def values_of(root: str, known: Iterable[str] = ()) -> dict[str, Any]:
    """Return what `composed` returns as plain values."""
    values = OmegaConf.to_container(composed(root, known), resolve=True)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items()}


def _is_choice(asked: Override) -> bool:
    """Return whether Hydra needs the override for its list of defaults, or for itself."""
    key = asked.key_or_group
    return re.split("[./]", key)[0] == "hydra" or asked.package is not None or (config_dir() / key).is_dir()


@lru_cache(maxsize=256)
def _composed(root: str, known: tuple[str, ...]) -> DictConfig:
    with hydra_over_conf():
        return hydra.compose(root, list(known))


@contextmanager
def hydra_over_conf() -> Iterator[GlobalHydra]:
    """Yield Hydra's global state, initialised over `conf/`; afterwards it is that of the program around this one."""
    state = GlobalHydra.instance()
    outer, state.hydra = state.hydra, None
    try:
        hydra.initialize_config_dir(str(config_dir()), "hrl-comfort", version_base="1.3")
        yield state
    finally:
        state.hydra = outer


def freeze(cls: type[T], node: Any) -> T:
    """Return the dataclass `cls` for `node`; raise ConfigError if a value is missing or not allowed."""
    try:
        return section(cls, OmegaConf.to_container(node, resolve=True, throw_on_missing=True))
    except MissingMandatoryValue:
        raise ConfigError(f"{min(OmegaConf.missing_keys(node))} must be set") from None


def run_folder(policy: str) -> Path | None:
    """Return the run folder of `policy` (folder, policy file or checkpoint), or None."""
    path = Path(policy)
    candidates = (path, path.parent, path.parent.parent) if path.is_file() else (path,)
    return next((folder for folder in candidates if (folder / "config.yaml").is_file()), None)


def _evaluation_folder(policy: str | None, task: str, split: str, policies: Mapping[str, str]) -> str:
    suffix = "" if split == "paper" else f"_{split}"
    folder = run_folder(policy) if policy else None
    parents = {run and run.parent for run in map(run_folder, map(str, policies.values()))}
    if len(parents) == 1 and (parent := parents.pop()) and (parent / HIERARCHY).is_file():
        folder = parent / task
    if folder:
        return str(folder / f"eval{suffix}")
    name = re.sub(r"\W+", "_", re.sub(r"\.(pt|zip)$", "", Path(policy).name)) if policy else "chain"
    return f"runs/evaluate/{task}/{name}{suffix}"


OmegaConf.register_new_resolver("evaluation_folder", _evaluation_folder, replace=True)
OmegaConf.register_new_resolver("absolute", os.path.abspath, replace=True)
OmegaConf.register_new_resolver("count", len, replace=True)
