"""Composition of configurations: `conf/*.yaml` and overrides to frozen dataclasses."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from operator import attrgetter
from typing import Any, TypeVar

from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.composition.own_files import with_own_files
from hrl_comfort.composition.stages import stages_of, with_budget
from hrl_comfort.config import (
    BenchmarkConfig,
    ConfigError,
    EnvConfig,
    EvaluateConfig,
    HierarchyConfig,
    HierarchyTrainConfig,
    MetaControllerTrainConfig,
    TrainConfig,
)
from hrl_comfort.config.checks import part_name
from hrl_comfort.config.commands import CommandConfig
from hrl_comfort.config.hierarchy import OPTION_KEYS
from hrl_comfort.config.hydra_conf import ALONE, composed, freeze, run_folder
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
from hrl_comfort.config.suite import SUITE
from hrl_comfort.files.run_config import load_config, trained_environment

C = TypeVar("C", bound=CommandConfig)
_ALL_BUT_ENGINE = tuple(field.name for field in dataclasses.fields(EnvConfig) if field.name != "engine")
AS_TRAINED: dict[str, tuple[str, ...]] = {
    "evaluate": _ALL_BUT_ENGINE,
    "studio": _ALL_BUT_ENGINE,
    "export": _ALL_BUT_ENGINE,
    "deploy": ("robot.name", "robot.gripper", "cell", "human.clipping", "human.spawns_m", "comfort", "task", "reward"),
    "train_meta_controller": (
        "robot", "cell", "human", "safety", "task.terminate_on", "task.arrival_speed_rad_s", "task.max_step_deg",
        "task.observation", "task.action_repeat",
    ),
}  # fmt: skip
"""Sections and keys that take their defaults from the run of the given policy, by root."""
OF_ONE_ARM = ("robot.home_deg", "robot.calibration", "robot.end_effector")
"""Keys that say nothing of another robot than that of the run."""


def compose(root: str, overrides: Iterable[str] = ()) -> CommandConfig:
    """Return the configuration `root` with Hydra `overrides`.

    With a policy that belongs to a run, the sections AS_TRAINED default to those of the run, and the options to those
    that a learned controller was trained with. Overrides win. A process reads the files of `conf/` once for the same
    choices.

    Raises:
      ConfigError: an unknown key or choice, or a value that is not allowed.
    """
    return _frozen(ROOTS.get(root, CommandConfig), root, overrides)


def compose_environment(root: str, overrides: Iterable[str] = ()) -> EnvConfig:
    """Return the sections of an environment alone, as in `compose`, which raises the same errors."""
    return _frozen(EnvConfig, root, overrides)


def _frozen(cls: type[C], root: str, overrides: Iterable[str]) -> C:
    with ALONE:
        known = check_overrides(root, with_own_files(overrides))
        try:
            run = _run_of(known) if root in AS_TRAINED else None
            known = [*_as_learned(known), *known]
            return _validated(cls, root, known if run is None else _with_sections(root, run, known))
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(one_line(error)) from error
        except RecursionError:
            raise ConfigError(f"{' '.join(known)} {TOO_DEEP}") from None
        except OverflowError as error:
            raise ConfigError(f"{' '.join(known)}: {one_line(error)}") from None


def _validated(cls: type[C], root: str, overrides: list[str]) -> C:
    """Return the configuration `cls` of `root` with its stages checked and their budget settled.

    A budget among the `overrides` scales the stages, those of a refinement too; else it is their sum. The overrides of
    a controller's training become its configuration, and the tasks of a suite theirs.
    """
    node, words = composed(root, overrides), []
    if cls is not ROOTS.get(root, cls):
        node = OmegaConf.masked_copy(node, [field.name for field in dataclasses.fields(cls)])
    elif cls is HierarchyTrainConfig:
        words, node.hierarchy.controller = node.hierarchy.controller, None
    elif cls is BenchmarkConfig and (tasks := _suite_of(node)):
        node = composed(root, _of_part(tasks[0], overrides))
    config = freeze(cls, node)
    if isinstance(config, EnvConfig):
        for group, section in NAMES.items():
            if hasattr(config, group):
                part_name(section, str(attrgetter(section)(config)), choices(group))
    if isinstance(config, HierarchyTrainConfig) and words:
        config = dataclasses.replace(config, hierarchy=_with_controller(config, words))
    if isinstance(config, BenchmarkConfig):
        return dataclasses.replace(config, suite=_parts(config.suite, root, overrides))
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


def _parts(tasks: Iterable[str], root: str, overrides: list[str]) -> dict[str, EvaluateConfig]:
    """Return the configuration of each task of a suite."""
    return {name: _validated(EvaluateConfig, root, _of_part(name, overrides)) for name in tasks}


def _of_part(task: str, overrides: list[str]) -> list[str]:
    """Return the overrides of a task of a suite, beside its people unless `overrides` name others."""
    chosen = {line.key_or_group: line.value() for line in map(parse, overrides)}
    if "task" in chosen:
        raise ConfigError(f"task={chosen['task']} does not go with the benchmark; choose among its tasks by suite=")
    return [f"task={task}", *([] if "human" in chosen else [f"human={SUITE[task]}"]), *overrides]


def _suite_of(node: DictConfig) -> list[str]:
    """Return the tasks that a benchmark's `suite` names; what is no task is refused when it is frozen."""
    return [name for name in node.suite if name in SUITE] if isinstance(node.suite, ListConfig) else []


def _with_controller(config: HierarchyTrainConfig, words: Iterable[str]) -> HierarchyConfig:
    """Return the section with the controller's training of overrides `words`, beside the robot and people there."""
    root = "train_meta_controller"
    if not isinstance(words, ListConfig):
        raise ConfigError(f"hierarchy.controller={words!r} is not a list of overrides, such as ['human=patrol']")
    known = check_overrides(root, [*map(str, words), "output=controller"])
    controller = _validated(MetaControllerTrainConfig, root, _with_sections(root, config, known))
    return dataclasses.replace(config.hierarchy, controller=controller)


def _run_of(overrides: list[str]) -> EnvConfig | None:
    """Return the environment that the given policy was trained in, of the first policy of which it is known."""
    parsed = {o.key_or_group: o.value() for o in map(parse, overrides)}
    given = {key: value for key, value in parsed.items() if key.split(".")[0] in ("policy", "policies")}
    # The environment of a learned controller comes before those of its skills.
    sources = [value for key, value in sorted(given.items(), key=lambda item: item[0] != "policies.meta_controller")]
    return next((found for source in sources if (found := trained_environment(str(source)))), None)


def _as_learned(overrides: list[str]) -> list[str]:
    """Return overrides that set OPTION_KEYS as in the training of the learned controller, if its run is there."""
    given = {o.key_or_group: o.value() for o in map(parse, overrides)}
    source = given.get("policies.meta_controller")
    if source is None or "learned" not in (given.get("meta_controller"), given.get("meta_controller.name")):
        return []
    folder = run_folder(str(source))
    config = None if folder is None else load_config(folder)
    if not isinstance(config, MetaControllerTrainConfig):
        return []
    return [override(f"meta_controller.{key}", getattr(config.meta_controller, key)) for key in OPTION_KEYS]


def _with_sections(root: str, run: EnvConfig, overrides: list[str]) -> list[str]:
    """Return `overrides` of `root` behind those that set its sections AS_TRAINED as in `run`.

    For a group chosen in `overrides`, keys that any file of the group sets are left out; of nested keys, those that the
    chosen file sets. A chosen cell takes nothing of the cell of the run, another robot nothing of OF_ONE_ARM.
    """
    chosen, trained = {parse(line).key_or_group: parse(line).value() for line in overrides}, []
    same_arm = run.robot.name == str(chosen.get("robot.name", chosen.get("robot", run.robot.name)))
    for part in AS_TRAINED[root]:
        stated, group = set[str](), part.split(".")[0]
        own: Any = {}
        if group == "cell" and group in chosen:
            continue
        if group in chosen:
            files = [file for file in (config_dir() / group).glob("*.yaml") if file.stem != "_shared"]
            loaded = {file.stem: OmegaConf.load(file) for file in files}
            stated = {str(key) for found in loaded.values() for key in found}
            own = loaded.get(str(chosen[group]), {})
        for key, value in _fields(part, attrgetter(part)(run)):
            name, _, nested = key.partition(".")[2].partition(".")
            left_out = not same_arm and key in OF_ONE_ARM
            left_out |= name in stated and (not nested or OmegaConf.select(own, f"{name}.{nested}") is not None)
            if not left_out and not (key.startswith("robot.gripper.") and "gripper" in chosen):
                # Hydra would add the entries of a mapping to those of conf/.
                trained += [override(key, None)] * isinstance(value, dict)
                trained.append(override(key, value))
    return [*trained, *overrides]


def _fields(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the fields of nested dataclasses by their dotted keys; those in a mapping as plain values."""
    if not dataclasses.is_dataclass(value):
        yield key, plain_value(value)
        return
    for field in dataclasses.fields(value):
        yield from _fields(f"{key}.{field.name}", getattr(value, field.name))


def plain_value(value: Any) -> Any:
    """Return a value of a configuration, the dataclasses of a mapping as mappings."""
    if isinstance(value, dict):
        return {name: plain_value(each) for name, each in value.items()}
    return dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else value
