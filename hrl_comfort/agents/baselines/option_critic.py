"""Option-critic (Bacon et al. 2017, arXiv:1609.05140) over actions: options whose policies and ends are learned.

Here on soft actor-critic, from a replay buffer: actor and critics also see which option is in force. As in that work,
values are those of rewards alone. One function of them, the value of an option at the mode of its policy, gives the
targets (eq. 3), the advantages of terminations (theorem 2), and the option that is chosen, in training and afterwards.
The entropy of soft actor-critic is only part of what the policies of options learn from.
"""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import one_hot
from torchrl.modules import MLP

from hrl_comfort.agents.loss import ActorCriticLoss
from hrl_comfort.agents.networks import Actor, Critics
from hrl_comfort.agents.sac import SAC, TERMS
from hrl_comfort.config.learning import OptionCriticKeys

NONE = -1
"""No option is in force: an episode begins."""


def with_options(seen: Tensor, count: int) -> Tensor:
    """Return normalised observations (B, D) with each of K options in force, (B K, D + K)."""
    options = torch.eye(count, device=seen.device).expand(len(seen), -1, -1)
    return torch.cat([seen[:, None].expand(-1, count, -1), options], dim=-1).flatten(0, 1)


def values_of(seen: Tensor, actor: Actor, critics: Critics, count: int) -> Tensor:
    """Return the values (B, K) of options, at the modes of their policies."""
    each = with_options(seen, count)
    return critics.value(each, actor.mode(each)).view(-1, count)


class OptionCriticLoss(ActorCriticLoss):
    """Losses of the policies of options, of their critics and of their terminations."""

    terminations: nn.Module
    size: int
    """Numbers of an observation without the option."""
    count: int
    deliberation_cost: float

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the losses of soft actor-critic, `loss_termination` and the mean `termination`, all scalars.

        `tensordict` holds observations with the option in force (B, D + K).
        """
        with torch.no_grad():
            self._values = self.option_values(tensordict)
        losses = super().forward(tensordict)
        ends, own, best = self.after(tensordict)
        alive = ~tensordict.get("next").get("terminated")[:, 0]
        losses["loss_termination"] = (ends * (own - best + self.deliberation_cost) * alive).mean()
        losses["termination"] = ends.detach().mean()
        return losses

    def after(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor, Tensor]:
        """Return, (B,) each, with which probability the option in force ends, its value, and that of the best."""
        seen, option = tensordict.get("next").get("observation").split([self.size, self.count], dim=-1)
        ends = (self.terminations(seen).sigmoid() * option).sum(1)
        return ends, (self._values * option).sum(1), self._values.amax(1)

    def option_values(self, tensordict: TensorDictBase) -> Tensor:
        """Return the values (B, K) of the options in the next observations, by the targets."""
        seen = tensordict.get("next").get("observation")[:, : self.size]
        return values_of(seen, self.actor_network, self.target_qvalue_network, self.count)

    def critic_loss(self, tensordict: TensorDictBase, next_action: Tensor, penalty: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss of the critics, whose target is the value of arriving with the option (eq. 3), and values."""
        with torch.no_grad():
            ends, own, best = self.after(tensordict)
            target = self.target(tensordict, (1 - ends) * own + ends * best)
        value = self.qvalue_network(tensordict.get("observation"), tensordict.get("action"))
        return (value - target).square().sum(0).mean(), value


class OptionPolicy(nn.Module):
    """The best option until it ends, then the next; its memory is which is in force (one-hot)."""

    def __init__(self, learner: OptionCritic) -> None:
        super().__init__()
        self.actor, self.critics = learner.average, learner.critics
        self.normaliser, self.terminations = learner.normaliser, learner.terminations
        self.memory_dim = learner.own.options

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (N, A) and the options in force (N, K) for raw observations (N, D) and those before.

        An option ends where it more likely does than not.
        """
        seen, count = self.normaliser(observation), self.memory_dim
        ends = (self.terminations(seen).sigmoid() * memory).sum(1) > 0.5
        best = one_hot(values_of(seen, self.actor, self.critics, count).argmax(1), count).to(memory.dtype)
        option = torch.where((ends | (memory.sum(1) < 0.5))[:, None], best, memory)
        return self.actor.mode(torch.cat([seen, option], dim=1)), option


class OptionCritic(SAC):
    """The learner: soft actor-critic whose networks also see the option in force, and the ends of options."""

    Keys = OptionCriticKeys
    own: OptionCriticKeys
    losses: ClassVar[dict[str, str]] = {
        **TERMS, "termination_loss": "loss_termination", "termination": "termination",
    }  # fmt: skip
    terms = tuple(losses)
    loss_type = OptionCriticLoss

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.policy = OptionPolicy(self)
        self._option = torch.zeros(0, dtype=torch.int64)
        """(N,) in force, or NONE."""

    @property
    def sizes(self) -> tuple[int, int, list[int]]:
        """Sizes of observation, with the option in force, and action, and the widths of the hidden layers."""
        return self.observation_dim + self.own.options, self.action_dim, list(self.config.hidden)

    def new_loss(self) -> OptionCriticLoss:
        """Return the loss of the networks, with new terminations."""
        count = self.own.options
        self.terminations = MLP(
            self.observation_dim, count, num_cells=list(self.config.hidden), activation_class=nn.ReLU
        ).to(self.device)  # fmt: skip
        loss = super().new_loss()
        assert isinstance(loss, OptionCriticLoss)
        loss.terminations, loss.size, loss.count = self.terminations, self.observation_dim, count
        loss.deliberation_cost = self.own.deliberation_cost
        return loss

    def weights(self) -> list[nn.Parameter]:
        """Return all that is learned."""
        return [*super().weights(), *self.terminations.parameters()]

    def actor_loss(self, losses: TensorDictBase, batch: TensorDict) -> Tensor:
        """Return what the actor, the entropy coefficient and the terminations learn from."""
        loss: Tensor = super().actor_loss(losses, batch) + losses["loss_termination"]
        return loss

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return actions (N, A) of the options in force, the next ones where these end."""
        rows, count = len(now["observation"]), self.own.options
        if len(self._option) != rows:
            self._option = torch.full((rows,), NONE)
        seen = self.normaliser(now["observation"].to(self.device))
        ends = self.terminations(seen).sigmoid().cpu().gather(1, self._option.clamp(min=0)[:, None])[:, 0]
        over = (torch.rand(rows, generator=self.generator) < ends) | (self._option == NONE)
        best = values_of(seen, self.actor, self.critics, count).argmax(1).cpu()
        drawn = torch.randint(count, (rows,), generator=self.generator)
        explores = torch.rand(rows, generator=self.generator) < max(exploration, self.own.exploration)
        self._option = torch.where(over, torch.where(explores, drawn, best), self._option)
        noise = torch.randn(rows, self.action_dim, generator=self.generator).to(self.device)
        if exploration == 1.0:
            return torch.rand((rows, self.action_dim), generator=self.generator) * 2 - 1
        option = one_hot(self._option.to(self.device), count).float()
        return self.actor.sample(torch.cat([seen, option], dim=1), noise)[0].cpu()

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (N,), one of each environment, with the option in force."""
        super().observe(transitions.clone(recurse=False).set("option", self._option.clone()))
        self._option = self._option.masked_fill(transitions["next", "done"][:, 0], NONE)

    def sample(self) -> TensorDict:
        """Return B transitions as of any soft actor-critic, with the option in force in the observations."""
        batch = super().sample()
        option = one_hot(batch["option"], self.own.options).float()
        for part in (batch, batch["next"]):
            part["observation"] = torch.cat([part["observation"], option], dim=1)
        return batch

    def begin_stage(self, *given: Any) -> None:
        """Go on in another stage, whose episodes begin."""
        super().begin_stage(*given)
        self._option = self._option[:0]

    def networks_state(self) -> dict[str, Any]:
        """Return the learnt tensors, without the targets."""
        return {**super().networks_state(), "terminations": self.terminations.state_dict()}

    def load_networks(self, state: dict[str, Any]) -> None:
        """Take over the tensors of `networks_state`."""
        super().load_networks(state)
        self.terminations.load_state_dict(state["terminations"])

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {**super().state_dict(), "option": self._option}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, in a learner that has stored nothing yet."""
        super().load_state_dict(state)
        self._option = state["option"]
