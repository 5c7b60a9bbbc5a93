"""Networks of soft actor-critic: a tanh-Gaussian actor, critics, and what they see first.

All float32. B is a batch, D the observation's size, A the action's.
"""

import math
from itertools import pairwise
from typing import Any, Self

import torch
from torch import Tensor, nn

LOG_STD_MIN, LOG_STD_MAX = -10.0, 2.0
NORMALISED_LIMIT = 5.0
"""Normalised observations are clamped to this many standard deviations."""
FARTHEST = 1e6
"""No observation, normalised or not, is larger."""


class Normaliser(nn.Module):
    """Shift and scale observations by the running mean and variance of those collected.

    Statistics are exact over everything seen (Chan et al. 1979, parallel variance), in float64 buffers,
    and change in `update` only, so learning and acting on one day see the same numbers.
    """

    count: Tensor
    mean: Tensor
    variance: Tensor
    _shift: Tensor
    _scale: Tensor

    def __init__(self, observation_dim: int, enabled: bool = True) -> None:
        super().__init__()
        self.enabled = enabled
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(observation_dim, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(observation_dim, dtype=torch.float64))
        # What `_refresh` makes of these, which on the meta device would import the compiler of torch, a second.
        self.register_buffer("_shift", torch.zeros(observation_dim), persistent=False)
        self.register_buffer("_scale", torch.ones(observation_dim), persistent=False)

    def _refresh(self) -> None:
        self._shift = self.mean.float()
        # A feature that never changed has variance 0: the floor keeps its (zero) deviation finite.
        self._scale = self.variance.sqrt().clamp_min(1e-3).reciprocal().float()

    @torch.no_grad()
    def update(self, observation: Tensor) -> None:
        """Take (B, D) newly collected observations into the statistics."""
        if not self.enabled:
            return
        batch = observation.double()
        count, mean = batch.shape[0], batch.mean(0)
        total = self.count + count
        delta = mean - self.mean
        scatter = self.variance * self.count + (batch - mean).square().sum(0)
        self.variance.copy_((scatter + delta.square() * self.count * count / total) / total)
        self.mean.add_(delta * count / total)
        self.count.copy_(total)
        self._refresh()

    def forward(self, observation: Tensor) -> Tensor:
        """Return (..., D) normalised observations."""
        if not self.enabled:
            return observation
        scaled = (observation - self._shift) * self._scale
        return scaled.clamp_(-NORMALISED_LIMIT, NORMALISED_LIMIT)

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        """Load the statistics, as part of a larger module too (see nn.Module)."""
        super()._load_from_state_dict(*args, **kwargs)
        self._refresh()


def tanh_gaussian(mean: Tensor, log_std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Return tanh(mean + std noise) (B, A) and its log-probability (B,), for standard normal `noise`."""
    raw = mean + log_std.exp() * noise
    gaussian = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
    # log(1 - tanh(u)^2), written so that it does not underflow for large |u|
    squash = 2 * (math.log(2) - raw - nn.functional.softplus(-2 * raw))
    return raw.tanh(), (gaussian - squash).sum(-1)


class Actor(nn.Module):
    """Gaussian squashed by tanh into [-1, 1] (Haarnoja et al. 2018, appendix C)."""

    def __init__(self, observation_dim: int, action_dim: int, hidden: list[int]) -> None:
        super().__init__()
        sizes = [observation_dim, *hidden]
        layers: list[nn.Module] = []
        for fan_in, fan_out in pairwise(sizes):
            layers += [nn.Linear(fan_in, fan_out), nn.ReLU(inplace=True)]
        self.body = nn.Sequential(*layers, nn.Linear(sizes[-1], 2 * action_dim))

    def bounded(self) -> bool:
        """Return whether no observation makes a layer exceed what float32 holds."""
        layers = [layer for layer in self.body if isinstance(layer, nn.Linear)]
        reach = torch.full((layers[0].in_features,), FARTHEST)
        for layer in layers:
            reach = layer.weight.abs() @ reach + layer.bias.abs()
        return bool(reach.isfinite().all())

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation (B, A) before the tanh, of normalised (B, D) observations."""
        mean, log_std = self._gaussian(observation)
        return mean, log_std.exp()

    def _gaussian(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_std = self.body(observation).chunk(2, dim=-1)
        return mean, log_std.clamp(LOG_STD_MIN, LOG_STD_MAX)

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (B, A) and their log-probability (B,) for standard normal `noise` (B, A)."""
        return tanh_gaussian(*self._gaussian(observation), noise)

    def mode(self, observation: Tensor) -> Tensor:
        """Return the deterministic action (B, A): the tanh of the mean."""
        return self(observation)[0].tanh()


class Critics(nn.Module):
    """Several action values, by default two, in one pass: weights are stacked (C, in, out) and multiplied as a batch.

    With `layer_norm`, every hidden layer is normalised before its ReLU, without a learned scale and shift: with them
    an update takes 43 % more time than without normalisation, instead of 15.
    """

    def __init__(
        self, observation_dim: int, action_dim: int, hidden: list[int], layer_norm: bool = False, count: int = 2,
        outputs: int = 1,
    ) -> None:  # fmt: skip
        super().__init__()
        self.count = count
        sizes = [observation_dim + action_dim, *hidden, outputs]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for fan_in, fan_out in pairwise(sizes):
            bound = 1 / math.sqrt(fan_in)  # as nn.Linear starts
            self.weights.append(nn.Parameter(torch.empty(count, fan_in, fan_out).uniform_(-bound, bound)))
            self.biases.append(nn.Parameter(torch.empty(count, 1, fan_out).uniform_(-bound, bound)))
        self.layer_norm = layer_norm
        if layer_norm:
            self.register_buffer("layer_norm_mark", torch.ones(()))  # files tell by it which critics they hold

    def forward(self, observation: Tensor, action: Tensor, frozen: bool = False, only: Tensor | None = None) -> Tensor:
        """Return what the critics say (C, B) of normalised observations (B, D), with several outputs O (C, B, O).

        `frozen` keeps gradients off the weights; with `only`, indices of critics, the others are left out.
        """
        lists = (self.weights, self.biases)
        weights, biases = ([each.detach() for each in one] if frozen else [*one] for one in lists)
        if only is not None:
            weights, biases = ([each[only] for each in one] for one in (weights, biases))
        x = torch.cat([observation, action], dim=-1).expand(len(weights[0]), -1, -1)
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            x = torch.baddbmm(bias, x, weight)
            if self.layer_norm:
                x = nn.functional.layer_norm(x, x.shape[-1:])
            x = x.relu_()
        if weights[-1].shape[-1] > 1:
            return torch.baddbmm(biases[-1], x, weights[-1])
        # A batched product with matrices one column wide is slower.
        return (x * weights[-1].mT).sum(-1) + biases[-1][..., 0]

    def value(self, observation: Tensor, action: Tensor, frozen: bool = False) -> Tensor:
        """Return the values (B,) that an actor climbs: the least of the critics'."""
        return self(observation, action, frozen).amin(0)

    @classmethod
    def of_state(cls, observation_dim: int, action_dim: int, hidden: list[int], state: dict[str, Tensor]) -> Self:
        """Return critics of the shape of those whose `state_dict` this is.

        Raises:
            KeyError, IndexError: it is not one of them.
        """
        count, _, outputs = state[f"weights.{len(hidden)}"].shape
        return cls(observation_dim, action_dim, hidden, "layer_norm_mark" in state, count, outputs)


class MeanCritics(Critics):
    """Critics of which an actor climbs the mean, over their outputs too."""

    def value(self, observation: Tensor, action: Tensor, frozen: bool = False) -> Tensor:
        """Return the mean (B,) of all that the critics say."""
        said = self(observation, action, frozen)
        return said.mean((0, *range(2, said.ndim)))
