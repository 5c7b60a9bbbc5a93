"""Options of users, beside those of the tasks: `meta_controller.further_options`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, EnvConfig, MetaControllerConfig
from hrl_comfort.config.checks import part
from hrl_comfort.config.hierarchy import FURTHER_OPTIONS
from hrl_comfort.hierarchy.options import Choice, Option
from hrl_comfort.policies.remembering import Remembering
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.cartesian import action_dim

MakeOption = Callable[[Scene, EnvConfig, int], Option]
"""(scene, configuration, seed) -> option."""


def with_own(
    choices: Sequence[Choice | Option],
    meta_controller: MetaControllerConfig,
    scene: Scene,
    config: EnvConfig,
    seed: int,
) -> list[Choice | Option]:
    """Return `choices` and the options that `meta_controller.further_options` names: each an `Option`, or a MakeOption.

    Raises:
      ConfigError: one is not there, is no option, or has the name of another.
    """
    found = list(choices)
    for name in meta_controller.further_options:
        given: Any = part(FURTHER_OPTIONS, name, {})
        try:
            made = given if isinstance(given, Option) or not callable(given) else given(scene, config, seed)
        except TypeError as error:
            raise ConfigError(f"{FURTHER_OPTIONS}={name!r} failed: TypeError: {error}") from error
        if not isinstance(made, Option):
            raise ConfigError(
                f"{FURTHER_OPTIONS}={name!r} is of type {type(made).__name__}; it must be a hrl_comfort.hierarchy."
                "options.Option, or a function of scene, configuration and seed that returns one"
            )
        if not isinstance(made.name, str) or not made.name:
            raise ConfigError(
                f"{FURTHER_OPTIONS}={name!r} is named {made.name!r}; a name is a string that is not empty"
            )
        taken = [each.name for each in found]
        if made.name in taken:
            raise ConfigError(
                f"{FURTHER_OPTIONS}={name!r} is named {made.name!r}, as another option; those are {', '.join(taken)}"
            )
        found.append(_checked(made, action_dim(scene, config.task)))
    return found


def _checked(option: Option, width: int) -> Option:
    """Return an option whose functions raise ConfigError where they return another shape, or no numbers."""
    key = f"{FURTHER_OPTIONS}: option {option.name!r}"

    def tested(what: str, found: Any, shape: tuple[int, ...]) -> Tensor:
        if not isinstance(found, Tensor) or found.shape != shape:
            said = f"shape {tuple(found.shape)}" if isinstance(found, Tensor) else f"type {type(found).__name__}"
            raise ConfigError(f"{key}: {what} returned {said}; it must return a tensor of shape {shape}")
        return found

    def policy(state: Any) -> Tensor:
        action = tested("policy", option.policy(state), (len(state.stage), width))
        if not bool(action.isfinite().all()):
            raise ConfigError(f"{key}: policy returned actions that are not finite")
        return action

    def initiation(state: Any) -> Tensor:
        return tested("initiation", option.initiation(state), tuple(state.stage.shape)).to(torch.bool)

    def termination(state: Any, begun: Any) -> Tensor:
        return tested("termination", option.termination(state, begun), tuple(state.stage.shape))

    own = option.policy if isinstance(option.policy, Remembering) else policy  # its memory is copied, saved and refused
    return replace(option, policy=own, initiation=initiation, termination=termination)
