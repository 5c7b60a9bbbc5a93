"""Configuration of `hrl-comfort studio`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hrl_comfort.config.checks import ConfigError, within
from hrl_comfort.config.commands import EvaluateConfig


@dataclass(frozen=True)
class StudioConfig(EvaluateConfig):
    """`hrl-comfort studio`; `policy` or `policies` act, recordings go to `output`."""

    beside: str | None
    """Second policy, or folder of policies, that acts in a second cell beside the same person."""
    replay: str | None
    """Folder of an evaluation with paths.csv to play back, instead of a simulation."""
    host: str
    """Address to listen on; others than loopback need a token, which is printed with the address."""
    port: Annotated[int, within(0, 65535)]
    """Port to listen on, or the next free one; 0 is any free port."""
    speed: Annotated[float, within(0.1, 4.0)]
    """Simulated time per wall-clock time."""
    frames_per_s: Annotated[float, within(1.0, 60.0)]
    """Pictures a second."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, value, default in (
            ("checkpoints", self.checkpoints, "none"),
            ("levels", list(self.levels), []),
            ("terminal_states", self.terminal_states, None),
        ):
            if value != default:
                raise ConfigError(f"{key}={value} is for hrl-comfort evaluate; leave it out")
