"""The comfort terms of the reward: pure, batched functions of distance, joint increment and level.

Source of Eqs. 1 to 4: Gonzalez-Santocildes, Vazquez, Eguiluz, IEEE Access 12 (2024),
10.1109/ACCESS.2024.3451663, called the paper; `reference` is what its authors' released code does.
Distances are metres, increments degrees a control step, levels 1 (most cautious robot) to N_c. Everything
is written as a reward, good is positive: docs/comfort.md says where that departs from Eq. 1 as printed.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from hrl_comfort.config import ComfortConfig

SMALLEST_M = 1e-10
OFFSET = -0.1
"""What the paper's terms are shifted by, and its F_conf2 costs."""
ROUNDING_DEG = 1e-6
"""An increment so little above a threshold is at it: ramp, radians and float32 turn 2 degrees into more."""


# ---- thresholds ----------------------------------------------------------------------------------------


def threshold_range(level: Tensor, config: ComfortConfig) -> Tensor:
    """Theta = (d_max - d_min) (1 - C_l / N_c), m: the one that fits the paper's worked example."""
    return (config.max_m - config.min_m) * (1 - level / config.levels)


def threshold_reference(level: Tensor, config: ComfortConfig) -> Tensor:
    """Theta = d_max (1 - C_l / N_c), m: the released code."""
    return config.max_m * (1 - level / config.levels)


def threshold_levels(level: Tensor, config: ComfortConfig) -> Tensor:
    """Theta from d_max at level 1 to d_min at level N_c, m, in equal parts: the project's own."""
    return config.max_m - (config.max_m - config.min_m) * ease(level, config)


def ease(level: Tensor, config: ComfortConfig) -> Tensor:
    """Return (...,) how much at ease the person is, 0 at level 1 to 1 at level N_c."""
    return (level - 1) / (config.levels - 1)


THRESHOLDS: dict[str, Callable[[Tensor, ComfortConfig], Tensor]] = {
    "range": threshold_range,
    "reference": threshold_reference,
    "levels": threshold_levels,
}


# ---- F_conf1, by distance ------------------------------------------------------------------------------


def paper(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """-0.1 + tanh((d - theta) / d) (d_max - d), Eq. 2 as printed: beyond theta it pays, and pays to stay."""
    bend = torch.tanh((distance - theta) / distance.clamp(min=SMALLEST_M))
    return OFFSET + bend * (config.max_m - distance).clamp(min=SMALLEST_M)


def reference(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """0.1 (-1 + tanh(((d - theta) / d) / (d_max - d))), in [-0.2, 0]: the released code."""
    bend = (distance - theta) / distance.clamp(min=SMALLEST_M)
    return 0.1 * (-1 + torch.tanh(bend / (config.max_m - distance).clamp(min=SMALLEST_M)))


def linear(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """-0.1 + (d - theta) / d_max: the paper tried a linear one and does not print it; this is ours."""
    return OFFSET + (distance - theta) / config.max_m


def logarithmic(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """-0.1 + ln((1 + d) / (1 + theta)), d and theta in m: likewise tried, not printed; this is ours.

    Nothing is nearer than touching: where an arm is within a body, d < 0, it counts as 0.
    """
    return OFFSET + torch.log1p(distance.clamp(min=0.0)) - torch.log1p(theta)


def bounded(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """-min(1, |d - theta| / (d_max - d_min))^power, in [-1, 0]: a preferred distance for each level.

    The project's own. Never positive, so nothing is gained by staying anywhere; and it draws a robot nearer
    whose person is at ease, where forms that only push away leave it where the task takes it. To it comes
    -time_penalty (C_l - 1) / (N_c - 1) a step: who is at ease would rather have it done soon.
    """
    off = (distance - theta).abs() / (config.max_m - config.min_m)
    return -off.clamp(max=1.0).pow(config.power)


def eased(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """`target_distance`, but beyond theta |d - theta| counts w times, w = (d_max - theta) / (d_max - d_min).

    The project's own: who is least at ease minds no robot that is farther than need be. With
    `threshold=levels`, w is (C_l - 1) / (N_c - 1). `time_penalty` comes to it as to `target_distance`.
    """
    span = config.max_m - config.min_m
    weight = torch.where(distance < theta, 1.0, ((config.max_m - theta) / span).clamp(0.0, 1.0))
    off = weight * (distance - theta).abs() / span
    return -off.clamp(max=1.0).pow(config.power)


FORMS: dict[str, Callable[[Tensor, Tensor, ComfortConfig], Tensor]] = {
    "paper": paper,
    "reference": reference,
    "linear": linear,
    "logarithmic": logarithmic,
    "target_distance": bounded,
    "target_distance_one_sided": eased,
}
HASTY = ("target_distance", "target_distance_one_sided")
"""Forms to which `time_penalty` comes."""


def distance_term(distance: Tensor, level: Tensor, config: ComfortConfig) -> Tensor:
    """F_conf1 (...,) of distance (...,) m at level (...,), in the form and with the threshold of `config`."""
    term = FORMS[config.form](distance, THRESHOLDS[config.threshold](level, config), config)
    return term - config.time_penalty * ease(level, config) if config.form in HASTY else term


# ---- F_conf2, by joint increment -----------------------------------------------------------------------


def increment_threshold(level: Tensor, max_step_deg: float, config: ComfortConfig) -> Tensor:
    """Return the largest increment at ease, max_step C_l / N_c, degrees: fits the paper's worked example."""
    return max_step_deg * level / config.levels


def speed_paper(increment: Tensor, threshold: Tensor, max_step_deg: float) -> Tensor:
    """-0.1 above the threshold, else 0: Eq. 3."""
    fast = increment > threshold + ROUNDING_DEG
    return torch.where(fast, torch.full_like(increment, OFFSET), torch.zeros_like(increment))


def speed_hinge(increment: Tensor, threshold: Tensor, max_step_deg: float) -> Tensor:
    """-(max(0, increment - threshold) / max_step)^2, in (-1, 0]: the project's own.

    A step that costs the same however far it is beyond the threshold is best taken at full speed or at the
    threshold; squared, what is given up for time grows evenly with the level.
    """
    return -((increment - threshold).clamp(min=0.0) / max_step_deg).square()


SPEED_FORMS: dict[str, Callable[[Tensor, Tensor, float], Tensor]] = {
    "paper": speed_paper,
    "hinge": speed_hinge,
}


def speed_term(increment: Tensor, level: Tensor, max_step_deg: float, config: ComfortConfig) -> Tensor:
    """F_conf2 (...,) of the largest absolute joint increment (...,) of a step, degrees, at level (...,).

    The released code tests signed increments, so that fast motion in the negative direction is free there.
    """
    threshold = increment_threshold(level, max_step_deg, config)
    return SPEED_FORMS[config.speed_form](increment, threshold, max_step_deg)


# ---- together ------------------------------------------------------------------------------------------


def comfort(distance: Tensor, increment: Tensor, level: Tensor, max_step_deg: float, config: ComfortConfig) -> Tensor:
    """F_comfort = alpha F_conf1 + beta F_conf2, Eq. 4, before `comfort.scale`."""
    total = torch.zeros_like(distance)
    if config.alpha:
        total = total + config.alpha * distance_term(distance, level, config)
    if config.beta:
        total = total + config.beta * speed_term(increment, level, max_step_deg, config)
    return total
