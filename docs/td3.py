"""TD3 (Fujimoto et al. 2018, arXiv:1802.09477) as a learner: `hrl-comfort train agent=td3:TD3`."""

from dataclasses import dataclass

import torch
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, Actor, ValueOperator
from torchrl.objectives import SoftUpdate, TD3Loss

from hrl_comfort.agents.replay import load_replay, replay_state


class TD3:
    """Networks, loss, optimiser and replay buffer; `policy` is what the run keeps."""

    terms = ("critic_loss", "actor_loss")

    @dataclass(frozen=True)
    class Keys:
        """Keys `agent.own`."""

        noise: float = 0.1

    def __init__(self, config, observation_dim, action_dim, own):
        self.batch_size, self.noise = config.batch_size, own.noise
        sizes = {"num_cells": list(config.hidden), "activation_class": torch.nn.ReLU}
        self.policy = torch.nn.Sequential(MLP(observation_dim, action_dim, **sizes), torch.nn.Tanh())
        critic = ValueOperator(MLP(observation_dim + action_dim, 1, **sizes), ["observation", "action"])
        self.loss = TD3Loss(Actor(self.policy, ["observation"]), critic, bounds=(-1.0, 1.0))
        self.loss.make_value_estimator(gamma=config.gamma)
        self.target = SoftUpdate(self.loss, tau=config.tau)
        self.optimiser = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate)
        self.buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(config.buffer_size))

    @torch.no_grad()
    def act(self, now, exploration):
        action = self.policy(now["observation"])
        action = (action + self.noise * torch.randn_like(action)).clamp(-1, 1)
        return torch.where(torch.rand(len(action), 1) < exploration, torch.rand_like(action) * 2 - 1, action)

    def observe(self, transitions):
        self.buffer.extend(transitions.set(("next", "done"), transitions["next", "terminated"]))

    def update(self):
        losses = self.loss(self.buffer.sample(self.batch_size))
        (losses["loss_qvalue"] + losses["loss_actor"]).backward()
        self.optimiser.step()
        self.optimiser.zero_grad()
        self.target.step()
        return {"critic_loss": losses["loss_qvalue"].item(), "actor_loss": losses["loss_actor"].item()}

    def state_dict(self):
        kept = {"loss": self.loss.state_dict(), "optimiser": self.optimiser.state_dict()}
        return {**kept, "random": torch.get_rng_state(), **replay_state(self.buffer)}

    def load_state_dict(self, state):
        for name in ("loss", "optimiser"):
            getattr(self, name).load_state_dict(state[name])
        load_replay(self.buffer, state)
        torch.set_rng_state(state["random"])
