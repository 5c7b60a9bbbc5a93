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
      TypeError: a key of `choices` is not one of the configuration, as for any unknown keyword.
    """
    from hrl_comfort.config import ConfigError, TrainConfig
    from hrl_comfort.config.checks import UnknownKeyError
    from hrl_comfort.config.compose import compose, environment
    from hrl_comfort.config.overrides import override

    try:
        config = compose("train", [override(key, value) for key, value in {"task": task, **choices}.items()])
    except UnknownKeyError as error:
        raise TypeError(f"{task} got an unexpected keyword argument {error.key!r}: {error}") from None
    if not isinstance(config, TrainConfig):
        raise ConfigError(f"{task!r} has no environment")
    return environment(config)


def load(task: str = "pick", seed: int = 0, flat_observation: bool = False, **choices: object) -> Environment:
    """Return `task` as a dm_control Environment of one cell; the same `seed` gives the same episodes.

    `choices` are command-line overrides: `load("pick", human="arc", robot="ur5e")` or, for a dotted key,
    `load("pick", **{"human.speed_m_s": 1.0})`. With `flat_observation` the observation is one array.

    Raises:
      ConfigError: a choice is not allowed, or `seed` is not a whole number from 0 to 2**32 - 1.
      TypeError: an unknown keyword.
    """
    from hrl_comfort.envs.dm import make_environment

    return make_environment(environment_of(task, choices), seed, flat_observation)


__all__ = ["__version__", "environment_of", "load"]
