"""The skill that acts after a success, and the value of the success to it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, TrainConfig
from hrl_comfort.envs.torchrl import CellEnv
from hrl_comfort.files.run_config import environment
from hrl_comfort.policies.actor import ActorPolicy, load_policy
from hrl_comfort.policies.load import observed_by
from hrl_comfort.tasks import subtask
from hrl_comfort.training.t_star import StartDiscriminator, TerminalStates, successful_starts

NextSkillValue = Callable[[Tensor], Tensor]
"""success (N,) bool of the latest decision -> its value (N,) to the next skill, 0 without success. The value of a
state does not change in a stage, so that it can be stored."""


class NextSkill:
    """The policy `agent.next_skill`, as it is when a stage of the training begins or is resumed.

    Raises:
        ConfigError: there is no such policy, it starts elsewhere, or it does not fit this training.
    """

    def __init__(self, config: TrainConfig) -> None:
        self._source, hand = Path(config.agent.next_skill or ""), config.robot.gripper.holds
        try:
            policy = load_policy(self._source, critics=True)
            assert isinstance(policy, ActorPolicy)
            spec = policy.spec
            task = subtask(spec["task"], spec["environment"]["observation"], config.task.objects, hand)
            self._seen = observed_by(policy, str(self._source), task, environment(config))
        except ConfigError as error:
            raise ConfigError(f"agent.next_skill={self._source}: {error}") from error
        own = subtask(config.task.name, config.task.observation, config.task.objects, hand)
        if task.start != own.stages[-1].next_start:
            raise ConfigError(f"agent.next_skill={self._source}: {task.name} does not begin where {own.name} ends")
        self._policy = policy

    def observed(self, env: CellEnv, rows: Tensor) -> Tensor:
        """Return what the policy would begin with (F, D), normalised, in the latest states of rows (F,) of `env`.

        These are as the sensors report them; of episodes that have ended, with the noise of those that begin.
        """
        assert env.last is not None
        state = env.engine.episodes.observed(env.last.state).rows(rows)
        return self._policy.normaliser(self._seen.observe(state.with_(stage=torch.zeros_like(state.stage))).float())

    def value(self, env: CellEnv) -> NextSkillValue:
        """Return the value of the successes in `env`, by the policy's critics, which do not change.

        The target of a success then bootstraps on them, as one policy's would in the longer task, if both were trained
        with the same gamma and rewards, which is not checked.
        """

        def value(success: Tensor) -> Tensor:
            values, rows = torch.zeros(len(success)), success.nonzero()[:, 0]
            if len(rows):
                values[rows] = self._policy.value_of(self.observed(env, rows))
            return values

        return value

    def discriminator(self, weight: float, seed: int) -> StartDiscriminator:
        """Return the discriminator of the policy's starts from other states, with `weight` and `seed`.

        The starts come from an environment that is open meanwhile, as in the policy's training.
        """
        starts = self._policy.normaliser(successful_starts(self._policy.module, str(self._source)))
        return StartDiscriminator(starts, weight, seed)

    def terminal_states(self, env: CellEnv, discriminator: StartDiscriminator) -> TerminalStates:
        """Return the terminal states of the successes in `env`, which the discriminator learns from."""
        return TerminalStates(discriminator, lambda rows: self.observed(env, rows))
