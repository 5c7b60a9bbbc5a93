"""Drafts: a configuration under change, as overrides that give it on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from operator import attrgetter
from threading import Lock
from typing import Any

from omegaconf import OmegaConf

from hrl_comfort.composition.compose import compose, compose_environment, plain_value
from hrl_comfort.composition.stages import flat
from hrl_comfort.config import EnvConfig
from hrl_comfort.config.hydra_conf import values_of
from hrl_comfort.config.overrides import NAMES, choices, groups, override
from hrl_comfort.files.run_config import environment


def overrides_of(root: str, config: EnvConfig) -> dict[str, str]:
    """Return the overrides, by key, with which `root` has the values of `config` in the keys that both have."""
    fields = groups(root).keys() | {"policy", "policies"}
    values = {name: value for name, value in asdict(config).items() if name in fields}
    cell = _cell_lines(root, config) if values.pop("cell", None) else {}
    chosen = {group: str(attrgetter(key)(config)) for group, key in NAMES.items() if group in values}
    lines = {group: f"{group}={name}" for group, name in chosen.items() if name in choices(group)}
    default, plainest = dict(flat(values_of(root, lines.values()))), dict(flat(values_of(root)))
    lines = {group: line for group, line in lines.items() if plainest[NAMES[group]] != chosen[group]}
    return lines | cell | {key: override(key, value) for key, value in flat(values) if default.get(key) != value}


def _cell_lines(root: str, config: EnvConfig) -> dict[str, str]:
    """Return the overrides of a cell: of a built-in one its choice, of another the parts in which it differs."""
    usual = compose_environment(root, []).cell
    if config.cell == usual:
        return {}
    for name in choices("cell"):
        if compose_environment(root, [f"cell={name}"]).cell == config.cell:
            return {"cell": f"cell={name}"}
    parts = {key: value for key, value in asdict(config.cell).items() if value != asdict(usual)[key]}
    return {f"cell.{key}": override(f"cell.{key}", value).lstrip("+") for key, value in parts.items()}


class Draft:
    """A configuration of `root` under change.

    Args:
      root: key of `config.overrides.ROOTS`.
      lines: overrides to begin with, by key.
    """

    def __init__(self, root: str, lines: Mapping[str, str]) -> None:
        self.root, self.lines, self._first = root, dict(lines), dict(lines)
        self.config = compose(root, self.lines.values())
        self._lock = Lock()

    @property
    def changed(self) -> dict[str, str]:
        """Overrides that were not there at the beginning, by key."""
        return {key: line for key, line in self.lines.items() if self._first.get(key) != line}

    def set(self, key: str, text: str) -> None:
        """Set a key or choose a file of a group, as on the command line; several threads may do so.

        A choice drops what was changed in its section.

        Raises:
          ConfigError: it is not allowed; the draft stays as it was.
        """
        with self._lock:
            lines = {each: line for each, line in self.lines.items() if each != key and not each.startswith(f"{key}.")}
            lines[key] = f"{key}={text}"
            self.config = compose(self.root, lines.values())
            self.lines = lines

    def value(self, key: str) -> Any:
        """Return the value of a key."""
        return attrgetter(key)(self.config)


def training_overrides(studio: Draft, training: Draft) -> dict[str, str]:
    """Return the overrides of `hrl-comfort train` for the cell of one draft and the learner of another, by key."""
    assert isinstance(studio.config, EnvConfig)
    return overrides_of("train", environment(studio.config)) | training.lines


def overlay(lines: Mapping[str, str]) -> str:
    """Return the overrides of a training as an overlay for `conf/experiment/`."""
    config = compose("train", lines.values())
    chosen = [key for key in lines if key in groups("train")]
    node: dict[str, Any] = {"defaults": [{f"override /{key}": lines[key].partition("=")[2]} for key in chosen]}
    made = OmegaConf.create(node if chosen else {})
    for key in (each for each in lines if each not in chosen):
        OmegaConf.update(made, key, plain_value(attrgetter(key)(config)))
    return f"# @package _global_\n# Made by hrl-comfort studio.\n{OmegaConf.to_yaml(made)}"
