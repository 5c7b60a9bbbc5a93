"""Learners that are parts of a larger one, and have a share of its updates."""

from __future__ import annotations

from dataclasses import replace

from hrl_comfort.config import AgentConfig


def seldom(config: AgentConfig, turns: int) -> AgentConfig:
    """Return the configuration of a learner that has one of `turns` updates, and of transitions.

    What `config` counts in updates ends at the same time as with all of them.
    """
    return replace(
        config,
        buffer_size=max(config.batch_size, config.buffer_size // turns),
        updates_per_policy_step=config.updates_per_policy_step / turns,
        critic_warmup_updates=config.critic_warmup_updates // turns,
        ema_rate=min(1.0, config.ema_rate * turns),
    )
