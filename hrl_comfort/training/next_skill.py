"""What the end of a skill is worth to the next one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.actor import ActorPolicy, load_policy
from hrl_comfort.policies.load import observed_by
from hrl_comfort.tasks import subtask
from hrl_comfort.training.t_star import StartDiscriminator, successful_starts

NextSkillValue = Callable[[Tensor], Tensor]
"""success (N,) bool of the latest decision -> its value (N,) to the next skill, 0 without success."""


class NextSkill:
    """The value of successes: `judge` of the terminal states (F, D) that the function `ends` gives of rows (F,).

    A `discriminator` that is part of it has a state.
    """

    def __init__(
        self,
        ends: Callable[[Tensor], Tensor],
        judge: Callable[[Tensor], Tensor],
        discriminator: StartDiscriminator | None = None,
    ) -> None:
        self._ends, self._judge, self._discriminator = ends, judge, discriminator

    def __call__(self, success: Tensor) -> Tensor:
        """Return the values (N,) of successes (N,) bool; 0 elsewhere."""
        values = torch.zeros(len(success))
        rows = success.nonzero()[:, 0]
        if len(rows):
            values[rows] = self._judge(self._ends(rows))
        return values

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {} if self._discriminator is None else self._discriminator.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        if self._discriminator is not None:
            self._discriminator.load_state_dict(state)


def make_next_skill_value(config: TrainConfig, env: CellEnv) -> NextSkillValue:
    """Return the value of the states that `env` ends in to the policy `agent.next_skill`.

    The target of a success then bootstraps on that policy's critics, as one policy's would in the longer task, if
    both were trained with the same gamma and rewards, which is not checked. With `agent.next_skill_reward`, the value
    is a reward for likeness to that policy's starts.

    Raises:
        ConfigError: there is no such policy, it starts elsewhere, or it does not fit this training.
    """
    source, hand = Path(config.agent.next_skill or ""), config.robot.gripper.holds
    try:
        policy = load_policy(source, critics=True)
        assert isinstance(policy, ActorPolicy)
        spec = policy.spec
        task = subtask(spec["task"], spec["environment"]["observation"], config.task.objects, hand)
        seen = observed_by(policy, str(source), task, environment(config))
    except ConfigError as error:
        raise ConfigError(f"agent.next_skill={source}: {error}") from error
    own = subtask(config.task.name, config.task.observation, config.task.objects, hand)
    if task.start != own.stages[-1].next_start:
        raise ConfigError(f"agent.next_skill={source}: {task.name} does not begin where {own.name} ends")

    def ends(rows: Tensor) -> Tensor:
        assert env.last is not None
        state = env.last.state.rows(rows)
        return policy.normaliser(seen.observe(state.with_(stage=torch.zeros_like(state.stage))).float())

    if not (weight := config.agent.next_skill_reward):
        return NextSkill(ends, policy.value_of)
    starts = policy.normaliser(successful_starts(policy.module, str(source)))
    discriminator = StartDiscriminator(starts, weight, config.train_seed)
    return NextSkill(ends, discriminator.judge, discriminator)
