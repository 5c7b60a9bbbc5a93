"""Proximal policy optimisation over options (Schulman et al. 2017, arXiv:1707.06347) on TorchRL's ClipPPOLoss."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import MLP, ValueOperator
from torchrl.objectives import ClipPPOLoss

from hrl_comfort.agents.tops.options import OptionLearner, chances, policy_of
from hrl_comfort.config.hierarchy import PPOKeys


class PPO(OptionLearner):
    """A policy over options and a critic, which learn from each rollout once.

    Environments end options at different times, so a rollout is the latest options of all; each remembers the
    probability with which it was chosen.
    """

    Keys = PPOKeys
    own: PPOKeys
    quantity = "probability"
    copies = 9  # an actor, its average, a critic; gradients and two moments of both

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._rollout: list[TensorDictBase] = []
        self._log_prob = torch.zeros(0)
        """(N,) of the option in progress in each environment."""

    def new_loss(self) -> ClipPPOLoss:
        """Return the loss of the network and the critic."""
        self.critic = MLP(self.observation_dim, 1, num_cells=list(self.config.hidden), activation_class=nn.ReLU)
        loss = ClipPPOLoss(
            policy_of(self.network),
            ValueOperator(self.critic, in_keys=["observation"]),
            clip_epsilon=self.own.clip,
            entropy_coeff=self.own.entropy_weight,
            critic_coeff=self.own.value_weight,
            normalize_advantage=True,
        )
        loss.set_keys(sample_log_prob="action_log_prob")
        return loss

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return options (N,) of the policy, or with probability `exploration` any that can start."""
        chance = chances(self.network, now, exploration)
        action = torch.multinomial(chance, 1)
        log_prob, begins = chance.gather(1, action).log().squeeze(1), now["deciding"].reshape(-1)
        if len(self._log_prob) != len(log_prob):
            self._log_prob = log_prob
        self._log_prob = torch.where(begins, log_prob, self._log_prob)
        return action.squeeze(1)

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (F,) of `OptionEnv.transitions`, which name their environments (`row`)."""
        if len(transitions):
            self._rollout.append(transitions.clone().set("action_log_prob", self._log_prob[transitions["row"]]))

    def update(self) -> dict[str, float]:
        """Learn from the rollout, once it is complete; return the mean `loss`."""
        if sum(map(len, self._rollout)) < self.own.rollout:
            return {}
        batch = self.with_advantage(TensorDict.cat(self._rollout))
        self._rollout, losses = [], []
        for _ in range(self.own.epochs):
            for rows in torch.randperm(len(batch)).split(self.config.batch_size):
                losses.append(self.learn_from(batch[rows], "loss_objective", "loss_critic", "loss_entropy"))
                self.average.update_parameters(self.network)
        return {"loss": sum(losses) / len(losses)}

    @torch.no_grad()
    def with_advantage(self, batch: TensorDictBase) -> TensorDictBase:
        """Return transitions (F,), in the order in which they came, with `advantage` and `value_target` (F, 1)."""
        after = batch["next"]
        value, next_value = self.critic(batch["observation"]), self.critic(after["observation"])
        discount = self.config.gamma ** batch["steps_to_next_obs"]
        error = after["reward"] + discount * next_value * ~after["terminated"] - value
        advantage = advantages(error, discount * self.own.gae_lambda * ~after["done"], batch["row"])
        return batch.set("advantage", advantage).set("value_target", advantage + value)

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as plain data."""
        rollout = TensorDict.cat(self._rollout).to_dict() if self._rollout else {}
        return {**super().state_dict(), "rollout": rollout, "log_prob": self._log_prob}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        rollout = state["rollout"]
        self._rollout = [TensorDict.from_dict(rollout, auto_batch_size=True, batch_dims=1)] if rollout else []
        self._log_prob = state["log_prob"]
        super().load_state_dict(state)


def advantages(error: Tensor, decay: Tensor, row: Tensor) -> Tensor:
    """Return generalised advantages (F, 1) (Schulman et al. 2016, arXiv:1506.02438) of options that ended in order.

    `error` is their temporal difference, `decay` what the advantage of the next option of the same `row` (F,) counts,
    both (F, 1).
    """
    found, following = torch.empty_like(error), torch.zeros(int(row.max()) + 1, dtype=error.dtype)
    for index in range(len(error) - 1, -1, -1):
        at = row[index]
        following[at] = found[index, 0] = error[index, 0] + decay[index, 0] * following[at]
    return found
