"""The learned meta-controller: its file, and the top that chooses by it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.learners import TOPS, make_learner
from hrl_comfort.agents.tops.options import make_network, make_scores
from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import section
from hrl_comfort.config.hierarchy import META_OBSERVATIONS, TOP_LEARNERS, MetaControllerAgentConfig
from hrl_comfort.files.versions import CONTROLLER, CONTROLLER_BEFORE, renamed
from hrl_comfort.hierarchy.decision import PROBABILITY, Decision
from hrl_comfort.hierarchy.observation import meta_observation, observation_dim
from hrl_comfort.policies.actor import WIDEST

SPEC: dict[str, tuple[type, ...]] = {
    "names": (list,), "levels": (int,), "objects": (int,), "max_waits": (int, type(None)),
    "interruption_steps": (int, type(None)),
    "observation": (str,), "observation_dim": (int,), "hidden": (list,),
}  # fmt: skip
"""Fields of the `spec` in a meta-controller's file, and the types of each."""


def save_controller(
    path: Path, learner: Any, config: MetaControllerAgentConfig, observation_dim: int, spec: dict[str, Any]
) -> None:  # fmt: skip
    """Write the network that scores the options, what it takes to make it again, and the spec of its task."""
    built_in = config.name in TOP_LEARNERS
    network = learner.average.module if built_in else learner.policy
    shape = {
        "observation": config.observation,
        "observation_dim": observation_dim,
        "hidden": list(config.hidden),
        "network": config.network,
        "learner": config.name,
        **({} if built_in else {"agent": asdict(config)}),
    }
    checkpoint.save(path, {"network": network.state_dict(), "spec": {**spec, **shape}})


def choice_file(source: Path) -> Path:
    """Return the file of the trained meta-controller at `source`, a run folder or the file itself.

    Raises:
      ConfigError: it is not there.
    """
    file = source / "meta_controller.pt" if source.is_dir() else source
    if not file.is_file():
        raise ConfigError(
            f"policies.meta_controller={str(source)!r}: {file} is not there; give the folder of train meta_controller"
        )
    return file


class Learned:
    """The top that chooses the option of highest score by `network`, from observations of `layout` at `levels`.

    `quantity` is what the scores are: logits where it is PROBABILITY.
    """

    def __init__(self, network: nn.Module, levels: int, layout: str, quantity: str) -> None:
        self._network, self._levels, self._layout, self.quantity = network, levels, layout, quantity

    def __call__(self, decision: Decision) -> Tensor:
        """Return the options (N,) of highest score."""
        return self._scores(decision).argmax(dim=1)

    def values(self, decision: Decision) -> Tensor:
        """Return the values or probabilities (N, K) of the options."""
        scores = self._scores(decision)
        return scores.softmax(dim=1) if self.quantity == PROBABILITY else scores

    @torch.no_grad()
    def _scores(self, decision: Decision) -> Tensor:
        scores: Tensor = self._network(meta_observation(decision.state, self._levels, self._layout).float())
        return scores.masked_fill(~decision.mask, -torch.inf)


def load_choice(
    source: str, levels: int, options: list[str], max_waits: int | None = None, interruption_steps: int | None = None
) -> Learned:
    """Return the trained meta-controller in `source`, a run folder or a meta_controller.pt.

    Raises:
      ConfigError: the file is missing, damaged or of an earlier version, or the controller was trained for other
        options, another limit of waits or another time until an option is interrupted.
    """
    state, key = checkpoint.load(choice_file(Path(source))), f"policies.meta_controller={source!r}"
    spec, weights = state.get("spec"), state.get("network")
    if not isinstance(spec, dict) or not isinstance(weights, dict):
        raise ConfigError(f"{key} is not a trained controller; its folder holds meta_controller.pt")
    spec = {**CONTROLLER_BEFORE, **renamed(spec, CONTROLLER)}
    for name, kinds in SPEC.items():
        if name not in spec or type(spec[name]) not in kinds:
            raise ConfigError(
                f"{key} is damaged, or of an earlier version: its {name} is missing or of a wrong type; train it again"
            )
    names, hidden = [str(name) for name in spec["names"]], spec["hidden"]
    if names != options or spec["levels"] != levels:
        raise ConfigError(
            f"{key} chooses among {names} at {spec['levels']} levels; "
            f"here there are {options} at {levels} (meta_controller.level_override, further_options, task.objects)"
        )
    for name, asked in {"max_waits": max_waits, "interruption_steps": interruption_steps}.items():
        if spec[name] != asked:
            trained, here = ("null" if each is None else each for each in (spec[name], asked))
            raise ConfigError(f"{key} was trained with meta_controller.{name}={trained}; here it is {here}")
    layout = spec["observation"]
    if layout not in META_OBSERVATIONS:
        raise ConfigError(f"{key} is damaged: its observation is {layout!r}, not {' or '.join(META_OBSERVATIONS)}")
    seen = observation_dim(layout, spec["objects"])
    if spec["observation_dim"] != seen:
        raise ConfigError(
            f"{key} was trained on {spec['observation_dim']} observations; here there are {seen}: train it again"
        )
    if not hidden or not all(type(width) is int and 1 <= width <= WIDEST for width in hidden):
        raise ConfigError(f"{key} is damaged: its hidden is {hidden}, not one or more widths of 1 to {WIDEST}")
    network, learner = _network(key, spec, weights, len(options)), spec.get("learner", "dqn")
    built_in = learner in TOPS
    floats = not built_in or all(each.is_floating_point() for each in network.state_dict().values())
    if not floats or not all(each.isfinite().all() for each in network.state_dict().values()):
        raise ConfigError(f"{key} is damaged: its weights are not all finite numbers")
    network.float()
    return Learned(network, levels, layout, TOPS[learner].quantity if built_in else "score")


def _network(key: str, spec: dict[str, Any], weights: dict[str, Tensor], options: int) -> nn.Module:
    """Return the module from observations to scores of options that a file holds."""
    learner = spec.get("learner", "dqn")
    try:
        if learner in TOP_LEARNERS:
            with torch.device("meta"):  # the sizes are what the file says: nothing is allocated before they fit
                width, hidden = spec["observation_dim"], spec["hidden"]
                scores = make_scores(spec.get("network", "flat"), width, options, hidden, spec["observation"])
                network = make_network(scores, options)
            network.load_state_dict(weights, assign=True)
            return scores
        agent = section(MetaControllerAgentConfig, spec["agent"])
        made = make_learner("meta_controller_agent", agent, spec["observation_dim"], options).policy
        made.load_state_dict(weights)
    except ConfigError as error:
        raise ConfigError(f"{key}: {error}") from error
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:  # the first at an odd name
        raise ConfigError(f"{key} is damaged: {[*str(error).splitlines(), type(error).__name__][0]}") from error
    policy: nn.Module = made.requires_grad_(False).eval()
    return policy
