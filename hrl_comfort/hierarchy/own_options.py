"""Options of users, beside those of the tasks: `meta_controller.further_options`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, EnvConfig, MetaControllerConfig
from hrl_comfort.config.checks import part, takes
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
        _check_fields(f"{FURTHER_OPTIONS}={name!r}", made)
        taken = [each.name for each in found]
        if made.name in taken:
            raise ConfigError(
                f"{FURTHER_OPTIONS}={name!r} is named {made.name!r}, as another option; those are {', '.join(taken)}"
            )
        found.append(_checked(made, action_dim(scene, config.task)))
    return found


def _check_fields(key: str, option: Option) -> None:
    """Raise ConfigError unless functions take what they are given, and limits are whole numbers above 0, or None."""
    for name, arguments in ("policy", "state"), ("initiation", "state"), ("termination", "state, begun"):
        takes(f"{key}: {name}", getattr(option, name), arguments)
    for name in ("time_limit", "interruption_steps", "max_runs"):
        value = getattr(option, name)
        if value is not None and not (type(value) is int and value > 0):
            raise ConfigError(f"{key}: {name}={value!r} must be a whole number above 0, or None")


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
        able = tested("initiation", option.initiation(state), tuple(state.stage.shape))
        if able.dtype != torch.bool:
            raise ConfigError(f"{key}: initiation returned {able.dtype}; it must return torch.bool")
        return able

    def termination(state: Any, begun: Any) -> Tensor:
        ends = tested("termination", option.termination(state, begun), tuple(state.stage.shape))
        likely = ends.is_floating_point() and bool(((ends >= 0) & (ends <= 1)).all())
        if ends.dtype != torch.bool and not likely:
            raise ConfigError(
                f"{key}: termination returned {ends.dtype}, {ends.tolist()}; it must return torch.bool, or floats in "
                "[0, 1]"
            )
        return ends

    own = option.policy if isinstance(option.policy, Remembering) else policy  # its memory is copied, saved and refused
    return replace(option, policy=own, initiation=initiation, termination=termination)
