"""Pick, place and return beside a walking human: reinforcement learning with comfort in mind."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dm_control.rl.control import Environment

    from hrl_comfort.config import EnvConfig

__version__ = "0.1.0"

# dm_control looks for a screen when it is imported; without one it draws off-screen, which is no news.
warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")


def environment_of(task: str, choices: Mapping[str, object]) -> EnvConfig:
    """Return the configuration of `task` with the overrides of the command line that `choices` are.

    Raises:
      ConfigError: a choice is not allowed.
    """
    from hrl_comfort.config import ConfigError, TrainConfig
    from hrl_comfort.config.compose import compose, environment, override

    config = compose("train", [override(key, value) for key, value in {"task": task, **choices}.items()])
    if not isinstance(config, TrainConfig):
        raise ConfigError(f"{task!r} has no environment")
    return environment(config)


def load(task: str = "pick", seed: int = 0, **choices: object) -> Environment:
    """Return `task` as a dm_control Environment of one cell.

    `choices` are the overrides of the command line: `load("pick", human="arc", robot="ur5e")`, and with
    a dotted key `load("pick", **{"human.speed_m_s": 1.0})`. The same `seed` gives the same episodes.
    """
    from hrl_comfort.envs.dm import make_environment

    return make_environment(environment_of(task, choices), seed)


__all__ = ["__version__", "environment_of", "load"]
