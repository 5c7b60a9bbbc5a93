"""Resolve what `policy=` says into a policy."""

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

SCRIPTED = ("expert", "potential_field", "random")
Act = Callable[[State], Tensor]
"""State of N cells -> actions (N, 6) in [-1, 1]."""


def make_policy(source: str, task: Subtask, scene: Scene, config: EnvConfig, seed: int) -> Act:
    """Return what acts for `task`: `expert`, `potential_field`, `random`, or the policy in a folder or file.

    Raises:
      ConfigError: there is no such policy, or it was trained for another subtask or decision length.
    """
    if source == "expert":
        return Expert(scene, config, task).act
    if source == "potential_field":
        return PotentialField(scene, config, task).act
    if source == "random":
        generator = torch.Generator().manual_seed(seed)
        return lambda state: torch.rand(len(state.steps), 6, generator=generator, dtype=torch.float64) * 2 - 1
    if not Path(source).exists():
        raise ConfigError(
            f"policy={source!r} is not there; give a run folder, a checkpoint, a policy.pt, {' or '.join(SCRIPTED)}"
        )
    actor = load_policy(source)
    seen = observed_by(actor, source, task, config)

    def act(state: State) -> Tensor:
        return actor(seen.observe(state).float()).double()

    return act


def observed_by(actor: ActorPolicy, source: str, task: Subtask, config: EnvConfig) -> Subtask:
    """Return `task` with the observations that the policy read from `source` was trained on.

    Raises:
      ConfigError: it was trained for another subtask, robot or decision length.
    """
    trained, now = actor.spec["environment"], config.task
    if actor.spec["task"] != task.name:
        raise ConfigError(f"policy={source!r} was trained for {actor.spec['task']!r}, not for {task.name!r}")
    for key, ours in (
        ("robot", config.robot.name),
        ("task.action", now.action),
        ("task.action_repeat", now.action_repeat),
    ):
        theirs = trained.get(key.removeprefix("task."))
        if theirs != ours:
            raise ConfigError(f"{key}={ours}, but policy={source!r} was trained with {key}={theirs}")
    seen = subtask(task.name, str(trained.get("observation")), config.task.balls)
    levels = trained.get("levels")  # policies of version 0.1 do not say: they know of no level
    if levels is not None:
        if config.comfort.source == "none":
            raise ConfigError(
                f"comfort.source=none, but policy={source!r} asks for a level; "
                "give comfort.source=fixed comfort.level=5, say"
            )
        if config.comfort.levels != levels:
            raise ConfigError(
                f"comfort.levels={config.comfort.levels}, but policy={source!r} was trained with {levels}"
            )
        seen = with_level(seen, levels)
    return seen
