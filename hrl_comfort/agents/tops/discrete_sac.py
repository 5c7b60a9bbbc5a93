"""Soft actor-critic over options (Christodoulou 2019, arXiv:1910.07207) on TorchRL's DiscreteSACLoss."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import MLP
from torchrl.modules.tensordict_module import SafeModule
from torchrl.objectives import DiscreteSACLoss, ValueEstimators

from hrl_comfort.agents.tops.options import ReplayLearner, chances, policy_of
from hrl_comfort.config.hierarchy import DiscreteSACKeys


class DiscreteSAC(ReplayLearner):
    """A policy over options, two critics of the values of all options, and a learnt entropy coefficient."""

    Keys = DiscreteSACKeys
    own: DiscreteSACKeys
    quantity = "probability"
    copies = 15  # an actor, its average, two critics, their targets; gradients and two moments of those that learn
    losses = ("loss_actor", "loss_qvalue", "loss_alpha")

    def new_loss(self) -> DiscreteSACLoss:
        """Return the loss of the network, the critics and their targets."""
        critic = MLP(
            self.observation_dim, self.count, num_cells=list(self.config.hidden), activation_class=nn.ReLU
        )  # fmt: skip
        loss = DiscreteSACLoss(
            policy_of(self.network),
            SafeModule(critic, in_keys=["observation"], out_keys=["action_value"]),
            action_space="categorical",
            num_actions=self.count,
            alpha_init=self.own.entropy_coefficient,
            target_entropy=self.own.target_entropy,
        )
        loss.make_value_estimator(ValueEstimators.TD0, gamma=self.config.gamma)
        return loss

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return options (N,) of the policy, or with probability `exploration` any that can start."""
        return torch.multinomial(chances(self.network, now, exploration), 1).squeeze(1)
