"""Comfort terms of the reward: pure, batched functions of distance, joint increment and level.

Eqs. 1 to 4 are those of the paper: Gonzalez-Santocildes, Vazquez, Eguiluz, IEEE Access 12 (2024),
10.1109/ACCESS.2024.3451663; `reference` is its released code. Distances d and theta are in metres, increments in
degrees a control step, levels C_l from 1 (most cautious) to N_c. All terms are rewards (higher is better);
docs/comfort.md lists the differences from Eq. 1 as printed.
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.config import FAR_AWAY_M, ComfortConfig
from hrl_comfort.config import comfort as names
from hrl_comfort.config.checks import function, implemented

SMALLEST_M = 1e-10
OFFSET = -0.1
"""Offset of the paper's distance terms and value of its F_conf2."""
ROUNDING_DEG = 1e-6
"""Tolerance of increments against rounding by the ramp, radians and float32."""


def human_distance(tcp_pos: Tensor, humans: Tensor) -> Tensor:
    """Return the horizontal distance (...,) m from tool (..., 3) to the axis of the nearest of `humans` (..., P, 2).

    That of one human is the paper's.
    """
    return vector_norm(tcp_pos[..., None, :2] - humans, dim=-1).amin(dim=-1)


def present(humans: Tensor) -> Tensor:
    """Return (...,) bool: a human is in the cell; `humans` (..., P, 2) m are far away for `human=none`."""
    return (humans[..., 0] < 0.5 * FAR_AWAY_M).any(dim=-1)


def threshold_range(level: Tensor, config: ComfortConfig) -> Tensor:
    """Return theta = (d_max - d_min) (1 - C_l / N_c), m, the one that fits the paper's worked example."""
    return (config.max_m - config.min_m) * (1 - level / config.levels)


def threshold_reference(level: Tensor, config: ComfortConfig) -> Tensor:
    """Return theta = d_max (1 - C_l / N_c), m, as in the released code."""
    return config.max_m * (1 - level / config.levels)


def threshold_levels(level: Tensor, config: ComfortConfig) -> Tensor:
    """Return theta, linear in the level from d_max at 1 to d_min at N_c, m; this project's."""
    return config.max_m - (config.max_m - config.min_m) * ease(level, config)


def ease(level: Tensor, config: ComfortConfig) -> Tensor:
    """Return the level (...,) scaled from 0 (level 1) to 1 (level N_c)."""
    return (level - 1) / (config.levels - 1)


Threshold = Callable[[Tensor, ComfortConfig], Tensor]
"""(level (...,), config) -> theta (...,) m."""
THRESHOLDS: dict[str, Threshold] = implemented(
    names.THRESHOLDS, {"range": threshold_range, "reference": threshold_reference, "levels": threshold_levels}
)


def paper(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return -0.1 + tanh((d - theta) / d) (d_max - d), Eq. 2 as printed; positive beyond theta."""
    bend = torch.tanh((distance - theta) / distance.clamp(min=SMALLEST_M))
    return OFFSET + bend * (config.max_m - distance).clamp(min=SMALLEST_M)


def reference(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return 0.1 (-1 + tanh(((d - theta) / d) / (d_max - d))), in [-0.2, 0], as in the released code."""
    bend = (distance - theta) / distance.clamp(min=SMALLEST_M)
    return 0.1 * (-1 + torch.tanh(bend / (config.max_m - distance).clamp(min=SMALLEST_M)))


def linear(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return -0.1 + (d - theta) / d_max; the paper names a linear form without an equation."""
    return OFFSET + (distance - theta) / config.max_m


def logarithmic(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return -0.1 + ln((1 + d) / (1 + theta)); the paper names a logarithmic form without an equation.

    A negative distance (arm inside a body) counts as 0.
    """
    return OFFSET + torch.log1p(distance.clamp(min=0.0)) - torch.log1p(theta)


def target_distance(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return -min(1, |d - theta| / (d_max - d_min))^power, in [-1, 0]: theta is the target distance.

    This project's. It is never positive, so lingering does not pay. At high levels it attracts the arm, which
    purely repulsive forms cannot. `distance_term` adds the time penalty.
    """
    off = (distance - theta).abs() / (config.max_m - config.min_m)
    return -off.clamp(max=1.0).pow(config.power)


def target_distance_one_sided(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return `target_distance` with |d - theta| beyond theta weighted by (d_max - theta) / (d_max - d_min).

    This project's. At level 1 a distance beyond theta costs nothing. With `threshold=levels` the weight is
    (C_l - 1) / (N_c - 1).
    """
    span = config.max_m - config.min_m
    weight = torch.where(distance < theta, 1.0, ((config.max_m - theta) / span).clamp(0.0, 1.0))
    off = weight * (distance - theta).abs() / span
    return -off.clamp(max=1.0).pow(config.power)


def minimum_distance(distance: Tensor, theta: Tensor, config: ComfortConfig) -> Tensor:
    """Return `target_distance` nearer than theta, else 0; this project's.

    The arm is never paid to come near, so that nothing holds it beside a person.
    """
    return target_distance(torch.minimum(distance, theta), theta, config)


Form = Callable[[Tensor, Tensor, ComfortConfig], Tensor]
"""(distance (...,) m, theta (...,) m, config) -> F_conf1 (...,)."""
_FORMS = (paper, reference, linear, logarithmic, target_distance, target_distance_one_sided, minimum_distance)
FORMS: dict[str, Form] = implemented(names.FORMS, {form.__name__: form for form in _FORMS})
TIMED = ("target_distance", "target_distance_one_sided", "minimum_distance")
"""Forms with a time penalty."""


def distance_term(distance: Tensor, level: Tensor, config: ComfortConfig, home: Tensor | None = None) -> Tensor:
    """Return F_conf1 (...,) at distance (...,) m and level (...,), by `config.form` and `config.threshold`.

    With the distance `home` (...,) m of an arm at home, only what is lost by being nearer than that counts, never more
    than 0. TIMED forms also cost time_penalty (C_l - 1) / (N_c - 1) a control step.
    """
    form, threshold, _ = forms(config)
    theta = threshold(level, config)
    term = form(distance, theta, config)
    if home is not None:
        term = (term - form(torch.maximum(distance, home), theta, config)).clamp(max=0.0)
    return term - config.time_penalty * ease(level, config) if config.form in TIMED else term


def increment_threshold(level: Tensor, max_step_deg: float, config: ComfortConfig) -> Tensor:
    """Return the threshold max_step C_l / N_c, degrees, which fits the paper's worked example."""
    return max_step_deg * level / config.levels


def speed_paper(increment: Tensor, threshold: Tensor, max_step_deg: float) -> Tensor:
    """Return -0.1 above the threshold, else 0 (Eq. 3)."""
    return torch.where(increment > threshold + ROUNDING_DEG, OFFSET, torch.zeros_like(increment))


def speed_hinge(increment: Tensor, threshold: Tensor, max_step_deg: float) -> Tensor:
    """Return -(max(0, increment - threshold) / max_step)^2, in (-1, 0]; this project's.

    Under Eq. 3 the best speed is the threshold or the maximum. A squared excess gives speeds in between.
    """
    return -((increment - threshold).clamp(min=0.0) / max_step_deg).square()


SpeedForm = Callable[[Tensor, Tensor, float], Tensor]
"""(increment (...,), threshold (...,), largest increment, degrees each) -> F_conf2 (...,)."""
SPEED_FORMS: dict[str, SpeedForm] = implemented(names.SPEED_FORMS, {"paper": speed_paper, "hinge": speed_hinge})


def forms(config: ComfortConfig) -> tuple[Form, Threshold, SpeedForm]:
    """Return the distance form, the threshold and the speed form of `config`.

    Raises:
      ConfigError: one of them is not there.
    """
    return (
        function("comfort.form", config.form, FORMS),
        function("comfort.threshold", config.threshold, THRESHOLDS),
        function("comfort.speed_form", config.speed_form, SPEED_FORMS),
    )


def speed_term(increment: Tensor, level: Tensor, max_step_deg: float, config: ComfortConfig) -> Tensor:
    """Return F_conf2 (...,) for the largest absolute joint increment (...,) of a step, degrees, at level (...,).

    The released code compares signed increments, so fast motion in the negative direction costs nothing there.
    """
    *_, form = forms(config)
    return form(increment, increment_threshold(level, max_step_deg, config), max_step_deg)


def discomfort(
    distance: Tensor, increment: Tensor, level: Tensor, max_step_deg: float, config: ComfortConfig
) -> Tensor:
    """Return (...,) in [0, 2]: how much nearer than theta and faster than its threshold the arm is.

    It is what `target_distance` and `speed_hinge` cost at weight 1, where the arm is nearer than theta or faster than
    the threshold; unlike F_comfort, distance and time cost nothing. Arguments are those of `comfort`.
    """
    theta = forms(config)[1](level, config)
    return -minimum_distance(distance, theta, config) - speed_hinge(
        increment, increment_threshold(level, max_step_deg, config), max_step_deg
    )


def comfort(
    distance: Tensor,
    increment: Tensor,
    level: Tensor,
    max_step_deg: float,
    config: ComfortConfig,
    home: Tensor | None = None,
) -> Tensor:
    """Return F_comfort = alpha F_conf1 + beta F_conf2 (Eq. 4), without `comfort.scale`; `home` is `distance_term`'s."""
    total = torch.zeros_like(distance)
    if config.alpha:
        total = total + config.alpha * distance_term(distance, level, config, home)
    if config.beta:
        total = total + config.beta * speed_term(increment, level, max_step_deg, config)
    return total
