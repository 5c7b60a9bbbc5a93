"""Resolve `policy=` into a policy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from hrl_comfort.comfort.adapt import with_level
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.policies.actor import ActorPolicy, load_policy
from hrl_comfort.policies.expert import Expert
from hrl_comfort.policies.potential_field import PotentialField
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State, Subtask, subtask

Act = Callable[[State], Tensor]
"""State of N cells -> actions (N, 6) in [-1, 1]."""


def make_policy(source: str, task: Subtask, scene: Scene, config: EnvConfig, seed: int) -> Act:
    """Return the policy `source` for `task`: one of SCRIPTED, or the one in a folder or file.

    Raises:
      ConfigError: there is no such policy, or it was trained for another subtask or decision length.
    """
    if source in SCRIPTED:
        return SCRIPTED[source](task, scene, config, seed)
    if Path(source).exists():
        return trained(source, task, config)
    known = " or ".join(SCRIPTED)
    raise ConfigError(f"policy={source!r} is not there; give a run folder, a checkpoint, a policy.pt, {known}")


def random(seed: int) -> Act:
    """Return a policy of uniform actions."""
    generator = torch.Generator().manual_seed(seed)
    return lambda state: torch.rand(state.joint_target.shape, generator=generator, dtype=torch.float64) * 2 - 1


def trained(source: str, task: Subtask, config: EnvConfig) -> Act:
    """Return the trained policy of a run folder, a checkpoint or a policy file.

    Raises:
      ConfigError: it is damaged, or was trained for another subtask, robot or decision length.
    """
    actor = load_policy(source)
    seen = observed_by(actor, source, task, config)
    return lambda state: actor(seen.observe(state).float()).double()


def observed_by(actor: ActorPolicy, source: str, task: Subtask, config: EnvConfig) -> Subtask:
    """Return `task` with the observations that the policy read from `source` was trained on.

    Raises:
      ConfigError: it was trained for another subtask, robot or decision length.
    """
    spec = actor.spec["environment"]
    if actor.spec["task"] != task.name:
        raise ConfigError(f"policy={source!r} was trained for {actor.spec['task']!r}, not for {task.name!r}")
    now = {
        "robot": config.robot.name,
        "task.action": config.task.action,
        "task.action_repeat": config.task.action_repeat,
    }
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
    seen = subtask(task.name, str(spec.get("observation")), config.task.balls)
    return seen if levels is None else with_level(seen, levels)


SCRIPTED: dict[str, Callable[[Subtask, Scene, EnvConfig, int], Act]] = {
    "expert": lambda task, scene, config, seed: Expert(scene, config, task).act,
    "potential_field": lambda task, scene, config, seed: PotentialField(scene, config, task).act,
    "random": lambda task, scene, config, seed: random(seed),
}
"""Value of `policy=` -> function that makes the policy."""
