"""Hydra's search path: its own configurations and those of `conf/`. A process reads each file once."""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from pathlib import Path

import hydra.conf
from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.plugins import Plugins
from hydra.core.utils import setup_globals
from hydra.plugins.config_source import ConfigResult

from hrl_comfort.config.overrides import config_dir


class ReadOnce(FileConfigSource):
    """A folder of configurations, read once: Hydra's own source reads it again for every composition."""

    @staticmethod
    def scheme() -> str:
        """Return what its paths begin with."""
        return "once"

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the configuration, and the header of its file, in copies of their own."""
        return deepcopy(_read(self.provider, self.path, config_path))


@lru_cache
def _read(provider: str, folder: str, name: str) -> ConfigResult:
    return FileConfigSource(provider, folder).load_config(name)


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
