"""Soft actor-critic (Haarnoja et al. 2018, arXiv:1812.05905) on TorchRL's replay buffer."""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from hrl_comfort.agents.networks import Actor, Normaliser, TwinCritics
from hrl_comfort.agents.replay import load_replay, replay_state
from hrl_comfort.config import AgentConfig, ConfigError

FLOAT_BYTES = 4
TERMS = ("critic_loss", "actor_loss", "alpha_loss", "alpha", "entropy", "q_mean")


class TrainingDiverged(FloatingPointError):
    """A training term is not finite any more; the message names the update and the term."""


@dataclass(frozen=True)
class Batch:
    """B transitions of one decision each, observations normalised.

    Those of P policies that learn together have a dimension (P, ...) before it.
    """

    observation: Tensor
    """(B, D)."""
    action: Tensor
    """(B, A) in [-1, 1]."""
    reward: Tensor
    """(B,), summed over the decision."""
    next_observation: Tensor
    """(B, D)."""
    discount: Tensor
    """(B,): gamma to the power of the decision's control steps; 0 where the episode terminated."""


class Sampler(Protocol):
    """EpisodeSampler actions."""

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (B, A) and their log-probability (B,) for standard normal `noise` (B, A)."""


class Values(Protocol):
    """Twin critics."""

    def __call__(self, observation: Tensor, action: Tensor, frozen: bool = False) -> Tensor:
        """Return Q (2, B); `frozen` keeps gradients off the weights."""


def sac_losses(
    batch: Batch,
    actor: Sampler,
    critics: Values,
    targets: Values,
    log_alpha: Tensor,
    target_entropy: float,
    noise: Tensor,
    next_noise: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return critic loss (eq. 5), actor loss (eq. 7), alpha loss (eq. 18), entropy and mean Q, all scalars.

    Of P policies together, whose batches and `log_alpha` are (P, ...) and Q (2, P, B), they are (P,). The
    same values and gradients as `torchrl.objectives.SACLoss(loss_function="l2")`, which a test holds it to;
    `noise` and `next_noise` (B, A) are the standard normal draws of the two actions.
    Alpha's loss is taken in log alpha, as TorchRL does.
    """
    alpha = log_alpha.detach().exp()[..., None]
    with torch.no_grad():
        next_action, next_log_prob = actor.sample(batch.next_observation, next_noise)
        next_value = targets(batch.next_observation, next_action).amin(0) - alpha * next_log_prob
        target = batch.reward + batch.discount * next_value
    value = critics(batch.observation, batch.action)
    critic_loss = (value - target).square().sum(0).mean(-1)

    action, log_prob = actor.sample(batch.observation, noise)
    actor_loss = (alpha * log_prob - critics(batch.observation, action, frozen=True).amin(0)).mean(-1)

    entropy = -log_prob.detach().mean(-1)
    alpha_loss = log_alpha * (entropy - target_entropy)
    return critic_loss, actor_loss, alpha_loss, entropy, value.detach().mean((0, -1))


def terms_of(losses: tuple[Tensor, ...], log_alpha: Tensor) -> Tensor:
    """Return the values of `TERMS` (6,), or (6, P) of P policies, from what `sac_losses` returns."""
    critic_loss, actor_loss, alpha_loss, entropy, q_mean = losses
    scalars = [critic_loss, actor_loss, alpha_loss, log_alpha.exp(), entropy, q_mean]
    return torch.stack([each.detach() for each in scalars])


def bc_loss(observation: Tensor, action: Tensor, value: Tensor, actor: Actor, critics: TwinCritics) -> Tensor:
    """Return the squared distance of the actor's mode from actions of a guide, where those are better.

    Behaviour cloning behind a filter (Nair et al. 2018, arXiv:1709.10089, section IV-C): only where the less
    sanguine critic values the guide's action above the actor's own. Gradients of the critics know the way
    uphill from where the actor is; this takes it over a valley. Normalised observations (B, D), actions
    (B, A), their values (2, B); a scalar, the sum over the B.
    """
    mode = actor.mode(observation)
    with torch.no_grad():
        better = value.amin(0) > critics(observation, mode).amin(0)
    return ((mode - action).square().sum(-1) * better).sum()


def _device(name: str) -> torch.device:
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("agent.device=cuda: PyTorch finds no CUDA device here; say agent.device=cpu")
    return torch.device(name)


@contextmanager
def matmul_precision(precision: str) -> Iterator[None]:
    """Let float32 matrix products be computed at this inner precision, and as before afterwards."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def _check_memory(transitions: int, numbers: int) -> None:
    needed = transitions * numbers * FLOAT_BYTES
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there:
        raise ConfigError(
            f"agent.buffer_size={transitions} takes {needed / 1e9:.0f} GB; this machine has {there / 1e9:.0f} GB"
        )


class SAC:
    """The learner: networks, their targets, the entropy coefficient, one optimiser and the replay buffer.

    Its `generator` goes on from torch's global random state as it is once the networks have been drawn, and
    gives every random number of a training; `state_dict` holds it too.
    Gamma is per control step; every transition brings the number of control steps that it took.

    Networks, buffer and updates live on `config.device`. Every random number is drawn on the CPU, and actions
    are returned there, so the device changes a training by rounding only.

    Raises:
        ConfigError: there is no such device here, or the replay buffer is larger than this machine's memory.
    """

    def __init__(self, config: AgentConfig, observation_dim: int, action_dim: int) -> None:
        self.config, self.device = config, _device(config.device)
        if self.device.type == "cpu":
            _check_memory(config.buffer_size, 2 * observation_dim + action_dim + 3)
        self.observation_dim, self.action_dim = observation_dim, action_dim
        hidden = list(config.hidden)
        self.normaliser = Normaliser(observation_dim, config.normalise).to(self.device)
        self.actor = Actor(observation_dim, action_dim, hidden).to(self.device)
        self.critics = TwinCritics(observation_dim, action_dim, hidden).to(self.device)
        self.targets = TwinCritics(observation_dim, action_dim, hidden).to(self.device).requires_grad_(False)
        self.targets.load_state_dict(self.critics.state_dict())
        self.average = copy.deepcopy(self.actor).requires_grad_(False)
        """The actor that acts outside training: the mean of the actor's steps, or its newest."""
        log_alpha = math.log(config.entropy_coefficient)
        self.log_alpha = torch.tensor(log_alpha, device=self.device, requires_grad=True)
        self._parameters = [*self.actor.parameters(), *self.critics.parameters(), self.log_alpha]
        self._critic_parameters: list[Tensor] = list(self.critics.parameters())
        self._actor_parameters: list[Tensor] = list(self.actor.parameters())
        self._average_parameters: list[Tensor] = list(self.average.parameters())
        self._target_parameters: list[Tensor] = list(self.targets.parameters())
        # The three losses share no gradient, so one fused step serves all.
        self.optimiser = torch.optim.Adam(self._parameters, lr=config.learning_rate, fused=True)
        self.buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(config.buffer_size, device=self.device))
        self.updates = 0
        self.generator = torch.Generator()
        self.generator.set_state(torch.get_rng_state())

    @torch.no_grad()
    def act(self, observation: Tensor) -> Tensor:
        """Return exploring actions (N, A) in [-1, 1] for raw observations (N, D)."""
        noise = torch.randn(len(observation), self.action_dim, generator=self.generator).to(self.device)
        return self.actor.sample(self.normaliser(observation.to(self.device)), noise)[0].cpu()

    def remember(
        self,
        observation: Tensor,
        action: Tensor,
        reward: Tensor,
        next_observation: Tensor,
        terminated: Tensor,
        steps: Tensor,
        demonstrated: Tensor | None = None,
    ) -> None:
        """Store N transitions: (N, D), (N, A), (N,) reward, (N, D), (N,) bool, (N,) control steps taken.

        A truncated episode goes on bootstrapping; only a terminated one does not. `guided` (N,) bool: the
        action is a guide's; none is, if not given.
        """
        self.normaliser.update(observation.to(self.device))
        demonstrated = torch.zeros_like(terminated) if demonstrated is None else demonstrated
        discount = torch.where(terminated, 0.0, self.config.gamma ** steps.float())
        self.buffer.extend(
            TensorDict(
                {
                    "observation": observation,
                    "action": action,
                    "reward": reward.float(),
                    "next_observation": next_observation,
                    "discount": discount,
                    "demonstrated": demonstrated,
                },
                batch_size=[len(observation)],
            )
        )

    def update(self) -> dict[str, float]:
        """Do one gradient step on everything; return `TERMS` by name.

        Raises:
            TrainingDiverged: a term is not finite; the parameters are left as they were.
        """
        with matmul_precision(self.config.matmul_precision):
            return self._update()

    def _update(self) -> dict[str, float]:
        batch, demonstrated, noise, next_noise = self.draw()
        losses = sac_losses(
            batch,
            self.actor,
            self.critics,
            self.targets,
            self.log_alpha,
            self.config.target_entropy,
            noise,
            next_noise,
        )
        terms = self.checked(terms_of(losses, self.log_alpha).tolist())
        self.optimiser.zero_grad(set_to_none=True)
        critic_loss, actor_loss, alpha_loss, *_ = losses
        loss = critic_loss
        if self.updates >= self.config.critic_warmup_updates:
            loss = loss + actor_loss + alpha_loss + self._bc_loss(batch, demonstrated)
        loss.backward()
        self.optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(self._target_parameters, self._critic_parameters, self.config.tau)
            torch._foreach_lerp_(self._average_parameters, self._actor_parameters, self.config.ema_rate)
        self.updates += 1
        return terms

    def draw(self) -> tuple[Batch, Tensor, Tensor, Tensor]:
        """Return what an update learns from: a batch, which of it (B,) is a guide's, two noises (B, A)."""
        index = torch.randint(len(self.buffer), (self.config.batch_size,), generator=self.generator)
        index = index.to(self.device)
        stored = self.buffer.storage[:]  # views: to index each is quicker than `buffer[index]`
        sample = {name: column[index] for name, column in stored.items()}
        batch = Batch(
            observation=self.normaliser(sample["observation"]),
            action=sample["action"],
            reward=sample["reward"],
            next_observation=self.normaliser(sample["next_observation"]),
            discount=sample["discount"],
        )
        noise, next_noise = torch.randn(2, *batch.action.shape, generator=self.generator).to(self.device)
        return batch, sample["demonstrated"], noise, next_noise

    def checked(self, values: Sequence[float]) -> dict[str, float]:
        """Return the values of `TERMS` by name.

        Raises:
            TrainingDiverged: one is not finite.
        """
        terms = dict(zip(TERMS, values, strict=True))
        for name, value in terms.items():
            if not math.isfinite(value):
                raise TrainingDiverged(f"training diverged at update {self.updates}: {name} is {value}")
        return terms

    def _bc_loss(self, batch: Batch, demonstrated: Tensor) -> Tensor | float:
        """Return the weighted `bc_loss` of the guided transitions, per transition of the batch."""
        rows = demonstrated.nonzero()[:, 0]
        if not len(rows):
            return 0.0
        observation, action = batch.observation[rows], batch.action[rows]
        with torch.no_grad():
            value = self.critics(observation, action)
        loss = bc_loss(observation, action, value, self.actor, self.critics)
        return self.config.bc_weight * loss / len(demonstrated)

    def networks_state(self) -> dict[str, Any]:
        """Return the learnt tensors.

        Raises:
            TrainingDiverged: a parameter is not finite.
        """
        state: dict[str, Any] = {
            "actor": self.actor.state_dict(),
            "critics": self.critics.state_dict(),
            "targets": self.targets.state_dict(),
            "normaliser": self.normaliser.state_dict(),
            "log_alpha": self.log_alpha.detach().clone(),
        }
        for part in ("actor", "critics"):
            for name, tensor in state[part].items():
                if not tensor.isfinite().all():
                    raise TrainingDiverged(f"training diverged at update {self.updates}: {part} {name} is not finite")
        return state

    def policy_state(self) -> dict[str, Any]:
        """Return what a policy file keeps: `networks_state` with the actor that acts outside training.

        Raises:
            TrainingDiverged: a parameter is not finite.
        """
        return {**self.networks_state(), "actor": self.average.state_dict()}

    def load_networks(self, state: dict[str, Any]) -> None:
        """Take over the learnt tensors of `networks_state`; the optimiser and the buffer stay."""
        self.actor.load_state_dict(state["actor"])
        self.average.load_state_dict(state["actor"])
        self.critics.load_state_dict(state["critics"])
        self.targets.load_state_dict(state["targets"])
        self.normaliser.load_state_dict(state["normaliser"])
        with torch.no_grad():
            self.log_alpha.copy_(state["log_alpha"])

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data; of the buffer the filled part."""
        return {
            "networks": self.networks_state(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "updates": self.updates,
            "generator": self.generator.get_state(),
            **replay_state(self.buffer),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, in a learner that has stored nothing yet."""
        self.load_networks(state["networks"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.updates = state["updates"]
        self.generator.set_state(state["generator"])
        load_replay(self.buffer, state)
