"""Parts that the learners of a top share: a score of each option, an average that is kept, and an exact state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.data import Categorical, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, QValueActor
from torchrl.modules.tensordict_module import SafeModule
from torchrl.objectives import LossModule, SoftUpdate

from hrl_comfort.agents.memory import check_networks
from hrl_comfort.agents.replay import load_replay, replay_state
from hrl_comfort.agents.tops.job_scores import JobScores
from hrl_comfort.config import MetaControllerAgentConfig
from hrl_comfort.config.learning import NoKeys

LEAST = -1e4
"""Log-probability, not infinite, of an option that cannot start."""
LARGEST_GRADIENT = 10.0
"""Norm to which gradients are cut."""


def make_scores(kind: str, observation_dim: int, options: int, hidden: Sequence[int], layout: str) -> nn.Module:
    """Return the network of scores that `meta_controller_agent.network` names, for observations of `layout`.

    Raises:
      ConfigError: it does not go with the observation and the options.
    """
    if kind == "shared":
        return JobScores(observation_dim, options, hidden, layout)
    return MLP(observation_dim, options, num_cells=list(hidden), activation_class=nn.ReLU)


def make_network(scores: nn.Module, options: int) -> QValueActor:
    """Return the actor of scores, such as values or logits; masked options are never chosen."""
    return QValueActor(
        scores,
        in_keys=["observation"],
        spec=Categorical(options),
        action_mask_key="action_mask",
    )


def greedy(network: QValueActor, observation: Tensor, mask: Tensor) -> Tensor:
    """Return the options (N,) of greatest score among those that `mask` (N, K) allows."""
    td = TensorDict({"observation": observation, "action_mask": mask}, batch_size=[len(observation)])
    chosen: Tensor = network(td)["action"]
    return chosen


def policy_of(network: QValueActor) -> ProbabilisticActor:
    """Return the stochastic policy whose logits are the scores of `network`, and that shares its weights."""
    return ProbabilisticActor(
        SafeModule(network.module[0].module, in_keys=["observation"], out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        distribution_class=MaskedCategorical,
        distribution_kwargs={"neg_inf": LEAST},
        return_log_prob=True,
    )


def chances(network: QValueActor, now: TensorDictBase, exploration: float) -> Tensor:
    """Return the probabilities (N, K) of options: of the policy, and at random with probability `exploration`."""
    mask = now["action_mask"]
    logits = network.module[0].module(now["observation"]).masked_fill(~mask, LEAST)
    anything = mask.float() / mask.sum(1, keepdim=True)
    return (1 - exploration) * logits.softmax(1) + exploration * anything


class OptionLearner(ABC):
    """A learner over options: `network` scores them, and the one of greatest score is chosen outside training.

    Its random numbers are torch's global ones, whose state `state_dict` holds.
    """

    Keys: ClassVar[type] = NoKeys
    """Dataclass of the keys `meta_controller_agent.own`."""
    quantity: ClassVar[str] = "value"
    """Meaning of the scores: the value of each option, or the logits of its probability."""
    copies: ClassVar[int]
    """Number of numbers kept for each weight of the network."""

    def __init__(
        self, config: MetaControllerAgentConfig, observation_dim: int, options: int, own: Any = None
    ) -> None:  # fmt: skip
        sizes = (observation_dim, *config.hidden, options)
        check_networks(f"meta_controller_agent.hidden={list(config.hidden)}", self.copies, sizes)
        self.config, self.observation_dim, self.count = config, observation_dim, options
        self.own = self.Keys(**config.own) if own is None else own
        scores = make_scores(config.network, observation_dim, options, config.hidden, config.observation)
        self.network = make_network(scores, options)
        self.loss = self.new_loss()
        self.average = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(1 - config.ema_rate))
        weights = [each for each in self.loss.parameters() if each.requires_grad]
        self.optimiser = torch.optim.Adam(weights, lr=config.learning_rate, fused=True)

    @abstractmethod
    def new_loss(self) -> LossModule:
        """Return the loss of the network, and of others that it needs."""

    @abstractmethod
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return options (N,) that can start, one at random with probability `exploration`.

        `now` holds `observation` (N, D) and `action_mask` (N, K) bool.
        """

    def learn_from(self, batch: TensorDictBase, *names: str) -> float:
        """Do a gradient step on the sum of these losses of a batch, and return it."""
        losses = self.loss(batch)
        found = sum((losses[name] for name in names[1:]), losses[names[0]])
        self.optimiser.zero_grad()
        found.backward()
        parameters = [each for group in self.optimiser.param_groups for each in group["params"]]
        nn.utils.clip_grad_norm_(parameters, LARGEST_GRADIENT)
        self.optimiser.step()
        return float(found.detach())

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as plain data."""
        parts = {name: getattr(self, name).state_dict() for name in ("loss", "average", "optimiser")}
        return {**parts, "generator": torch.get_rng_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, in a learner that has observed nothing yet."""
        for name in ("loss", "average", "optimiser"):
            getattr(self, name).load_state_dict(state[name])
        torch.set_rng_state(state["generator"])


class ReplayLearner(OptionLearner):
    """A learner over options from a replay buffer, with targets."""

    losses: ClassVar[tuple[str, ...]]
    """Names of the parts of the loss."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.target = SoftUpdate(self.loss, tau=self.config.tau)
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(self.config.buffer_size), batch_size=self.config.batch_size
        )

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (F,) of `OptionEnv.transitions`."""
        if len(transitions):
            self.buffer.extend(transitions)

    def update(self) -> dict[str, float]:
        """Do one update and return its `loss`; nothing before the first transitions."""
        if not len(self.buffer):
            return {}
        found = self.learn_from(self.buffer.sample(), *self.losses)
        self.target.step()
        self.average.update_parameters(self.network)
        return {"loss": found}

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as plain data; of the buffer the filled part."""
        return {**super().state_dict(), **replay_state(self.buffer)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`; the buffer must be empty."""
        load_replay(self.buffer, state)
        super().load_state_dict(state)
