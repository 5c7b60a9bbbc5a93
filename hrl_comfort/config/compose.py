"""Composition, loading and saving of configurations: `conf/*.yaml` and overrides to frozen dataclasses."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from functools import cache, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from hrl_comfort.config import (
    HIERARCHY,
    ConfigError,
    EnvConfig,
    HierarchyConfig,
    HierarchyTrainConfig,
    MetaControllerTrainConfig,
    TrainConfig,
)
from hrl_comfort.config.checks import part_name
from hrl_comfort.config.commands import CommandConfig
from hrl_comfort.config.overrides import (
    NAMES,
    ROOTS,
    TOO_DEEP,
    check_overrides,
    choices,
    config_dir,
    one_line,
    override,
    parse,
)
from hrl_comfort.config.stages import stages_of, with_budget
from hrl_comfort.config.structured import freeze, section
from hrl_comfort.files.atomic import write_text
from hrl_comfort.files.documents import read_yaml
from hrl_comfort.files.provenance import unfinished
from hrl_comfort.files.relative_paths import resolved, same, stored
from hrl_comfort.files.versions import of_this_version

C = TypeVar("C", bound=CommandConfig)
_ALL_BUT_ENGINE = tuple(field.name for field in dataclasses.fields(EnvConfig) if field.name != "engine")
AS_TRAINED: dict[str, tuple[str, ...]] = {
    "evaluate": _ALL_BUT_ENGINE,
    "studio": _ALL_BUT_ENGINE,
    "export": _ALL_BUT_ENGINE,
    "deploy": ("robot.name", "cell", "human.clipping", "human.masked", "human.spawns_m", "comfort", "task", "reward"),
    "train_meta_controller": ("robot", "cell", "human"),
}
"""Sections and keys that take their defaults from the run of the given policy, by root."""
_ALONE = threading.RLock()
"""Hydra composes in one thread at a time."""


def compose(root: str, overrides: Iterable[str] = ()) -> CommandConfig:
    """Return the configuration `root` with Hydra `overrides`.

    With a policy that belongs to a run, the sections AS_TRAINED default to those of the run. Overrides win. A process
    reads the files of `conf/` once for the same choices.

    Raises:
      ConfigError: an unknown key or choice, or a value that is not allowed.
    """
    return _frozen(ROOTS.get(root, CommandConfig), root, overrides)


def compose_environment(root: str, overrides: Iterable[str] = ()) -> EnvConfig:
    """Return the sections of an environment alone, as in `compose`, which raises the same errors."""
    return _frozen(EnvConfig, root, overrides)


def _frozen(cls: type[C], root: str, overrides: Iterable[str]) -> C:
    with _ALONE:
        known = check_overrides(root, overrides)
        try:
            run = _run_of(known) if root in AS_TRAINED else None
            return _validated(cls, root, known if run is None else _with_sections(root, run, known))
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(one_line(error)) from error
        except RecursionError:
            raise ConfigError(f"{' '.join(known)} {TOO_DEEP}") from None
        except OverflowError as error:
            raise ConfigError(f"{' '.join(known)}: {one_line(error)}") from None


def composed(root: str, known: Iterable[str]) -> DictConfig:
    """Return what Hydra makes of `conf/ROOT.yaml` and overrides from `check_overrides`.

    Hydra composes equal choices once a process, which takes a tenth of a second. Values are set in a copy, in order, as
    Hydra does it; with a value that is added (`+`) or deleted (`~`) Hydra composes all of them.
    """
    with _ALONE:
        parsed = [parse(line) for line in known]
        values = [each for each in parsed if not _is_choice(each)]
        if any(each.is_add() or each.is_delete() for each in values):
            values = []
        whole = _composed(root, tuple(str(each.input_line) for each in parsed if each not in values))
        node = deepcopy(whole)  # a copy resolves `${now:}` anew
        for each in values:
            OmegaConf.update(node, each.key_or_group, each.value(), force_add=each.is_force_add())
        return node


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


def _validated(cls: type[C], root: str, overrides: list[str]) -> C:
    """Return the configuration `cls` of `root` with its stages checked and their budget settled.

    A budget among the `overrides` scales the stages, those of a refinement too; else it is their sum. The overrides of
    a controller's training become its configuration.
    """
    node, words = composed(root, overrides), []
    if cls is EnvConfig:
        node = OmegaConf.masked_copy(node, [field.name for field in dataclasses.fields(cls)])
    elif cls is HierarchyTrainConfig:
        words, node.hierarchy.controller = node.hierarchy.controller, None
    config = freeze(cls, node)
    if isinstance(config, EnvConfig):
        for group, section in NAMES.items():
            part_name(section, str(attrgetter(section)(config)), choices(group))
    if isinstance(config, HierarchyTrainConfig) and words:
        config = dataclasses.replace(config, hierarchy=_with_controller(config, words))
    if not isinstance(config, TrainConfig):
        return config
    stages_of(config)
    total = sum(stage.policy_steps for stage in config.curriculum.stages)
    if not total:
        return config
    asked = config.agent.policy_steps
    if not any(line.startswith("agent.policy_steps=") for line in overrides):
        return dataclasses.replace(config, agent=dataclasses.replace(config.agent, policy_steps=total))
    return with_budget(config, asked)


def _with_controller(config: HierarchyTrainConfig, words: Iterable[str]) -> HierarchyConfig:
    """Return the section with the controller's training of overrides `words`, beside the robot and people there."""
    root = "train_meta_controller"
    if not isinstance(words, ListConfig):
        raise ConfigError(f"hierarchy.controller={words!r} is not a list of overrides, such as ['human=patrol']")
    known = check_overrides(root, [*map(str, words), "output=controller"])
    controller = _validated(MetaControllerTrainConfig, root, _with_sections(root, config, known))
    return dataclasses.replace(config.hierarchy, controller=controller)


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
        chosen = [override(group, name) for group, name in named.items() if name in choices(group)]
        found = OmegaConf.to_container(composed(root, chosen), resolve=True)
        assert isinstance(found, dict)
        return {str(key): value for key, value in found.items()}

    try:
        return section(cls, of_this_version(cls, resolved(values, folder), defaults))
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


def _run_of(overrides: list[str]) -> EnvConfig | None:
    """Return the environment that the given policy was trained in, of the first policy of which it is known."""
    parsed = {o.key_or_group: o.value() for o in map(parse, overrides)}
    given = {key: value for key, value in parsed.items() if key.split(".")[0] in ("policy", "policies")}
    # The environment of a learned controller comes before those of its skills.
    sources = [value for key, value in sorted(given.items(), key=lambda item: item[0] != "policies.meta_controller")]
    return next((found for source in sources if (found := trained_environment(str(source)))), None)


def _with_sections(root: str, run: EnvConfig, overrides: list[str]) -> list[str]:
    """Return `overrides` of `root` behind those that set its sections AS_TRAINED as in `run`.

    For a group chosen in `overrides`, keys that any file of the group sets are left out.
    """
    chosen, trained = {parse(line).key_or_group for line in overrides}, []
    for part in AS_TRAINED[root]:
        stated, group = set(), part.split(".")[0]
        if group in chosen:
            files = [file for file in (config_dir() / group).glob("*.yaml") if file.stem != "_shared"]
            stated = {str(key) for file in files for key in OmegaConf.load(file)}
        for key, value in _fields(part, attrgetter(part)(run)):
            if key.split(".")[1] not in stated:
                trained.append(override(key, value))
    return [*trained, *overrides]


def _fields(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the fields of nested dataclasses by their dotted keys."""
    if not dataclasses.is_dataclass(value):
        yield key, value
        return
    for field in dataclasses.fields(value):
        yield from _fields(f"{key}.{field.name}", getattr(value, field.name))


def run_folder(policy: str) -> Path | None:
    """Return the run folder of `policy` (folder, policy file or checkpoint), or None."""
    path = Path(policy)
    candidates = (path, path.parent, path.parent.parent) if path.is_file() else (path,)
    return next((folder for folder in candidates if (folder / "config.yaml").is_file()), None)


def warn_unfinished(policy: str | None) -> None:
    """Warn if the training that `policy` belongs to is not finished."""
    folder = run_folder(policy) if policy else None
    if folder is not None and (line := unfinished(folder)):
        warnings.warn(line, stacklevel=3)


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
