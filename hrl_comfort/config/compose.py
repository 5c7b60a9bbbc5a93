"""Composition, loading and saving of configurations: `conf/*.yaml` and overrides to frozen dataclasses."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.config.checks import filled
from hrl_comfort.config.overrides import ROOTS, TOO_DEEP, Config, check_overrides, config_dir, one_line, override
from hrl_comfort.files.atomic import write_text

AS_TRAINED: dict[str, tuple[str, ...]] = {
    "evaluate": tuple(field.name for field in dataclasses.fields(EnvConfig) if field.name != "engine"),
    "train_meta_controller": ("robot", "cell", "human"),
}
"""Sections that take their defaults from the run of the given policy, by root."""
T = TypeVar("T")


def compose(root: str, overrides: Iterable[str] = ()) -> Config:
    """Return the configuration `root` with Hydra `overrides`.

    With a policy that belongs to a run, the sections AS_TRAINED default to those of the run. Overrides win.

    Raises:
      ConfigError: an unknown key or choice, or a value that is not allowed.
    """
    known = check_overrides(root, overrides)
    try:
        if root in AS_TRAINED:
            known = [*_as_trained(known, AS_TRAINED[root]), *known]
        with initialize_config_dir(str(config_dir()), version_base="1.3", job_name="hrl-comfort"):
            return _freeze(ROOTS[root], hydra_compose(root, known))
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(one_line(error)) from error
    except RecursionError:
        raise ConfigError(f"{' '.join(known)} {TOO_DEEP}") from None
    except OverflowError as error:
        raise ConfigError(f"{' '.join(known)}: {one_line(error)}") from None


def environment(config: EnvConfig) -> EnvConfig:
    """Return the sections of an environment alone."""
    return EnvConfig(**{field.name: getattr(config, field.name) for field in dataclasses.fields(EnvConfig)})


def save_config(config: Config, path: str | Path) -> None:
    """Write `config` as YAML; `load_config` reads an equal one."""
    write_text(Path(path), OmegaConf.to_yaml(OmegaConf.create(dataclasses.asdict(config))))


def load_config(path: str | Path) -> Config:
    """Return the configuration in `path`, a config.yaml or the run folder that contains it.

    Raises:
      ConfigError: no such file, or one that is damaged or has other keys.
    """
    file = Path(path) / "config.yaml" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise ConfigError(f"{file} does not exist; a run folder holds a config.yaml")
    try:
        loaded = OmegaConf.load(file)
        for cls in ROOTS.values():
            if isinstance(loaded, DictConfig) and set(loaded) == {f.name for f in dataclasses.fields(cls)}:
                return _freeze(cls, OmegaConf.merge(OmegaConf.structured(_schema(cls)), loaded))
    except OmegaConfBaseException as error:
        raise ConfigError(f"{file}: {one_line(error)}") from error
    except ConfigError:
        raise
    except (YAMLError, OverflowError, ValueError) as error:  # the last two at numbers of thousands of digits
        raise ConfigError(f"{file} is not YAML: {one_line(error)}") from error
    except RecursionError:
        raise ConfigError(f"{file} {TOO_DEEP}") from None
    except OSError as error:  # raised by OmegaConf also for a file with a single number or word
        raise ConfigError(f"{file} cannot be read: {one_line(error)}") from error
    raise ConfigError(f"{file} does not have the keys of a {', '.join(ROOTS)} configuration")


def _as_trained(overrides: list[str], sections: Iterable[str]) -> list[str]:
    """Return overrides that set `sections` as in the run of the given policy, the first that has a run.

    For a group chosen in `overrides`, keys that any file of the group sets are left out.
    """
    parsed = {o.key_or_group: o.value() for o in OverridesParser.create().parse_overrides(overrides)}
    given = {key: value for key, value in parsed.items() if key.split(".")[0] in ("policy", "policies")}
    # The environment of a learned controller comes before those of its skills.
    sources = [value for key, value in sorted(given.items(), key=lambda item: item[0] != "policies.meta_controller")]
    folder = next((found for source in sources if (found := run_folder(str(source)))), None)
    if folder is None:
        return []
    run, trained = load_config(folder), []
    for section in sections:
        stated = set()
        if section in parsed:
            files = (config_dir() / section).glob("[!_]*.yaml")
            stated = {str(key) for file in files for key in OmegaConf.load(file)}
        for key, value in _leaves(section, dataclasses.asdict(getattr(run, section))):
            if key.split(".")[1] not in stated:
                trained.append(override(key, value))
    return trained


def _leaves(key: str, tree: dict[str, Any]) -> Iterator[tuple[str, object]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(f"{key}.{name}", value)
        else:
            yield f"{key}.{name}", value


def run_folder(policy: str) -> Path | None:
    """Return the run folder of `policy` (folder, policy file or checkpoint), or None."""
    path = Path(policy)
    candidates = (path, path.parent, path.parent.parent) if path.is_file() else (path,)
    return next((folder for folder in candidates if (folder / "config.yaml").is_file()), None)


def _evaluation_folder(policy: str | None, task: str) -> str:
    folder = run_folder(policy) if policy else None
    if folder:
        return str(folder / "eval")
    return f"runs/evaluate/{task}/{Path(policy).stem if policy else 'chain'}"


def _schema(cls: Any) -> Any:
    """Return a mutable twin of the frozen dataclass `cls`: OmegaConf cannot merge into a frozen one.

    The twin is an attribute of this module, so that other processes can unpickle it.
    """
    name = f"{cls.__name__}Schema"
    if name not in globals():
        hints = get_type_hints(cls)
        twins = [(key, _schema(t) if dataclasses.is_dataclass(t) else t) for key, t in hints.items()]
        globals()[name] = twin = dataclasses.make_dataclass(name, twins)
        twin.__module__ = __name__
    return globals()[name]


def _freeze(cls: type[T], node: Any) -> T:
    """Return the dataclass `cls` for `node`; raise ConfigError if a value is missing or not allowed."""
    missing = sorted(OmegaConf.missing_keys(node))
    if missing:
        raise ConfigError(f"{missing[0]} must be set: {missing[0]}=VALUE")
    frozen: T = _frozen(cls, OmegaConf.to_container(node, resolve=True))
    return frozen


def _frozen(cls: Any, tree: Any, prefix: str = "") -> Any:
    values = {}
    for name, hint in get_type_hints(cls).items():
        if dataclasses.is_dataclass(hint):
            values[name] = _frozen(hint, tree[name], f"{prefix}{name}.")
        else:
            _check_entries(prefix + name, tree[name], hint)
            values[name] = tree[name]
    return cls(**values)


def _check_entries(key: str, value: Any, hint: Any) -> None:
    """Raise ConfigError at empty texts and at misplaced lists and dicts, which OmegaConf accepts."""
    filled(key, value)
    if get_origin(hint) not in (list, dict):
        return
    kind = get_args(hint)[-1]
    for name, entry in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(entry, dict) or isinstance(entry, list) is not (get_origin(kind) is list):
            wanted = getattr(kind, "__name__", kind)
            raise ConfigError(f"{key}={value!r} holds {entry!r}, which is not of type {wanted}")
        _check_entries(f"{key}.{name}" if isinstance(value, dict) else f"{key}[{name}]", entry, kind)


OmegaConf.register_new_resolver("evaluation_folder", _evaluation_folder, replace=True)
for _root, _cls in ROOTS.items():
    ConfigStore.instance().store(f"{_root}_schema", _schema(_cls))
