"""The learned meta-controller: double DQN over the semi-MDP of options (TorchRL's DQNLoss).

An option of k control steps is discounted by gamma**k, which TorchRL takes from `steps_to_next_obs`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.data import Categorical, LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import MLP, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate, ValueEstimators

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.memory import check_networks
from hrl_comfort.agents.replay import load_replay, replay_state
from hrl_comfort.config import ConfigError
from hrl_comfort.config.hierarchy import MetaControllerAgentConfig
from hrl_comfort.files.versions import CONTROLLER, renamed
from hrl_comfort.hierarchy.decision import Choose, Decision
from hrl_comfort.hierarchy.observation import PERSON, meta_observation, observation_dim
from hrl_comfort.policies.actor import WIDEST

SPEC: dict[str, tuple[type, ...]] = {
    "names": (list,), "levels": (int,), "objects": (int,), "max_waits": (int, type(None)),
    "observation": (str,), "observation_dim": (int,), "hidden": (list,),
}  # fmt: skip
"""Fields of the `spec` in a meta-controller's file, and the types of each."""


def make_network(observation_dim: int, options: int, hidden: list[int]) -> QValueActor:
    """Return the network of option values; masked options are never chosen."""
    return QValueActor(
        MLP(observation_dim, options, num_cells=hidden, activation_class=torch.nn.ReLU),
        in_keys=["observation"],
        spec=Categorical(options),
        action_mask_key="action_mask",
    )


class QLearner:
    """Double DQN with a soft target and uniform exploration among the options that can start."""

    def __init__(self, config: MetaControllerAgentConfig, observation_dim: int, options: int, seed: int) -> None:
        sizes = (observation_dim, *config.hidden, options)
        # the network, its target, its average, gradients and two moments
        check_networks(f"meta_controller_agent.hidden={list(config.hidden)}", 6, sizes)
        torch.manual_seed(seed)
        self.config, self.observation_dim, self.count = config, observation_dim, options
        self.network = make_network(observation_dim, options, list(config.hidden))
        self.loss = DQNLoss(
            self.network, loss_function="smooth_l1", delay_value=True, double_dqn=True, action_space="categorical"
        )
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=config.gamma)
        self.target = SoftUpdate(self.loss, tau=config.tau)
        self.average = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(1 - config.ema_rate))
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=config.learning_rate)
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size), batch_size=config.batch_size
        )

        self.updates = 0

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return options (N,): the best by value, or with probability `exploration` any that can start.

        `now` holds `observation` (N, D) and `action_mask` (N, K) bool.
        """
        mask = now["action_mask"]
        best = greedy(self.network, now["observation"], mask)
        anything = torch.multinomial(mask.float(), 1).squeeze(1)
        return torch.where(torch.rand(len(best)) < exploration, anything, best)

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (F,) of `OptionEnv.transitions`."""
        if len(transitions):
            self.buffer.extend(transitions)

    def update(self) -> dict[str, float]:
        """Do one update and return its `loss`."""
        found = self.loss(self.buffer.sample())["loss"]
        self.optimiser.zero_grad()
        found.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self.optimiser.step()
        self.target.step()
        self.average.update_parameters(self.network)
        self.updates += 1
        return {"loss": float(found.detach())}

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as plain data."""
        return {
            "loss": self.loss.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "updates": self.updates,
            "generator": torch.get_rng_state(),
            **replay_state(self.buffer),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`; the buffer must be empty."""
        self.loss.load_state_dict(state["loss"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.updates = state["updates"]
        load_replay(self.buffer, state)
        torch.set_rng_state(state["generator"])

    def save(self, path: Path, spec: dict[str, Any]) -> None:
        """Write the averaged network and its spec."""
        shape = {
            "observation": self.config.observation,
            "observation_dim": self.observation_dim,
            "options": self.count,
            "hidden": list(self.config.hidden),
        }
        checkpoint.save(path, {"network": self.average.module.state_dict(), "spec": {**spec, **shape}})


def greedy(network: QValueActor, observation: Tensor, mask: Tensor) -> Tensor:
    """Return the options (N,) of greatest value among those that `mask` (N, K) allows."""
    td = TensorDict({"observation": observation, "action_mask": mask}, batch_size=[len(observation)])
    chosen: Tensor = network(td)["action"]
    return chosen


def choice_file(source: Path) -> Path:
    """Return the file of the trained meta-controller at `source`, a run folder or the file itself."""
    return source / "meta_controller.pt" if source.is_dir() else source


def load_choice(source: str, levels: int, options: list[str], max_waits: int | None = None) -> Choose:
    """Return the trained meta-controller in `source`, a run folder or a meta_controller.pt.

    Raises:
      ConfigError: the file is missing, damaged or of an earlier version, or the controller was trained for other
        options or another limit of waits.
    """
    state, key = checkpoint.load(choice_file(Path(source))), f"policies.meta_controller={source!r}"
    spec, weights = state.get("spec"), state.get("network")
    if not isinstance(spec, dict) or not isinstance(weights, dict):
        raise ConfigError(f"{key} is not a trained controller; its folder holds meta_controller.pt")
    spec = renamed(spec, CONTROLLER)
    for name, kinds in SPEC.items():
        if name not in spec or type(spec[name]) not in kinds:
            raise ConfigError(
                f"{key} is damaged, or of an earlier version: its {name} is missing or of a wrong type; train it again"
            )
    names, hidden = [str(name) for name in spec["names"]], spec["hidden"]
    if names != options or spec["levels"] != levels:
        raise ConfigError(
            f"{key} chooses among {names} at {spec['levels']} levels; "
            f"here there are {options} at {levels} (meta_controller.level_override, task.objects)"
        )
    if spec["max_waits"] != max_waits:
        trained, here = ("null" if each is None else each for each in (spec["max_waits"], max_waits))
        raise ConfigError(f"{key} was trained with meta_controller.max_waits={trained}; here it is {here}")
    layout = spec["observation"]
    if layout not in PERSON:
        raise ConfigError(f"{key} is damaged: its observation is {layout!r}, not {' or '.join(PERSON)}")
    seen = observation_dim(layout, spec["objects"])
    if spec["observation_dim"] != seen:
        raise ConfigError(
            f"{key} was trained on {spec['observation_dim']} observations; here there are {seen}: train it again"
        )
    if not all(type(width) is int and 1 <= width <= WIDEST for width in hidden):
        raise ConfigError(f"{key} is damaged: its hidden is {hidden}")
    try:
        with torch.device("meta"):  # the sizes are what the file says: nothing is allocated before they fit
            network = make_network(seen, len(options), hidden)
        network.load_state_dict(weights, assign=True)
    except (AttributeError, RuntimeError) as error:  # the former at a name that is no text
        raise ConfigError(f"{key} is damaged: {str(error).splitlines()[0]}") from error
    if not all(w.is_floating_point() and w.isfinite().all() for w in network.state_dict().values()):
        raise ConfigError(f"{key} is damaged: its weights are not all finite numbers")
    network.float()

    @torch.no_grad()
    def choose(decision: Decision) -> Tensor:
        return greedy(network, meta_observation(decision.state, levels, layout), decision.mask)

    return choose
