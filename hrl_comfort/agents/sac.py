"""Soft actor-critic (Haarnoja et al. 2018, arXiv:1812.05905) on TorchRL's loss module and buffer."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from hrl_comfort.agents.loss import ActorCriticLoss, bc_loss
from hrl_comfort.agents.memory import check_networks, check_replay
from hrl_comfort.agents.networks import Actor, Critics, Normaliser
from hrl_comfort.agents.replay import load_replay, replay_state
from hrl_comfort.config import AgentConfig, ConfigError
from hrl_comfort.config.learning import NoKeys

TERMS = {
    "critic_loss": "loss_qvalue", "actor_loss": "loss_actor", "alpha_loss": "loss_alpha",
    "alpha": "alpha", "entropy": "entropy", "q_mean": "q_mean",
}  # fmt: skip
"""Column of metrics.csv -> name in the loss module's result."""


class TrainingDiverged(FloatingPointError):
    """A training term is not finite any more; the message names the update and the term."""


@contextmanager
def matmul_precision(precision: str) -> Iterator[None]:
    """Let float32 matrix products be computed at this inner precision, and as before afterwards."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


class SAC:
    """The learner: networks, loss, one optimiser and replay buffer. TQC, CrossQ and REDQ differ in critics and losses.

    `generator` continues torch's global random state as it is after the networks have been drawn, and gives
    every random number of a training; `state_dict` holds it. Gamma is per control step; every transition
    brings the number of control steps that it took.

    Networks, buffer and updates live on `config.device`. Every random number is drawn on the CPU, and actions
    are returned there, so the device changes a training by rounding only.

    Raises:
        ConfigError: the device is not available, or buffer or networks are larger than this machine's memory.
    """

    Keys: ClassVar[type] = NoKeys
    """Dataclass of the keys `agent.own`."""
    losses: ClassVar[dict[str, str]] = TERMS
    """Values that `update` returns, by column of metrics.csv."""
    terms: ClassVar[tuple[str, ...]] = tuple(TERMS)
    """These columns."""
    critics_type: ClassVar[type[Critics]] = Critics
    loss_type: ClassVar[type[ActorCriticLoss]] = ActorCriticLoss
    has_targets: ClassVar[bool] = True
    betas: ClassVar[tuple[float, float]] = (0.9, 0.999)
    """Of Adam."""
    terminal_value: Callable[[TensorDictBase], Tensor] | None = None
    """Value (B,) to whoever acts next of the states that raw transitions (B,) lead to. It is added to the rewards,
    discounted, when transitions are sampled, so that it is as new as the one who acts next."""

    def __init__(self, config: AgentConfig, observation_dim: int, action_dim: int, own: Any = None) -> None:
        if config.device == "cuda" and not torch.cuda.is_available():
            raise ConfigError("agent.device=cuda: PyTorch finds no CUDA device here; say agent.device=cpu")
        self.config, self.device = config, torch.device(config.device)
        self.own = self.Keys(**config.own) if own is None else own
        check_replay(config, observation_dim, action_dim)
        if self.device.type == "cpu":
            sizes = (observation_dim + action_dim, *config.hidden, 2 * action_dim)
            # an actor, its average, critics, their targets; gradients and two moments of those that learn
            copies = 5 * (1 + getattr(self.own, "critics", 2))
            check_networks(f"agent.hidden={list(config.hidden)}", copies, sizes)
        self.observation_dim, self.action_dim = observation_dim, action_dim
        self.normaliser = Normaliser(observation_dim, config.normalise).to(self.device)
        self.actor = Actor(*self.sizes).to(self.device)
        self.critics = self.new_critics().to(self.device)
        self.targets = self.new_critics().to(self.device) if self.has_targets else None
        self.generator = torch.Generator()
        self.generator.set_state(torch.get_rng_state())
        self.loss = self.new_loss()
        self.log_alpha = self.loss.log_alpha
        if self.targets is not None:
            self.targets.load_state_dict(self.critics.state_dict())
        self.average = copy.deepcopy(self.actor).requires_grad_(False)
        """The actor that acts outside training: the mean of the actor's steps, or its newest."""
        self._averaged: tuple[list[Tensor], list[Tensor]] = ([*self.average.parameters()], [*self.actor.parameters()])
        # The three losses share no gradient, so one fused step serves all.
        self.optimiser = self._new_optimiser()
        self.buffer = self._new_buffer()
        self.updates = 0
        self._stage_begin = 0
        """Number of updates at which the current stage began."""

    @property
    def sizes(self) -> tuple[int, int, list[int]]:
        """Sizes of observation and action, and the widths of the hidden layers."""
        return self.observation_dim, self.action_dim, list(self.config.hidden)

    def new_critics(self) -> Critics:
        """Return critics with new weights."""
        return Critics(*self.sizes, self.config.critic_layer_norm)

    def new_loss(self) -> ActorCriticLoss:
        """Return the loss of the networks."""
        config = self.config
        coefficients = config.gamma, config.target_entropy, config.entropy_coefficient
        return self.loss_type(self.actor, self.critics, self.targets, *coefficients)

    def _new_optimiser(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.weights(), lr=self.config.learning_rate, betas=self.betas, fused=True)

    def weights(self) -> list[nn.Parameter]:
        """Return all that is learned."""
        return [*self.actor.parameters(), *self.critics.parameters(), self.log_alpha]

    def _new_buffer(self) -> TensorDictReplayBuffer:
        return TensorDictReplayBuffer(storage=LazyTensorStorage(self.config.buffer_size, device=self.device))

    def begin_stage(self, config: AgentConfig, keep_replay: bool, keep_optimiser: bool) -> None:
        """Go on under `config`, of the same sizes, from the networks that a policy file would hold now."""
        self.config, self._stage_begin = config, self.updates
        self.load_networks(self.policy_state())
        self.loss.gamma, self.loss.target_entropy = config.gamma, config.target_entropy
        if not keep_optimiser:
            self.optimiser = self._new_optimiser()
        self.optimiser.param_groups[0]["lr"] = config.learning_rate
        if not keep_replay:
            self.buffer = self._new_buffer()

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return actions (N, A) in [-1, 1] for raw `observation` (N, D); with an exploration of 1, uniform ones."""
        observation = now["observation"]
        if exploration == 1.0:
            return torch.rand((len(observation), self.action_dim), generator=self.generator) * 2 - 1
        noise = torch.randn(len(observation), self.action_dim, generator=self.generator).to(self.device)
        return self.actor.sample(self.normaliser(observation.to(self.device)), noise)[0].cpu()

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (F,): raw `observation` (F, D), `action` (F, A), control steps `steps_to_next_obs` (F, 1).

        `demonstrated` (F,) bool says that the action is a demonstrator's. `next` holds `observation` (F, D), `reward`
        and `terminated` (F, 1): targets bootstrap on truncated episodes, not on terminated ones.
        """
        self.normaliser.update(transitions["observation"].to(self.device))
        self.buffer.extend(transitions)

    def update(self) -> dict[str, float]:
        """Do one gradient step on everything; return `terms` by name.

        Raises:
            TrainingDiverged: a term is not finite; the parameters are left as they were.
        """
        with matmul_precision(self.config.matmul_precision):
            return self._update()

    def _update(self) -> dict[str, float]:
        batch = self.sample()
        losses = self.loss(batch)
        values = torch.stack([losses[name].detach() for name in self.losses.values()]).tolist()
        terms = dict(zip(self.losses, values, strict=True))
        for name, value in terms.items():
            if not math.isfinite(value):
                raise TrainingDiverged(f"training diverged at update {self.updates}: {name} is {value}")
        loss = losses["loss_qvalue"]
        if self.actor_learns():
            loss = loss + self.actor_loss(losses, batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        if self.config.learning_rate_end is not None:
            self.optimiser.param_groups[0]["lr"] = self.learning_rate()
        self.optimiser.step()
        if self.has_targets:
            self.loss.update_targets(self.config.tau)
        with torch.no_grad():
            torch._foreach_lerp_(*self._averaged, self.config.ema_rate)
        self.updates += 1
        return terms

    def actor_loss(self, losses: TensorDictBase, batch: TensorDict) -> Tensor:
        """Return what the actor and the entropy coefficient learn from."""
        loss: Tensor = losses["loss_actor"] + losses["loss_alpha"] + self._bc_loss(batch)
        return loss

    def actor_learns(self) -> bool:
        """Return whether the next update changes the actor too."""
        return self.updates - self._stage_begin >= self.config.critic_warmup_updates

    def sample(self) -> TensorDict:
        """Return B transitions, observations normalised, with the noise (B, A) of both actions."""
        index = torch.randint(len(self.buffer), (self.config.batch_size,), generator=self.generator)
        batch = self.buffer.storage[index.to(self.device)]
        if self.terminal_value is not None:
            value = self.config.gamma ** batch["steps_to_next_obs"] * self.terminal_value(batch)[:, None]
            batch["next", "reward"] = batch["next", "reward"] + value
        noise = torch.randn(2, *batch["action"].shape, generator=self.generator).to(self.device)
        batch["noise"], batch["next_noise"] = noise
        for part in (batch, batch["next"]):
            part["observation"] = self.normaliser(part["observation"])
        return batch

    def learning_rate(self) -> float:
        """Return the rate of the next update, on a line from `learning_rate` to `learning_rate_end`."""
        config = self.config
        if config.learning_rate_end is None:
            return config.learning_rate
        total = (config.policy_steps - config.learning_starts) * config.updates_per_policy_step
        phase = min(1.0, (self.updates - self._stage_begin) / max(total, 1.0))
        return config.learning_rate + phase * (config.learning_rate_end - config.learning_rate)

    def _bc_loss(self, batch: TensorDict) -> Tensor | float:
        """Return the weighted `bc_loss` of the demonstrated transitions, per transition of the batch."""
        rows = batch["demonstrated"].nonzero()[:, 0]
        if not len(rows):
            return 0.0
        loss = bc_loss(batch["observation"][rows], batch["action"][rows], self.actor, self.critics)
        return self.config.bc_weight * loss / len(batch)

    def networks_state(self) -> dict[str, Any]:
        """Return the learnt tensors, without the targets.

        Raises:
            TrainingDiverged: a parameter is not finite.
        """
        state: dict[str, Any] = {
            "actor": self.actor.state_dict(),
            "critics": self.critics.state_dict(),
            "normaliser": self.normaliser.state_dict(),
            "log_alpha": self.log_alpha.detach().clone(),
        }
        for part in ("actor", "critics"):
            for name, tensor in state[part].items():
                if not tensor.isfinite().all():
                    raise TrainingDiverged(f"training diverged at update {self.updates}: {part} {name} is not finite")
        return state

    def policy_state(self) -> dict[str, Any]:
        """Return the tensors of a policy file: `networks_state` with the actor that acts outside training.

        Raises:
            TrainingDiverged: a parameter is not finite.
        """
        return {**self.networks_state(), "actor": self.average.state_dict()}

    def load_networks(self, state: dict[str, Any]) -> None:
        """Take over the tensors of `networks_state`, targets from its critics; optimiser and buffer stay."""
        for actor in (self.actor, self.average):
            actor.load_state_dict(state["actor"])
        for critics in (self.critics, *([] if self.targets is None else [self.targets])):
            critics.load_state_dict(state["critics"])
        self.normaliser.load_state_dict(state["normaliser"])
        with torch.no_grad():
            self.log_alpha.copy_(state["log_alpha"])

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data; of the buffer the filled part."""
        return {
            "networks": self.networks_state(),
            "targets": {} if self.targets is None else self.targets.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "updates": self.updates,
            "stage_begin": self._stage_begin,
            "generator": self.generator.get_state(),
            **replay_state(self.buffer),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, in a learner that has stored nothing yet."""
        self.load_networks(state["networks"])
        if self.targets is not None:
            self.targets.load_state_dict(state["targets"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.updates, self._stage_begin = state["updates"], state["stage_begin"]
        self.generator.set_state(state["generator"])
        load_replay(self.buffer, state)
