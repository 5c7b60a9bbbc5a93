"""Allowances that the shield must make, where arm and person differ from the model."""

from __future__ import annotations

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.scene.servos import SERVO_LAG_S

MOST_LOST = 2
"""Largest number of frames of the person's tracker that are lost in a row."""
LARGEST_NOISE = 3.0
"""Standard deviations at which the noise of sensors is cut off."""


def check_allowances(config: EnvConfig) -> None:
    """Raise ConfigError where `randomise` breaks what the shield's guarantee assumes of arm and person."""
    if config.safety.kind == "none":
        return
    safety, given = config.safety, config.randomise
    frames = 1 + (MOST_LOST if given.person_dropout[1] > 0 else 0)
    needed = {"lag_s": SERVO_LAG_S + given.servo_lag_s[1], "latency_s": given.latency_s[1]}
    if given.tracker:
        needed |= {"delay_s": frames / given.person_rate_hz[0], "margin_m": LARGEST_NOISE * given.person_noise_m[1]}
    short = [f"safety.{key}={value:.4g}" for key, value in needed.items() if getattr(safety, key) < value - 1e-9]
    if given.tracker and safety.bound == "observed":
        short.append("safety.bound=worst")
    if short:
        raise ConfigError(f"randomise={given} exceeds what the shield allows for; give at least {' '.join(short)}")
