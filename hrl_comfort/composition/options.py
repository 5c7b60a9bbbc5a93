"""Configurations of environments whose actions are options, with a world and skills for each task by default."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.policies import CYCLE, options_in
from hrl_comfort.config import SORTING, ConfigError, EvaluateConfig, MetaControllerTrainConfig
from hrl_comfort.config.checks import UnknownKeyError, implemented, one_of
from hrl_comfort.config.hierarchy import OPTION_KEYS
from hrl_comfort.config.hydra_conf import run_folder
from hrl_comfort.config.overrides import override
from hrl_comfort.files.run_config import load_config, warn_unfinished

SHIELDED = {"safety": "ssm", "robot.rating": "collaborative", "task.terminate_on": "unsafe_contact"}
WORLDS: dict[str, dict[str, object]] = implemented(
    SORTING,
    {
        "sort": {"human": "patrol"},
        "shift": {"human": "mixture", **SHIELDED},
        "kitting": {"human": "fetcher", "cell": "bench", **SHIELDED},
    },
)
"""Overrides by task, unless a run says in which world it was trained."""
RETURNS: dict[str, dict[str, object]] = implemented(
    SORTING,
    {
        "sort": {"reward": "sort", "comfort": "sort"},
        "shift": {"reward": "sort", "comfort": "shift"},
        "kitting": {"reward": "kitting", "comfort": "kitting"},
    },
)
"""Overrides by task that say what a controller is paid for."""
SKILLS = implemented(SORTING, {"sort": "expert", "shift": "expert", "kitting": "direct"})
"""Policy of each skill by task, unless others are given."""


def compose_options(task: str, choices: Mapping[str, object], run: str | None) -> EvaluateConfig:
    """Return the configuration; see `hrl_comfort.options_of`, which raises the same errors."""
    one_of("task", task, SORTING)
    if run is None:
        given = {"task": task, **WORLDS[task], **RETURNS[task], **_skills(dict.fromkeys(CYCLE, SKILLS[task]))}
    else:
        warn_unfinished(run)
        given = _trained(task, run)
    asked = {key: value for key, value in choices.items() if key != "policies"}
    named = choices.get("policies", {})
    if not isinstance(named, Mapping):
        raise ConfigError(f"policies={named!r} must be a mapping, such as {{'pick': 'runs/demo/pick'}}")
    top = "learned" if "policies.meta_controller" in given else "nearest"
    words = {"meta_controller": top, **given, **asked, **_skills(named)}
    try:
        config = compose("evaluate", [override(key, value) for key, value in words.items()])
    except UnknownKeyError as error:
        raise TypeError(f"the options of {task} got an unexpected keyword argument {error.key!r}: {error}") from None
    assert isinstance(config, EvaluateConfig)
    return config


def _skills(policies: Mapping[str, str]) -> dict[str, object]:
    return {f"policies.{name}": policy for name, policy in policies.items()}


def _trained(task: str, run: str) -> dict[str, object]:
    """Return the overrides of a controller's training, or of skills in the folder of a hierarchy."""
    if options_in(Path(run)) == CYCLE:
        return {"task": task, **RETURNS[task], **_skills({name: str(Path(run) / name) for name in CYCLE})}
    config = load_config(folder) if (folder := run_folder(run)) else None
    if not isinstance(config, MetaControllerTrainConfig):
        raise ConfigError(
            f"run={run!r} is neither the folder of a hierarchy with {', '.join(CYCLE)}, such as runs/demo, nor that "
            "of hrl-comfort train meta_controller"
        )
    if config.task.name != task:
        raise ConfigError(f"run={run!r} was trained for task={config.task.name}, not {task}")
    chosen = {f"meta_controller.{key}": getattr(config.meta_controller, key) for key in OPTION_KEYS}
    return {**chosen, **_skills({**config.policies, "meta_controller": run})}
