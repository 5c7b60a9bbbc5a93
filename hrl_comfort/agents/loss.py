"""Soft actor-critic's losses (Haarnoja et al. 2018, arXiv:1812.05905) as a TorchRL loss module."""

import math

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import LossModule

from hrl_comfort.agents.networks import Actor, Critics


class ActorCriticLoss(LossModule):
    """Losses of an actor, its critics and the entropy coefficient.

    Values and gradients are those of `torchrl.objectives.SACLoss(loss_function="l2")`. It is faster because
    the critics are one batched product and actions are sampled without distribution objects.
    """

    qvalue_network: Critics
    target_qvalue_network: Critics

    def __init__(
        self,
        actor: Actor,
        critics: Critics,
        targets: Critics | None,
        gamma: float,
        target_entropy: float,
        entropy_coefficient: float,
    ) -> None:
        """Take over the networks; `gamma` discounts per control step, the coefficient is the initial one."""
        super().__init__()
        after = [("next", name) for name in ("observation", "reward", "terminated")]
        self.in_keys = ["observation", "action", "steps_to_next_obs", *after]
        self.out_keys = ["loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy", "q_mean"]
        self.gamma, self.target_entropy = gamma, target_entropy
        self.actor_network, self.qvalue_network = actor, critics
        if targets is not None:
            self.target_qvalue_network = targets.requires_grad_(False)
        device = next(actor.parameters()).device
        self.log_alpha = nn.Parameter(torch.tensor(math.log(entropy_coefficient), device=device))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return losses (eq. 5, 7 and 18), alpha, entropy and mean Q, all scalars.

        `tensordict` (B,) holds `in_keys`: observations (B, D) and actions (B, A), all others (B, 1). Where it
        holds `noise` (B, A) and `next_noise`, these are the standard normal draws of the two actions.
        The loss of alpha is taken in log alpha, as TorchRL does.
        """
        observation, next_observation = tensordict.get("observation"), tensordict.get("next").get("observation")
        next_noise, noise = (self._noise(tensordict, name) for name in ("next_noise", "noise"))
        alpha = self.log_alpha.detach().exp()
        with torch.no_grad():
            next_action, next_log_prob = self.actor_network.sample(next_observation, next_noise)
        loss_qvalue, value = self.critic_loss(tensordict, next_action, alpha * next_log_prob)
        action, log_prob = self.actor_network.sample(observation, noise)
        entropy = -log_prob.detach().mean()
        losses = {
            "loss_actor": (alpha * log_prob - self.qvalue_network.value(observation, action, frozen=True)).mean(),
            "loss_qvalue": loss_qvalue,
            "loss_alpha": self.log_alpha * (entropy - self.target_entropy),
            "alpha": alpha,
            "entropy": entropy,
            "q_mean": value.detach().mean(),
        }
        return TensorDict(losses)

    def critic_loss(self, tensordict: TensorDictBase, next_action: Tensor, penalty: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss of the critics and what they say of the batch, for the next actions (B, A).

        `penalty` (B,), α log π of these actions, is taken off their value.
        """
        with torch.no_grad():
            next_value = self.next_value(tensordict.get("next").get("observation"), next_action)
            target = self.target(tensordict, next_value - penalty)
        value = self.qvalue_network(tensordict.get("observation"), tensordict.get("action"))
        return (value - target).square().sum(0).mean(), value

    def next_value(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the values (B,) of next observations and actions: the least of the targets'."""
        return self.target_qvalue_network(observation, action).amin(0)

    def target(self, tensordict: TensorDictBase, next_value: Tensor) -> Tensor:
        """Return reward plus discounted next values (…, B)."""
        after = tensordict.get("next")
        discount = torch.where(after.get("terminated"), 0.0, self.gamma ** tensordict.get("steps_to_next_obs"))
        return after.get("reward")[:, 0] + discount[:, 0] * next_value

    def _noise(self, tensordict: TensorDictBase, name: str) -> Tensor:
        given = tensordict.get(name, None)
        return torch.randn_like(tensordict.get("action")) if given is None else given

    @torch.no_grad()
    def update_targets(self, tau: float) -> None:
        """Move the targets towards the critics by `tau`, in one call over all tensors."""
        targets, critics = self.target_qvalue_network.parameters(), self.qvalue_network.parameters()
        torch._foreach_lerp_([*targets], [*critics], tau)


def bc_loss(observation: Tensor, action: Tensor, actor: Actor, critics: Critics) -> Tensor:
    """Return the squared distance of the actor's mode from demonstrated actions that are better.

    Behaviour cloning with a Q-filter (Nair et al. 2018, arXiv:1709.10089, section IV-C): an action counts
    only where the critics prefer it to the mode. Normalised observations (B, D), actions (B, A);
    a scalar, the sum over the B.
    """
    mode = actor.mode(observation)
    with torch.no_grad():
        better = critics.value(observation, action) > critics.value(observation, mode)
    return ((mode - action).square().sum(-1) * better).sum()
