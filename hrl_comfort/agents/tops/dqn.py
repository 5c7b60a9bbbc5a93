"""Double DQN over the semi-MDP of options (van Hasselt, Guez, Silver 2016, arXiv:1509.06461) on TorchRL's DQNLoss.

An option of k control steps is discounted by gamma**k, which TorchRL takes from `steps_to_next_obs`.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import DQNLoss, ValueEstimators

from hrl_comfort.agents.tops.options import ReplayLearner, greedy


class DQN(ReplayLearner):
    """Double DQN with a soft target and uniform exploration among the options that can start."""

    copies = 6  # the network, its target, its average, gradients and two moments
    losses = ("loss",)

    def new_loss(self) -> DQNLoss:
        """Return the loss of the network and its target."""
        loss = DQNLoss(
            self.network, loss_function="smooth_l1", delay_value=True, double_dqn=True, action_space="categorical"
        )
        loss.make_value_estimator(ValueEstimators.TD0, gamma=self.config.gamma)
        return loss

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return options (N,): the best by value, or with probability `exploration` any that can start."""
        mask = now["action_mask"]
        best = greedy(self.network, now["observation"], mask)
        anything = torch.multinomial(mask.float(), 1).squeeze(1)
        return torch.where(torch.rand(len(best)) < exploration, anything, best)
