"""Memory that a learner needs, checked before anything is allocated."""

import os
from collections.abc import Sequence
from itertools import pairwise

from hrl_comfort.config import AgentConfig, ConfigError

FLOAT_BYTES = 4


def check_memory(choice: str, floats: float) -> None:
    """Raise ConfigError if `floats` numbers, which `choice` asks for, are more than this machine's memory holds."""
    needed, there = floats * FLOAT_BYTES, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there:
        raise ConfigError(f"{choice} takes {needed / 1e9:.0f} GB; this machine has {there / 1e9:.0f} GB")


def check_replay(config: AgentConfig, observation_dim: int, action_dim: int, terminal_dim: int = 0) -> None:
    """Raise ConfigError if a replay buffer on the CPU is too large.

    Its transitions keep what the next skill observes at a success, `terminal_dim` numbers, besides two observations,
    the action, and what fits into six numbers.
    """
    if config.device == "cpu":
        floats = config.buffer_size * (2 * observation_dim + action_dim + terminal_dim + 6)
        check_memory(f"agent.buffer_size={config.buffer_size}", floats)


def check_networks(choice: str, copies: int, sizes: Sequence[int]) -> None:
    """Raise ConfigError if `copies` of the weights of a network with layers of these `sizes` are too many."""
    check_memory(choice, copies * sum(fan_in * fan_out for fan_in, fan_out in pairwise(sizes)))
