"""Resolve `policy=` into a policy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import with_level
from hrl_comfort.config import POLICIES, SCRIPTED_POLICIES, ConfigError, EnvConfig
from hrl_comfort.config.checks import implemented, import_object, is_object
from hrl_comfort.policies.actor import Policy, load_policy
from hrl_comfort.policies.direct import Direct
from hrl_comfort.policies.draws import OF_POLICIES, uniform
from hrl_comfort.policies.expert import Expert
from hrl_comfort.policies.external import SB3, Function, ObservationPolicy, from_function, from_sb3
from hrl_comfort.policies.graph import NO_GRIPPER, ONNX, read_onnx
from hrl_comfort.policies.hand.expert import GraspingExpert
from hrl_comfort.policies.potential_field import PotentialField
from hrl_comfort.policies.predictive_sampling import PredictiveSampling
from hrl_comfort.policies.remembering import Remembering
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.cartesian import action_dim
from hrl_comfort.tasks import State, Subtask, subtask
from hrl_comfort.tasks.observations.standard import share

Act = Callable[[State], Tensor]
"""State of N cells -> actions (N, A) in [-1, 1]."""
Source = str | Function
"""Value of `policy=`; from Python also a map from observations to actions."""


def make_policy(source: Source, task: Subtask, scene: Scene, config: EnvConfig, seed: int) -> Act:
    """Return the policy `source` for `task`: one of SCRIPTED, a trained one, or one made elsewhere.

    Raises:
      ConfigError: there is no such policy, or it does not fit the task, its observations or its actions.
    """
    if isinstance(source, str) and source in SCRIPTED:
        return SCRIPTED[source](task, scene, config, seed)
    if isinstance(source, str) and Path(source).exists():
        actor = load_policy(source)
        seen = observed_by(actor, source, task, config)
        if actor.memory_dim is not None:
            return Remembering(actor, seen.observe, config.task.action_repeat)
        return lambda state: actor(seen.observe(state).float()).double()
    if isinstance(source, str) and source.startswith(ONNX):
        graph = read_onnx(source)
        check_trained({**graph.about, "action": "joint"}, source, task, config)
        return graph
    policy = from_function(name_of(source), source) if callable(source) else external(source)
    return on_standard_observations(policy, task, scene, config)


def name_of(source: Source) -> str:
    """Return what `policy=` says, or the name of a callable or of its class."""
    if isinstance(source, str):
        return source
    return str(getattr(source, "source", None) or getattr(source, "__name__", type(source).__name__))


def external(source: str) -> ObservationPolicy:
    """Return the policy `sb3:FILE.zip` or `package.module:callable`.

    Raises:
      ConfigError: there is none.
    """
    if source.startswith(SB3):
        return from_sb3(source)
    if is_object(source):
        return from_function(source, import_object("policy", source))
    raise ConfigError(f"policy={source!r} is not there; give {POLICIES}")


def observation_policy(source: str) -> ObservationPolicy:
    """Return the policy `source` as a map from observations to actions.

    Raises:
      ConfigError: there is none, or it acts on the state of the cell.
    """
    if source in SCRIPTED:
        raise ConfigError(f"policy={source!r} acts on the state of the cell, not on observations; evaluate it by name")
    if not Path(source).exists():
        return external(source)
    actor = load_policy(source)
    if actor.memory_dim is not None:
        raise ConfigError(f"policy={source!r} has a memory, and acts by more than one observation; evaluate it by name")
    sizes = actor.spec["observation_dim"], actor.spec["action_dim"]
    return ObservationPolicy(source, lambda each: actor(torch.from_numpy(each)).numpy(), *sizes)


def on_standard_observations(policy: ObservationPolicy, task: Subtask, scene: Scene, config: EnvConfig) -> Act:
    """Return the policy as a function of the state.

    It sees the observations of `config.task`, the level, if any, and behind a shield its share, unless it takes one
    number less.

    Raises:
      ConfigError: it takes observations or gives actions of another width.
    """
    seen = subtask(task.name, config.task.observation, config.task.objects, config.robot.gripper.holds)
    if config.comfort.source != "none":
        seen = with_level(seen, config.comfort.levels)
    width = action_dim(scene, config.task)
    if policy.action_dim not in (None, width):
        raise ConfigError(
            f"policy={policy.source!r} gives actions of {policy.action_dim} numbers; "
            f"task.action={config.task.action} of robot.name={config.robot.name} takes {width}"
        )
    sized = replace(policy, action_dim=width)

    def act(state: State) -> Tensor:
        observation = seen.observe(state)
        if config.safety.kind != "none" and policy.observation_dim != observation.shape[-1]:
            observation = torch.cat([observation, share(state)], dim=-1)
        if policy.observation_dim not in (None, observation.shape[-1]):
            parts = ", ".join(f"{name} {term(state).shape[-1]}" for name, term in seen.observations.items())
            raise ConfigError(
                f"policy={policy.source!r} takes observations of {policy.observation_dim} numbers; "
                f"task.name={task.name} gives {observation.shape[-1]}: {parts}"
            )
        return torch.from_numpy(sized(observation.numpy()))

    return act


def random(size: int, seed: int) -> Act:
    """Return a policy of uniform actions of `size` numbers, the same in the same episode."""
    return lambda state: uniform(state, size, OF_POLICIES + seed) * 2 - 1


def observed_by(actor: Policy, source: str, task: Subtask, config: EnvConfig) -> Subtask:
    """Return `task` with the observations that the policy read from `source` was trained on.

    Raises:
      ConfigError: it was trained for another subtask, robot or decision length.
    """
    spec = {**actor.spec["environment"], "task": actor.spec["task"]}
    check_trained(spec, source, task, config)
    seen = subtask(task.name, str(spec.get("observation")), config.task.objects, config.robot.gripper.holds)
    if (levels := spec.get("levels")) is not None:
        seen = with_level(seen, levels)
    return seen.observing(share=share) if spec.get("shield") else seen


def check_trained(spec: dict[str, Any], source: str, task: Subtask, config: EnvConfig) -> None:
    """Raise ConfigError unless a policy of this `spec` was trained for this subtask, robot and decision length."""
    if spec["task"] != task.name:
        raise ConfigError(f"policy={source!r} was trained for {spec['task']!r}, not for {task.name!r}")
    now = {
        "robot": config.robot.name,
        "task.action": config.task.action,
        "task.action_repeat": config.task.action_repeat,
    }
    own, there = config.robot.gripper.name, spec.get("gripper", NO_GRIPPER)
    if (own == NO_GRIPPER) != (there == NO_GRIPPER):
        raise ConfigError(
            f"robot.gripper.name={own}, but policy={source!r} was trained with gripper={there}; choose that"
        )
    levels = spec.get("levels")
    if levels is not None and config.comfort.source == "none":
        raise ConfigError(
            f"comfort.source=none, but policy={source!r} needs a comfort level; "
            "give comfort.source=fixed comfort.level=5, say"
        )
    if levels is not None:
        now["comfort.levels"] = config.comfort.levels
    for key, here in now.items():
        if (there := spec.get(key.split(".")[-1])) != here:
            raise ConfigError(f"{key}={here}, but policy={source!r} was trained with {key}={there}")


def _expert(config: EnvConfig) -> type[Expert]:
    return GraspingExpert if config.robot.gripper.holds else Expert


_SCRIPTED: dict[str, Callable[[Subtask, Scene, EnvConfig, int], Act]] = {
    "expert": lambda task, scene, config, seed: _expert(config)(scene, config, task).act,
    "direct": lambda task, scene, config, seed: Direct(scene, config, task).act,
    "potential_field": lambda task, scene, config, seed: PotentialField(scene, config, task).act,
    "predictive_sampling": lambda task, scene, config, seed: PredictiveSampling(scene, config, task).act,
    "random": lambda task, scene, config, seed: random(action_dim(scene, config.task), seed),
}
SCRIPTED = implemented(SCRIPTED_POLICIES, _SCRIPTED)
"""Value of `policy=` -> function that makes the policy."""
