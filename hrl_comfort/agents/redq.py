"""Randomised ensembled double Q-learning (Chen et al. 2021, arXiv:2101.05982): soft actor-critic with many critics."""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_comfort.agents.loss import ActorCriticLoss
from hrl_comfort.agents.networks import MeanCritics
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config.learning import REDQKeys


class REDQLoss(ActorCriticLoss):
    """Targets are the least value of some critics, drawn anew each time; the actor climbs the mean of all.

    Values and gradients are those of `torchrl.objectives.REDQLoss(loss_function="l2")`, which has the mean over the
    critics where this has the sum, as soft actor-critic's has.
    """

    subset: int
    """Number of targets that are drawn."""
    generator: torch.Generator | None = None
    """Of the draws; None: torch's global one."""

    def next_value(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the least value (B,) of a subset of the targets."""
        targets = self.target_qvalue_network
        drawn = torch.randperm(targets.count, generator=self.generator)[: self.subset]
        return targets(observation, action, only=drawn).amin(0)


class REDQ(SAC):
    """Soft actor-critic with many critics, which are updated more often than the actor."""

    Keys = REDQKeys
    own: REDQKeys
    critics_type = MeanCritics
    loss_type = REDQLoss

    def new_critics(self) -> MeanCritics:
        """Return critics with new weights."""
        return MeanCritics(*self.sizes, self.config.critic_layer_norm, self.own.critics)

    def new_loss(self) -> REDQLoss:
        """Return the loss of the networks."""
        loss = super().new_loss()
        assert isinstance(loss, REDQLoss)
        loss.subset, loss.generator = self.own.subset, self.generator
        return loss

    def actor_learns(self) -> bool:
        """Return whether the next update changes the actor too."""
        return super().actor_learns() and self.updates % self.own.updates_per_actor_update == 0
