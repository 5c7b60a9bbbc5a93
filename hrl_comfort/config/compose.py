"""From `conf/*.yaml` and overrides to the frozen dataclasses of `config`, every key and type checked.

Hydra composes; what leaves this module is plain dataclasses. Every mistake becomes a `ConfigError`
of one line.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from hrl_comfort.config import (
    ConfigError,
    EnvConfig,
    EvaluateConfig,
    FigureConfig,
    MetaControllerTrainConfig,
    ReportConfig,
    TrainConfig,
)
from hrl_comfort.config.checks import filled
from hrl_comfort.files.atomic import write_text

Config = TrainConfig | MetaControllerTrainConfig | EvaluateConfig | ReportConfig | FigureConfig
ROOTS: dict[str, type[Config]] = {
    "train": TrainConfig,
    "train_meta_controller": MetaControllerTrainConfig,
    "evaluate": EvaluateConfig,
    "report": ReportConfig,
    "figure": FigureConfig,
}
"""What a verb is configured by; that of `train meta_controller` is `train_meta_controller`."""
AS_TRAINED: dict[str, tuple[str, ...]] = {
    "evaluate": tuple(field.name for field in dataclasses.fields(EnvConfig) if field.name != "engine"),
    "train_meta_controller": ("robot", "cell", "human"),
}
"""Sections that the runs of given policies stand in for, by root."""
DEEP = "holds itself, or lists too deep in lists to be read"
T = TypeVar("T")


def config_dir() -> Path:
    """Return the folder of the YAML files: inside the package in a wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "train.yaml").is_file():
            return folder
    raise ConfigError(f"conf/ is neither in {package} nor beside it; install the package again")


def root_of(verb: str) -> str:
    """Return the name in `ROOTS` of what configures a verb."""
    return verb.replace(" ", "_")


@cache
def groups(root: str) -> dict[str, tuple[str, ...]]:
    """Return the choices of every group that `root` composes, by group."""
    defaults = OmegaConf.load(config_dir() / f"{root}.yaml").defaults
    names = [str(key) for entry in defaults if isinstance(entry, DictConfig) for key in entry]
    return {name: choices(name) for name in names}


def choices(group: str) -> tuple[str, ...]:
    """Return what `group` can be; files that begin with `_` hold what its choices share."""
    return tuple(sorted(p.stem for p in (config_dir() / group).glob("*.yaml") if p.stem[0] != "_"))


def compose(root: str, overrides: Iterable[str] = ()) -> Config:
    """Return the configuration of the verb `root` under Hydra `overrides`.

    For `evaluate`, a policy that belongs to a run is measured as it was trained: the run's own
    config.yaml stands in for the defaults, and the overrides still win. A controller that is taught
    meets the robot, cell and people of its skills, and a task of its own.
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
        raise ConfigError(f"{' '.join(known)} {DEEP}") from None
    except OverflowError as error:
        raise ConfigError(f"{' '.join(known)}: {one_line(error)}") from None


def environment(config: TrainConfig | MetaControllerTrainConfig | EvaluateConfig) -> EnvConfig:
    """Return the sections that an environment is made of."""
    return EnvConfig(**{field.name: getattr(config, field.name) for field in dataclasses.fields(EnvConfig)})


def save_config(config: Config, path: str | Path) -> None:
    """Write `config` as YAML that `load_config` reads back to an equal one."""
    write_text(Path(path), OmegaConf.to_yaml(OmegaConf.create(dataclasses.asdict(config))))


def load_config(path: str | Path) -> Config:
    """Return the configuration in `path`, a run's config.yaml or the folder that holds it."""
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
    except (YAMLError, OverflowError, ValueError) as error:  # the last two at numbers of very many digits
        raise ConfigError(f"{file} is not YAML: {one_line(error)}") from error
    except RecursionError:
        raise ConfigError(f"{file} {DEEP}") from None
    except OSError as error:  # also what OmegaConf makes of a file that is a lone number or word
        raise ConfigError(f"{file} cannot be read: {one_line(error)}") from error
    raise ConfigError(f"{file} has not the keys of a {', '.join(ROOTS)} configuration")


def override(key: str, value: object) -> str:
    """Return `key=value` in Hydra's grammar, for a value from Python."""
    return f"{key}={_text(value)}"


def check_overrides(root: str, overrides: Iterable[str], sweep: bool = False) -> list[str]:
    """Return `overrides` as Hydra takes them; raise ConfigError at an unknown key or choice.

    Only a `sweep` may give one key several values.
    """
    if root not in ROOTS:
        raise ConfigError(f"{root!r} is not a configuration; choose one of {', '.join(ROOTS)}")
    known = []
    for line in overrides:
        try:
            parsed = OverridesParser.create().parse_override(line)
        except (HydraException, ValueError) as error:  # the latter at a number of thousands of digits
            raise ConfigError(
                f"{line!r} is not an override; write key=value, such as human=arc, and a value of other "
                "than letters, digits and ./-_ in quotes: \"output='my run'\""
            ) from error
        except RecursionError:
            raise ConfigError(f"{line} {DEEP}") from None
        if parsed.is_sweep_override() and not sweep:
            raise ConfigError(f"{line} holds several values; add -m to run each, or write [a,b] for a list")
        known.append(_checked(root, parsed, line))
    return known


def one_line(error: Exception) -> str:
    """Return what Hydra or OmegaConf says over several lines, and its cause, in one."""
    # Under a debugger or coverage OmegaConf chains its errors, and only the outer one knows the key.
    chain = [e for e in (error.__cause__, error) if isinstance(e, OmegaConfBaseException)]
    if chain:
        cause = next((e for e in chain if e.full_key), chain[0])
        what = (cause.msg or str(cause)).splitlines()[0]
        key = str(cause.full_key or "")
        return f"{key}: {what}" if key not in what else what
    return " ".join(str(error).replace("\t", " ").split())


def _checked(root: str, parsed: Override, line: str) -> str:
    key, allowed = parsed.key_or_group, groups(root)
    if re.split("[./]", key)[0] == "hydra":
        return line
    if key in allowed:
        values = parsed.sweep_string_iterator() if parsed.is_sweep_override() else [parsed.value()]
        for value in values:
            if str(value) not in allowed[key] and not (key == "experiment" and value is None):
                raise ConfigError(
                    f"{key}={value} is not a choice{_near(str(value), allowed[key])}; "
                    f"choose one of {', '.join(allowed[key])}"
                )
        return line
    kind: Any = ROOTS[root]
    for depth, name in enumerate(parts := key.split(".")):
        if get_origin(kind) is dict:
            return line if line[0] == "+" else f"++{line}"  # the user's own key: nothing to override
        fields = get_type_hints(kind) if dataclasses.is_dataclass(kind) else {}
        if name not in fields:
            inside = ".".join(parts[:depth]) or root.replace("_", " ")
            names = sorted({*fields, *(allowed if depth == 0 else ())})
            have = ", ".join(names) or "none"
            raise ConfigError(f"{key} is not a key{_near(name, names)}; {inside} has {have}")
        kind = fields[name]
    if dataclasses.is_dataclass(kind) and not isinstance(parsed.value(), dict):
        inside = ", ".join(f"{key}.{name}" for name in get_type_hints(kind))
        raise ConfigError(f"{line} sets no single value; set {inside}")
    return line


def _near(word: str, words: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(words), n=1)
    return f", did you mean {close[0]}?" if close else ""


def _as_trained(overrides: list[str], sections: Iterable[str]) -> list[str]:
    """Return overrides that set `sections` as the policy's run had them; of a chain's, the first with one.

    Where a group is chosen in `overrides`, what any of its files states is left to that choice.
    """
    parsed = {o.key_or_group: o.value() for o in OverridesParser.create().parse_overrides(overrides)}
    given = {key: value for key, value in parsed.items() if key.split(".")[0] in ("policy", "policies")}
    # What a controller was trained in is what it is judged in, whatever its skills once saw.
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
    """Return the run folder that `policy` (folder, policy file or checkpoint) belongs to, if any."""
    path = Path(policy)
    candidates = (path, path.parent, path.parent.parent) if path.is_file() else (path,)
    return next((folder for folder in candidates if (folder / "config.yaml").is_file()), None)


def _evaluation_folder(policy: str | None, task: str) -> str:
    folder = run_folder(policy) if policy else None
    if folder:
        return str(folder / "eval")
    return f"runs/evaluate/{task}/{Path(policy).stem if policy else 'chain'}"


def _text(value: object) -> str:
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_text, value))}]"
    if isinstance(value, (int, float)) or re.fullmatch(r"[\w./-]+", str(value), re.ASCII):
        return str(value)
    # Hydra reads a backslash as such, save before a quote or another backslash that leads to one.
    escaped = re.sub(r"(\\+)(?='|$)", r"\1\1", str(value)).replace("'", "\\'")
    return f"'{escaped}'"


def _schema(cls: Any) -> Any:
    """Return a mutable twin of the frozen `cls`: OmegaConf cannot merge into a frozen dataclass.

    It is a name of this module, so that the processes of a sweep find the same class.
    """
    name = f"{cls.__name__}Schema"
    if name not in globals():
        hints = get_type_hints(cls)
        twins = [(key, _schema(t) if dataclasses.is_dataclass(t) else t) for key, t in hints.items()]
        globals()[name] = twin = dataclasses.make_dataclass(name, twins)
        twin.__module__ = __name__
    return globals()[name]


def _freeze(cls: type[T], node: Any) -> T:
    """Return the dataclass `cls` that `node` describes; its own checks run as it is made."""
    missing = sorted(OmegaConf.missing_keys(node))
    if missing:
        raise ConfigError(f"{missing[0]} must be set: {missing[0]}=VALUE")
    built: T = _built(cls, OmegaConf.to_container(node, resolve=True))
    return built


def _built(cls: Any, tree: Any, before: str = "") -> Any:
    values = {}
    for name, hint in get_type_hints(cls).items():
        if dataclasses.is_dataclass(hint):
            values[name] = _built(hint, tree[name], f"{before}{name}.")
        else:
            _check_inside(before + name, tree[name], hint)
            values[name] = tree[name]
    return cls(**values)


def _check_inside(key: str, value: Any, hint: Any) -> None:
    """Raise ConfigError at an empty text, and at lists and dicts out of place: OmegaConf lets them."""
    filled(key, value)
    if get_origin(hint) not in (list, dict):
        return
    kind = get_args(hint)[-1]
    for name, each in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(each, dict) or isinstance(each, list) is not (get_origin(kind) is list):
            wanted = getattr(kind, "__name__", kind)
            raise ConfigError(f"{key}={value!r} holds {each!r}, which is not of type {wanted}")
        _check_inside(f"{key}.{name}" if isinstance(value, dict) else f"{key}[{name}]", each, kind)


OmegaConf.register_new_resolver("evaluation_folder", _evaluation_folder, replace=True)
for _root, _cls in ROOTS.items():
    ConfigStore.instance().store(f"{_root}_schema", _schema(_cls))
