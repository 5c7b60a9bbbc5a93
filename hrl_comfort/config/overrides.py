"""Overrides of the command line: checks against the known keys and choices, and one-line errors."""

from __future__ import annotations

import difflib
import json
import math
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import is_dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Glob, Override, RangeSweep
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hrl_comfort.config import (
    BenchmarkConfig,
    ConfigError,
    DeployConfig,
    EvaluateConfig,
    ExportConfig,
    FigureConfig,
    HierarchyTrainConfig,
    IdentifyConfig,
    MetaControllerTrainConfig,
    ReportConfig,
    ResultsConfig,
    StudioConfig,
    TrainConfig,
)
from hrl_comfort.config.checks import UnknownKeyError, is_object, plugins
from hrl_comfort.config.commands import CommandConfig

ROOTS: dict[str, type[CommandConfig]] = {
    "train": TrainConfig,
    "train_hierarchy": HierarchyTrainConfig,
    "train_meta_controller": MetaControllerTrainConfig,
    "evaluate": EvaluateConfig,
    "benchmark": BenchmarkConfig,
    "studio": StudioConfig,
    "deploy": DeployConfig,
    "export": ExportConfig,
    "identify": IdentifyConfig,
    "report": ReportConfig,
    "figure": FigureConfig,
    "results": ResultsConfig,
}
"""Configuration class of each root, a file `conf/ROOT.yaml`."""
SHARED = {
    "evaluate handover": "evaluate", "dataset": "evaluate", "bench env": "train", "bench safety": "train",
    "bench update": "train", "bench train": "train", "bench studio": "studio",
}  # fmt: skip
"""Root of each command that has the configuration of another one."""
NAMES = {
    "task": "task.name", "human": "human.motion", "robot": "robot.name", "gripper": "robot.gripper.name",
    "meta_controller": "meta_controller.name", "agent": "agent.name",
    "meta_controller_agent": "meta_controller_agent.name",
}  # fmt: skip
"""Key that names a part, by group: a part of another package has no file in the group."""
MOST_JOBS = 10_000
"""Largest sweep: Hydra lists every job before the first begins."""
TOO_DEEP = "contains itself, or is nested too deeply"


def root_of(command: str) -> str:
    """Return the key in ROOTS of a command such as `train meta_controller`."""
    return SHARED.get(command, command.replace(" ", "_"))


def config_dir() -> Path:
    """Return the folder of the YAML files: in the package of a wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "train.yaml").is_file():
            return folder
    raise ConfigError(f"conf/ is neither in {package} nor beside it; install the package again")


@cache
def groups(root: str) -> dict[str, tuple[str, ...]]:
    """Return the choices of every group of `root`, by group."""
    defaults = OmegaConf.load(config_dir() / f"{root}.yaml").defaults
    names = [str(key) for entry in defaults if isinstance(entry, DictConfig) for key in entry]
    found = {name: choices(name) for name in names}
    if "experiment" in found:
        whole = root == "train_hierarchy"
        found["experiment"] = tuple(name for name in found["experiment"] if _of_hierarchy(name) is whole)
    return found


def _of_hierarchy(experiment: str) -> bool:
    return "hierarchy" in OmegaConf.load(config_dir() / "experiment" / f"{experiment}.yaml")


def choices(group: str) -> tuple[str, ...]:
    """Return the choices of `group`; files that begin with `_` are shared parts."""
    return tuple(sorted(p.stem for p in (config_dir() / group).glob("*.yaml") if p.stem[0] != "_"))


def override(key: str, value: object) -> str:
    """Return `key=value` in Hydra's grammar for a Python value; a mapping's keys need not be there before."""
    return f"{'++' if isinstance(value, dict) else ''}{key}={_quoted(value)}"


def _quoted(value: object) -> str:
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_quoted, value))}]"
    if isinstance(value, dict):
        # Hydra's grammar has no quoted keys.
        pairs = (re.sub(r"([\\()\[\]{}:=,\s])", r"\\\1", str(key)) + f":{_quoted(each)}" for key, each in value.items())
        return f"{{{','.join(pairs)}}}"
    if isinstance(value, (int, float)) or re.fullmatch(r"[\w.-]*/[\w./-]*", str(value), re.ASCII):
        return str(value)
    # Everything else in quotes, for a text may look like a number.
    # Hydra takes a backslash literally unless a quote, or the end of the text, follows the backslashes.
    escaped = re.sub(r"(\\+)(?='|$)", r"\1\1", str(value)).replace("'", "\\'")
    return f"'{escaped}'"


def at_home(line: str) -> str:
    """Return an override with the path of the user's home where a value begins with `~/`, as shells do."""
    return re.sub(r"(?<=[=,\['\":])~(?=/|['\"]|$)", lambda _: os.path.expanduser("~"), line)


def check_overrides(root: str, overrides: Iterable[str], sweep: bool = False) -> list[str]:
    """Return `overrides` in the form that Hydra composes; with `sweep`, a key may have several values.

    Raises:
      ConfigError: an unknown key or choice, a deleted key, bad grammar, or several values without `sweep`.
    """
    if root not in ROOTS:
        raise ConfigError(f"{root!r} is not a configuration; choose one of {', '.join(ROOTS)}")
    parsed = [(_parsed(each, sweep), each) for line in overrides for each in _replaced(line)]
    check_jobs(each for each, _ in parsed)
    return [_checked(root, each, line) for each, line in parsed]


def _replaced(line: str) -> list[str]:
    """Return the overrides by which `cell.KEY={...}`, or one of `human`, sets a mapping.

    Without the first of them, Hydra adds to its entries.
    """
    match = re.match(r"((?:cell|human)\.(?!vary=)\w+)=\{", line)
    return [override(match[1], None), f"++{line}"] if match else [line]


def check_jobs(overrides: Iterable[Override]) -> None:
    """Raise ConfigError if a sweep of `overrides` has more than MOST_JOBS jobs."""
    count = math.prod(_count(each.value()) for each in overrides)
    if not count <= MOST_JOBS:
        raise ConfigError(f"the sweep has {count:.4g} jobs; at most {MOST_JOBS} are allowed")


def _count(value: object) -> float:
    """Return the number of values that an override stands for."""
    if isinstance(value, RangeSweep):
        return max(0.0, ((value.stop or 0) - (value.start or 0)) / value.step) if value.step else math.inf
    return len(value.list) if isinstance(value, ChoiceSweep) else 1


@lru_cache(maxsize=4096)
def parse(line: str) -> Override:
    """Return an override of Hydra's grammar, whose parser takes milliseconds, and for long lists far more.

    Raises:
      HydraException, ValueError, RecursionError: bad grammar.
    """
    return OverridesParser.create().parse_override(line)


def _parsed(line: str, sweep: bool) -> Override:
    try:
        parsed = parse(line)
    except (HydraException, ValueError) as error:  # ValueError: a number of thousands of digits
        if entry := re.search(r"[\[,]\s*([\w./]+=[^,'\"\]]*)", line):
            raise ConfigError(
                f"{line!r} is not an override: put {entry[1]} in inner quotes, as in "
                "\"hierarchy.controller=['human=patrol']\""
            ) from error
        raise ConfigError(
            f"{line!r} is not an override; write key=value, such as human=arc, and quote a value with other "
            "characters than letters, digits and ./-_ : \"output='my run'\""
        ) from error
    except RecursionError:
        raise ConfigError(f"{line} {TOO_DEEP}") from None
    if parsed.is_sweep_override() and not sweep:
        raise ConfigError(f"{line} has several values; add -m to run each, or write [a,b] for a list")
    return parsed


def _checked(root: str, parsed: Override, line: str) -> str:
    key, allowed = parsed.key_or_group, groups(root)
    if re.split("[./]", key)[0] == "hydra":
        return line
    deletes = f"{line} deletes a key; every key needs a value: {key}=VALUE"
    if key in allowed:
        if parsed.is_delete():
            raise ConfigError(deletes)
        if isinstance(parsed.value(), Glob):
            raise ConfigError(f"{line} is a pattern; list the choices: {key}={','.join(allowed[key][:2])}")
        swept = parsed.sweep_string_iterator() if parsed.is_sweep_override() else [parsed.value()]
        values = [str(value).replace("\\:", ":") for value in swept]  # Hydra escapes colons
        if own := [value for value in values if key in NAMES and (value in plugins(NAMES[key]) or is_object(value))]:
            if len(own) < len(values):
                raise ConfigError(
                    f"{line} mixes {own[0]} with choices of this package, which set other keys too; run them one by "
                    f"one, or sweep {NAMES[key]}={','.join(values)}"
                )
            return f"{NAMES[key]}={line.split('=', 1)[1]}"
        for value in values:
            if value not in allowed[key] and not (key == "experiment" and parsed.value() is None):
                if key == "experiment" and value in choices(key):
                    verb = "train" if root == "train_hierarchy" else "train hierarchy"
                    raise ConfigError(f"{line} is for another command: hrl-comfort {verb} {line}")
                meant = near(value, allowed[key])
                raise ConfigError(f"{key}={value} is not a choice{meant}; choose one of {', '.join(allowed[key])}")
        return line
    kind: Any = ROOTS[root]
    for depth, name in enumerate(parts := key.split(".")):
        if get_origin(kind) is list and name.isdigit():
            kind = get_args(kind)[0]
            continue
        if get_origin(kind) is dict:
            kind, entry = get_args(kind)[1], depth == len(parts) - 1
            if entry or not is_dataclass(kind):
                return line if line[0] in "+~" else f"++{line}"  # Hydra adds new keys of a dict only with ++
            continue
        fields = get_type_hints(kind) if is_dataclass(kind) else {}
        if name not in fields:
            inside = ".".join(parts[:depth]) or root.replace("_", " ")
            names = sorted({*fields, *(allowed if depth == 0 else ())})
            meant = _meant(root, name) or near(name, names)
            line = f"{key} is not a key{meant}; {inside} has {', '.join(names) or 'none'}"
            raise UnknownKeyError(line, key)
        kind = fields[name]
    if parsed.is_delete():
        raise ConfigError(deletes)
    if is_dataclass(kind) and not isinstance(parsed.value(), dict):
        raise ConfigError(f"{line} is a section; set {', '.join(f'{key}.{name}' for name in get_type_hints(kind))}")
    # An entry of a list or a mapping may leave out keys that have a default.
    optional = any(part.isdigit() for part in parts) or _in_mapping(root, parts)
    return f"++{line}" if optional and line[0] != "+" else line


def _in_mapping(root: str, parts: list[str]) -> bool:
    """Return whether a key is a mapping, or in one, as `cell.places.NAME.size_m`."""
    kind: Any = ROOTS[root]
    for name in parts:
        kind = get_type_hints(kind).get(name) if is_dataclass(kind) else None
        if get_origin(kind) is dict:
            return True
    return False


def _meant(root: str, word: str) -> str:
    """Return a hint at the key that ends with `word`: `train_seed` for `seed`, `agent.gamma` for `gamma`."""
    found = [key for key in _keys(ROOTS[root], "") if re.search(rf"[._]{re.escape(word)}$", key)]
    return f", did you mean {min(found, key=lambda key: key.count('.'))}?" if found else ""


def _keys(kind: Any, before: str) -> Iterator[str]:
    for name, hint in get_type_hints(kind).items():
        yield f"{before}{name}"
        if is_dataclass(hint):
            yield from _keys(hint, f"{before}{name}.")


def near(word: str, words: Iterable[str]) -> str:
    """Return a hint at the one of `words` that is most like `word`; empty where none is."""
    close = difflib.get_close_matches(word, list(words), n=1)
    return f", did you mean {close[0]}?" if close else ""


def one_line(error: Exception) -> str:
    """Return the message of an error of Hydra or OmegaConf, with its key and cause, on one line."""
    # Under a debugger or coverage OmegaConf chains its errors, and only the outer one has the key.
    chain = [e for e in (error.__cause__, error) if isinstance(e, OmegaConfBaseException)]
    if chain:
        cause = next((e for e in chain if e.full_key), chain[0])
        message = (cause.msg or str(cause)).splitlines()[0]
        key = str(cause.full_key or "")
        return f"{key}: {message}" if key not in message else message
    return " ".join(str(error).split())
