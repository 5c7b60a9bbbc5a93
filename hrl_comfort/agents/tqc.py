"""Truncated quantile critics (Kuznetsov et al. 2020, arXiv:2005.04269): soft actor-critic with quantiles."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import huber_loss

from hrl_comfort.agents.loss import ActorCriticLoss
from hrl_comfort.agents.networks import MeanCritics
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config.learning import TQCKeys


class TQCLoss(ActorCriticLoss):
    """Quantile regression towards the pooled quantiles of all targets without the highest.

    Values and gradients are those of `torchrl.objectives.TQCLoss`.
    """

    dropped: int
    """Number of quantiles, for each critic, that targets leave out."""

    def critic_loss(self, tensordict: TensorDictBase, next_action: Tensor, penalty: Tensor) -> tuple[Tensor, Tensor]:
        """Return the quantile Huber loss (eq. 6), summed over the critics, and their quantiles (C, B, Q)."""
        with torch.no_grad():
            after = self.target_qvalue_network(tensordict.get("next").get("observation"), next_action)
            pooled = after.movedim(1, 2).flatten(0, 1).sort(dim=0).values
            kept = pooled[: len(pooled) - self.dropped * len(after)]
            target = self.target(tensordict, kept - penalty).T
        quantiles = self.qvalue_network(tensordict.get("observation"), tensordict.get("action"))
        count = quantiles.shape[-1]
        levels = (torch.arange(count, device=quantiles.device) + 0.5) / count
        wanted, predicted = torch.broadcast_tensors(target[:, None], quantiles[..., None])
        weight = (levels[:, None] - (wanted < predicted.detach()).float()).abs()
        loss = weight * huber_loss(predicted, wanted, reduction="none")
        return loss.mean((2, 3)).sum(0).mean(), quantiles


class TQC(SAC):
    """Soft actor-critic whose critics predict quantiles; the actor climbs the mean of all."""

    Keys = TQCKeys
    own: TQCKeys
    critics_type = MeanCritics
    loss_type = TQCLoss

    def new_critics(self) -> MeanCritics:
        """Return critics with new weights."""
        return MeanCritics(*self.sizes, self.config.critic_layer_norm, self.own.critics, self.own.quantiles)

    def new_loss(self) -> TQCLoss:
        """Return the loss of the networks."""
        loss = super().new_loss()
        assert isinstance(loss, TQCLoss)
        loss.dropped = self.own.dropped
        return loss
