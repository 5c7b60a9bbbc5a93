"""Hydra's search path: its own configurations and those of `conf/`. A process reads each file once."""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import hydra.conf
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.core.utils import setup_globals
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import OmegaConf

from hrl_comfort.config.overrides import config_dir


class ReadOnce(ConfigSource):
    """A folder of configurations, read once: Hydra's own source reads it again for every composition."""

    @staticmethod
    def scheme() -> str:
        """Return what its paths begin with."""
        return "once"

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the configuration, and the header of its file, in copies of their own."""
        return deepcopy(_read(self.provider, self.path, self._normalize_file_name(config_path)))

    def is_group(self, config_path: str) -> bool:
        """Return whether it is a folder here."""
        return Path(self.path, config_path).is_dir()

    def is_config(self, config_path: str) -> bool:
        """Return whether it is a file here."""
        return Path(self.path, self._normalize_file_name(config_path)).is_file()

    def available(self) -> bool:
        """Return whether the folder is there."""
        return self.is_group("")

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Return the groups and configurations in a group."""
        found: list[str] = []
        for each in sorted(Path(self.path, config_path).iterdir()):
            self._list_add_result(found, str(Path(config_path, each.name)), each.name, results_filter)
        return found


@lru_cache
def _read(provider: str, folder: str, name: str) -> ConfigResult:
    text = Path(folder, name).read_text(encoding="utf-8")
    header = ConfigSource._get_header_dict(text)
    return ConfigResult(provider, f"{ReadOnce.scheme()}://{folder}", OmegaConf.create(text), header)


def search_path() -> ConfigSearchPath:
    """Return Hydra's search path: its own configurations, `conf/`, and what plugins add."""
    found = create_config_search_path(str(config_dir()))
    folders = {"hydra": Path(hydra.conf.__file__).parent, "main": config_dir()}
    for each in found.get_path():
        if each.provider in folders:
            each.path = f"{ReadOnce.scheme()}://{folders[each.provider]}"
    return found


setup_globals()  # the resolver of `${now:}`
Plugins.instance().register(ReadOnce)
