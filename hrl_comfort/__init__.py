"""Hierarchical reinforcement learning of pick, place and return beside a human, with comfort levels."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dm_control.rl.control import Environment

    from hrl_comfort.config import EnvConfig

__version__ = "0.2.0"

# dm_control warns on import without a display; rendering off-screen is intended.
warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")


def environment_of(task: str, choices: Mapping[str, object]) -> EnvConfig:
    """Return the configuration of `task` with `choices` as command-line overrides.

    Raises:
      ConfigError: a choice is not allowed.
    """
    from hrl_comfort.config import ConfigError, TrainConfig
    from hrl_comfort.config.compose import compose, environment
    from hrl_comfort.config.overrides import override

    config = compose("train", [override(key, value) for key, value in {"task": task, **choices}.items()])
    if not isinstance(config, TrainConfig):
        raise ConfigError(f"{task!r} has no environment")
    return environment(config)


def load(task: str = "pick", seed: int = 0, **choices: object) -> Environment:
    """Return `task` as a dm_control Environment of one cell; the same `seed` gives the same episodes.

    `choices` are command-line overrides: `load("pick", human="arc", robot="ur5e")` or, for a dotted key,
    `load("pick", **{"human.speed_m_s": 1.0})`.

    Raises:
      ConfigError: a choice is not allowed.
    """
    from hrl_comfort.envs.dm import make_environment

    return make_environment(environment_of(task, choices), seed)


__all__ = ["__version__", "environment_of", "load"]
