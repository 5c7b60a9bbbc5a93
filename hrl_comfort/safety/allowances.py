"""Allowances that the shield must make, where arm and person differ from the model."""

from __future__ import annotations

import math

from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EnvConfig, HumanConfig
from hrl_comfort.scene.servos import SERVO_LAG_S

MOST_LOST = 2
"""Largest number of frames of the person's tracker that are lost in a row."""
WALKING = ("approach", "patrol", "worker", "reactive", "fetcher", "adversary")
"""Motions of people who walk at up to `human.speed_m_s`. Who comes nearer to the arm faster, of any motion, is
counted in the column `human_beyond_bound`."""
LARGEST_NOISE = 3.0
"""Standard deviations at which the noise of sensors is cut off."""


def check_allowances(config: EnvConfig) -> None:
    """Raise ConfigError where `randomise` breaks what the shield's guarantee assumes of arm and person."""
    if config.safety.kind == "none":
        return
    safety, given = config.safety, config.randomise
    frames = 1 + (MOST_LOST if given.person_dropout[1] > 0 else 0)
    needed = {"lag_s": SERVO_LAG_S + given.servo_lag_s[1], "latency_s": given.latency_s[1]}
    needed["delay_s"] = CONTROL_STEP_S  # the person moves on while a control step runs
    if given.tracker:
        # Frames come with control steps, so that one may be nearly a control step older than the tracker's period.
        steps = math.ceil(frames / given.person_rate_hz[0] / CONTROL_STEP_S - 1e-9)
        needed |= {"delay_s": steps * CONTROL_STEP_S, "margin_m": LARGEST_NOISE * given.person_noise_m[1]}
    short = [f"safety.{key}={value:.4g}" for key, value in needed.items() if getattr(safety, key) < value - 1e-9]
    if given.tracker and safety.bound == "observed":
        short.append("safety.bound=worst")
    told = max((person.speed_m_s for person in people_of(config.human) if person.motion in WALKING), default=0.0)
    if told > safety.human_speed_m_s:
        raise ConfigError(
            f"human.speed_m_s={told:g} is more than the shield assumes; give safety.human_speed_m_s={told:g}, or "
            f"human.speed_m_s={safety.human_speed_m_s:g} at most"
        )
    if short:
        raise ConfigError(f"randomise={given} exceeds what the shield allows for; give at least {' '.join(short)}")


def people_of(human: HumanConfig) -> list[HumanConfig]:
    """Return the configuration of each motion of each person, of a mixture all of its motions."""
    return [motion for person in human.everyone for motion in (person.people if person.mixture else [person])]


def largest_lateness(config: EnvConfig) -> float:
    """Return how late the servos of `config` may follow their set-points, s."""
    given = config.randomise
    return max(config.safety.lag_s + config.safety.latency_s, SERVO_LAG_S + given.servo_lag_s[1] + given.latency_s[1])
