"""Policies on the command line: defaults of `studio`, and folders that stand for a whole chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hrl_comfort.config import HIERARCHY, SORTING, ConfigError, HierarchyTrainConfig, StudioConfig
from hrl_comfort.config.hierarchy import CYCLE
from hrl_comfort.config.overrides import override
from hrl_comfort.files.run_config import load_config, trained_environment

DEMO = Path("runs/demo")
"""Run of `make demo`."""
CHAIN = {"meta_controller": "nearest", "task": "cycle"}
"""Overrides of a chain, unless others are given."""


def options_in(folder: Path) -> tuple[str, ...]:
    """Return the options of the hierarchy in `folder`, each a run of that name; none if it holds no chain."""
    names: Sequence[str] = CYCLE
    if (folder / HIERARCHY).is_file():
        config = load_config(folder / HIERARCHY)
        names = config.meta_controller.options if isinstance(config, HierarchyTrainConfig) else ()
    elif (folder / "config.yaml").is_file():
        return ()
    return tuple(names) if all((folder / name / "policy.pt").is_file() for name in names) else ()


def with_defaults(overrides: Sequence[str]) -> list[str]:
    """Return the overrides of `hrl-comfort studio` with those that it adds.

    Without a policy it plays the demo's chain where there is one, else the expert.
    """
    if not {"policy", "policies", "replay"} & {key.split(".")[0] for key in _values(overrides)}:
        overrides = [*overrides, f"policy={DEMO if options_in(DEMO) else 'expert'}"]
    return with_controller(overrides)


def with_controller(overrides: Sequence[str]) -> list[str]:
    """Return `overrides` of which `policies.*`, or the folder of a chain, are played by `nearest`."""
    keys = _values(overrides)
    if any(key == "policies" or key.startswith("policies.") for key in keys):
        overrides = [*overrides, *(f"{key}={value}" for key, value in CHAIN.items() if key not in keys)]
    return as_chain(overrides)


def as_chain(overrides: Sequence[str]) -> list[str]:
    """Return `overrides` with the folder of a whole chain as `policy=` in place of the chain's overrides."""
    keys = _values(overrides)
    if options := options_in(Path(keys.get("policy", ""))) if keys.get("policy") else ():
        overrides = [line for line in overrides if not line.startswith("policy=")]
        overrides += [override(f"policies.{name}", str(Path(keys["policy"]) / name)) for name in options]
        if "meta_controller.options" not in keys and "division" not in keys:
            overrides.append(override("meta_controller.options", list(options)))
        overrides += [f"{key}={value}" for key, value in CHAIN.items() if key not in keys]
    return list(overrides)


def with_skills(overrides: Sequence[str]) -> list[str]:
    """Return `overrides` with the policy of every skill in place of `policy=`, the folder of a chain or one for all."""
    source = _values(overrides).get("policy")
    if source is None:
        return list(overrides)
    chain = options_in(Path(source)) == CYCLE
    skills = (override(f"policies.{name}", str(Path(source) / name) if chain else source) for name in CYCLE)
    return [*(line for line in overrides if not line.startswith("policy=")), *skills]


def check_beside(config: StudioConfig) -> None:
    """Raise ConfigError if the policy of the second cell was trained for another task than the cells have."""
    if config.beside is None:
        return
    if options := options_in(Path(config.beside)):
        trained = f"the chain {', '.join(options)}"
        fits = config.task.name in (CHAIN["task"], *SORTING)
    elif run := trained_environment(config.beside):
        trained, fits = run.task.name, run.task.name == config.task.name
    else:
        return
    if not fits:
        raise ConfigError(
            f"beside={config.beside!r} was trained for {trained}, and the cells have task={config.task.name}; "
            "give a policy for that task"
        )


def _values(overrides: Sequence[str]) -> dict[str, str]:
    """Return the value of each override, as written, by key."""
    return {line.lstrip("+").split("=")[0]: line.partition("=")[2].strip("'\"") for line in overrides}


def with_policy(config: StudioConfig, source: str) -> StudioConfig:
    """Return `config` with the policy `source`: the folder of a chain, or whatever `policy=` takes."""
    if options := options_in(Path(source)):
        controller = config.meta_controller
        name = "nearest" if controller.name == "none" else controller.name
        return replace(
            config,
            policy=None,
            policies={option: str(Path(source) / option) for option in options},
            meta_controller=replace(controller, name=name, options=list(options)),
        )
    return replace(config, policy=source, policies={}, meta_controller=config.meta_controller.alone())
