"""CrossQ (Bhatt et al. 2024, arXiv:1902.05605): soft actor-critic with batch normalisation and without targets."""

from __future__ import annotations

from typing import Self

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from hrl_comfort.agents.loss import ActorCriticLoss
from hrl_comfort.agents.memory import check_networks
from hrl_comfort.agents.networks import Critics
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config.learning import CrossQKeys

MAX_SCALE, MAX_SHIFT, FLOOR = 3.0, 5.0, 1e-5
"""Bounds of the corrections of batch renormalisation, and the least variance (Ioffe 2017)."""


class NormalisedCritics(Critics):
    """Two critics with batch renormalisation (Ioffe 2017, arXiv:1702.03275) before each layer.

    Called, they normalise by their running statistics; `trained` takes a batch into these.
    """

    seen: Tensor

    def __init__(
        self, observation_dim: int, action_dim: int, hidden: list[int], momentum: float = 0.01, warmup: int = 0
    ) -> None:
        super().__init__(observation_dim, action_dim, hidden)
        self.momentum, self.warmup = momentum, warmup
        shapes = [(self.count, 1, weight.shape[1]) for weight in self.weights]
        self.scales = nn.ParameterList([nn.Parameter(torch.ones(shape)) for shape in shapes])
        self.shifts = nn.ParameterList([nn.Parameter(torch.zeros(shape)) for shape in shapes])
        for index, shape in enumerate(shapes):
            self.register_buffer(f"mean_{index}", torch.zeros(shape))
            self.register_buffer(f"variance_{index}", torch.ones(shape))
        self.register_buffer("seen", torch.zeros(()))

    def forward(self, observation: Tensor, action: Tensor, frozen: bool = False, only: Tensor | None = None) -> Tensor:
        """Return Q (2, B) of normalised observations (B, D); `frozen` keeps gradients off the weights."""
        assert only is None
        return self._values(observation, action, frozen, trains=False)

    def trained(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return Q (2, B) by the statistics of this batch, corrected towards the running ones, and count it in."""
        found = self._values(observation, action, frozen=False, trains=True)
        self.seen += 1
        return found

    def _values(self, observation: Tensor, action: Tensor, frozen: bool, trains: bool) -> Tensor:
        x = torch.cat([observation, action], dim=-1).expand(self.count, -1, -1)
        lists = (self.scales, self.shifts, self.weights, self.biases)
        layers = zip(*([each.detach() for each in one] if frozen else one for one in lists), strict=True)
        for index, (scale, shift, weight, bias) in enumerate(layers):
            x = x.relu() if index else x
            x = torch.baddbmm(bias, scale * self._normalised(x, index, trains) + shift, weight)
        return x[..., 0]

    def _normalised(self, x: Tensor, index: int, trains: bool) -> Tensor:
        mean, variance = (self.get_buffer(f"{name}_{index}") for name in ("mean", "variance"))
        spread = (variance + FLOOR).sqrt()
        if not trains:
            return (x - mean) / spread
        here, around = x.mean(1, keepdim=True), x.var(1, keepdim=True, correction=0)
        x = (x - here) / (around + FLOOR).sqrt()
        with torch.no_grad():
            scale = ((around + FLOOR).sqrt() / spread).clamp(1 / MAX_SCALE, MAX_SCALE)
            shift = ((here - mean) / spread).clamp(-MAX_SHIFT, MAX_SHIFT)
            mean.lerp_(here, self.momentum)
            variance.lerp_(around * x.shape[1] / (x.shape[1] - 1), self.momentum)
        return x * scale + shift if self.seen >= self.warmup else x

    @classmethod
    def of_state(cls, observation_dim: int, action_dim: int, hidden: list[int], state: dict[str, Tensor]) -> Self:
        """Return critics of the shape of those whose `state_dict` this is; they have widths of their own."""
        layers = sum(name.startswith("weights.") for name in state)
        widths = [state[f"weights.{layer}"].shape[2] for layer in range(layers)]
        return cls(observation_dim, action_dim, widths[:-1])


class CrossQLoss(ActorCriticLoss):
    """The critics see the batch and what follows it at once, so both have the same statistics.

    Values and gradients are those of `torchrl.objectives.CrossQLoss(loss_function="l2")`.
    """

    qvalue_network: NormalisedCritics

    def critic_loss(self, tensordict: TensorDictBase, next_action: Tensor, penalty: Tensor) -> tuple[Tensor, Tensor]:
        """Return the squared temporal difference, summed over both critics, and their values (2, B)."""
        pairs = (
            (tensordict.get("observation"), tensordict.get("next").get("observation")),
            (tensordict.get("action"), next_action),
        )
        value, after = self.qvalue_network.trained(*map(torch.cat, pairs)).chunk(2, dim=1)
        target = self.target(tensordict, after.detach().amin(0) - penalty)
        return (value - target).square().sum(0).mean(), value


class CrossQ(SAC):
    """Soft actor-critic with normalised critics, without targets; the actor has no normalisation, as that of SAC."""

    Keys = CrossQKeys
    own: CrossQKeys
    critics_type = NormalisedCritics
    loss_type = CrossQLoss
    has_targets = False
    betas = (0.5, 0.999)

    def new_critics(self) -> NormalisedCritics:
        """Return critics with new weights."""
        hidden = list(self.own.critic_hidden)
        sizes = (self.observation_dim + self.action_dim, *hidden, 1)
        check_networks(f"agent.own.critic_hidden={hidden}", 2 * 4, sizes)  # weights, gradients and two moments
        own = self.own.momentum, self.own.warmup_updates
        return NormalisedCritics(self.observation_dim, self.action_dim, hidden, *own)

    def actor_learns(self) -> bool:
        """Return whether the next update changes the actor too."""
        return super().actor_learns() and self.updates % self.own.updates_per_actor_update == 0
