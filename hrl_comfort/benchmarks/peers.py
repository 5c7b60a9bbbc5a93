"""Soft actor-critic of TorchRL and of Stable-Baselines3, with the hyperparameters of our own."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate

from hrl_comfort.config import AgentConfig

TRANSITION = ("observation", "action", *(("next", name) for name in ("observation", "reward", "terminated", "done")))


class TorchRLSAC:
    """SAC of TorchRL's loss, target updater and replay buffer, one fused Adam for all losses."""

    def __init__(self, agent: AgentConfig, observation_dim: int, action_dim: int, gamma: float) -> None:
        network: dict[str, Any] = {"num_cells": list(agent.hidden), "activation_class": nn.ReLU}
        body = nn.Sequential(MLP(observation_dim, 2 * action_dim, **network), NormalParamExtractor())
        self.policy = ProbabilisticActor(
            TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=TanhNormal,
            return_log_prob=True,
        )
        self.loss = SACLoss(
            self.policy,
            ValueOperator(MLP(observation_dim + action_dim, 1, **network), in_keys=["observation", "action"]),
            loss_function="l2",
            alpha_init=agent.entropy_coefficient,
            target_entropy=agent.target_entropy,
        )
        self.loss.make_value_estimator(gamma=gamma)
        self.target = SoftUpdate(self.loss, tau=agent.tau)
        self.optimiser = torch.optim.Adam(self.loss.parameters(), lr=agent.learning_rate, fused=True)
        storage = LazyTensorStorage(agent.buffer_size)
        self.buffer = TensorDictReplayBuffer(storage=storage, batch_size=agent.batch_size)

    def remember(self, transitions: TensorDictBase) -> None:
        """Store transitions (N,)."""
        self.buffer.extend(transitions.select(*TRANSITION))

    def update(self) -> None:
        """Do one gradient step on everything."""
        losses = self.loss(self.buffer.sample())
        self.optimiser.zero_grad(set_to_none=True)
        (losses["loss_qvalue"] + losses["loss_actor"] + losses["loss_alpha"]).backward()
        self.optimiser.step()
        self.target.step()


def stable_baselines3_sac(agent: AgentConfig, env: Any, gamma: float, **schedule: Any) -> Any:
    """Return Stable-Baselines3's SAC on a Gymnasium environment; `schedule` goes to its constructor."""
    from stable_baselines3 import SAC

    return SAC(
        "MlpPolicy", env, device="cpu", learning_rate=agent.learning_rate, tau=agent.tau, gamma=gamma,
        batch_size=agent.batch_size, buffer_size=agent.buffer_size, target_entropy=agent.target_entropy,
        ent_coef=f"auto_{agent.entropy_coefficient}", learning_starts=agent.learning_starts,
        policy_kwargs={"net_arch": list(agent.hidden)}, **schedule,
    )  # fmt: skip
