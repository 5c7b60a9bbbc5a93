"""What acts in an evaluation: a frozen policy, and the file it lives in."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.networks import Actor, Normaliser, TwinCritics
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config import ConfigError

SPEC: dict[str, type] = {
    "task": str, "observation_dim": int, "action_dim": int, "hidden": list, "normalise": bool, "environment": dict,
}  # fmt: skip
"""What a policy file says of its policy."""
PLAIN = (str, int, float, bool, type(None))
WIDEST = 10**6


class ActorPolicy:
    """A trained actor behind its normaliser; acts with the mode of its distribution.

    `spec` holds task, observation_dim, action_dim, hidden, normalise, and `environment`: a dict of plain values.
    """

    def __init__(self, actor: Actor, normaliser: Normaliser, spec: dict[str, Any]) -> None:
        self.actor, self.normaliser, self.spec = actor, normaliser, spec

    @torch.no_grad()
    def __call__(self, observation: Tensor) -> Tensor:
        """Return deterministic actions (N, A) in [-1, 1] for raw observations (N, D)."""
        expected = self.spec["observation_dim"]
        if observation.shape[-1] != expected:
            task, given = self.spec["task"], observation.shape[-1]
            raise ConfigError(f"the policy for {task} was trained on {expected} observations, got {given}")
        return self.actor.mode(self.normaliser(observation.float()))


class ActorValue:
    """What a trained policy's critics make of an observation, at the action that the policy takes there."""

    def __init__(self, policy: ActorPolicy, critics: TwinCritics) -> None:
        self.policy, self.critics = policy, critics

    @torch.no_grad()
    def __call__(self, observation: Tensor) -> Tensor:
        """Return values (N,) of raw observations (N, D): the less sanguine critic's."""
        action = self.policy(observation)
        return self.critics(self.policy.normaliser(observation.float()), action).amin(0)


def save_policy(
    path: Path, networks: dict[str, Any], spec: dict[str, Any], counters: dict[str, Any] | None = None
) -> None:
    """Write a policy file: `Sac.policy_state()`, the policy's spec, and how far training was.

    The critics go in too: they are small, and training can then go on from the file alone.
    """
    missing = SPEC.keys() - spec.keys()
    if missing:
        raise ConfigError(f"policy spec lacks {', '.join(sorted(missing))}")
    checkpoint.save(path, {"networks": networks, "spec": spec, "counters": counters or {}})


def load_policy(path: Path | str) -> ActorPolicy:
    """Read the policy of a policy file, a checkpoint or a run folder."""
    file = policy_file(Path(path))
    spec, networks = _read("policy", file)
    try:
        with torch.device("meta"):  # the sizes are what the file says: nothing is allocated before they fit
            actor = Actor(spec["observation_dim"], spec["action_dim"], spec["hidden"])
            normaliser = Normaliser(spec["observation_dim"], spec["normalise"])
        actor.load_state_dict(networks["actor"], assign=True)
        normaliser.load_state_dict(networks["normaliser"], assign=True)
    except (KeyError, RuntimeError) as error:
        raise ConfigError(f"policy={str(file)!r} is damaged: {str(error).splitlines()[0]}") from error
    if not actor.float().bounded() or (normaliser.variance < 0).any():
        raise ConfigError(f"policy={str(file)!r} is damaged: its actions are not always finite")
    return ActorPolicy(actor.requires_grad_(False), normaliser, spec)


def load_value(path: Path | str) -> ActorValue:
    """Read the policy of a policy file, a checkpoint or a run folder, and its critics.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    policy, file = load_policy(path), policy_file(Path(path))
    spec = policy.spec
    critics = TwinCritics(spec["observation_dim"], spec["action_dim"], spec["hidden"])
    try:
        critics.load_state_dict(checkpoint.load(file)["networks"]["critics"])
    except (KeyError, RuntimeError) as error:
        raise ConfigError(f"{file}: its critics are damaged: {str(error).splitlines()[0]}") from error
    return ActorValue(policy, critics.requires_grad_(False))


def policy_file(path: Path) -> Path:
    """Return the file that holds the policy of `path`: itself, or for a run folder its newest good one.

    Raises:
        ConfigError: there is none.
    """
    if not path.is_dir():
        return path
    candidates = [path / "policy.pt", *reversed(checkpoint.steps(path / "checkpoints"))]
    for candidate in candidates:
        if not candidate.exists():
            continue
        try:
            checkpoint.load(candidate)
        except ConfigError as error:
            warnings.warn(f"skipped {error}", stacklevel=2)
            continue
        return candidate
    raise ConfigError(f"{path}: a run folder with a policy.pt or checkpoints/ is needed")


def load_initial_policy(learner: SAC, path: Path) -> None:
    """Let `learner` begin with the networks of a policy file or run folder.

    Raises:
        ConfigError: the file does not hold networks of the learner's shape.
    """
    file = policy_file(path)
    spec, networks = _read("initial_policy", file)
    mine = {
        "observation_dim": learner.observation_dim,
        "action_dim": learner.action_dim,
        "hidden": list(learner.config.hidden),
        "normalise": learner.config.normalise,
    }
    for key, value in mine.items():
        if spec[key] != value:
            raise ConfigError(f"initial_policy={file} has {key}={spec[key]}, this training {value}")
    try:
        learner.load_networks(networks)
    except (KeyError, RuntimeError) as error:
        raise ConfigError(f"initial_policy={file} is damaged: {str(error).splitlines()[0]}") from error


def _read(key: str, file: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return spec and networks of a policy file, each thing in them of the kind it should be."""
    state = checkpoint.load(file)
    if "spec" not in state or "networks" not in state:
        raise ConfigError(f"{key}={str(file)!r} is not a policy file; checkpoints/step_*.pt and policy.pt are")
    spec, networks = state["spec"], state["networks"]
    for name, kind in SPEC.items():
        if not isinstance(spec, dict) or type(spec.get(name)) is not kind:
            raise ConfigError(f"{key}={str(file)!r} is damaged: its {name} is not of type {kind.__name__}")
    sizes = [spec["observation_dim"], spec["action_dim"], *spec["hidden"]]
    sized = all(type(size) is int and 1 <= size <= WIDEST for size in sizes)
    if not sized or any(type(value) not in PLAIN for value in spec["environment"].values()):
        raise ConfigError(f"{key}={str(file)!r} is damaged: its spec is {spec}")
    for part in ("actor", "critics", "normaliser"):
        tensors = networks.get(part, {}) if isinstance(networks, dict) else None
        if not isinstance(tensors, dict):
            raise ConfigError(f"{key}={str(file)!r} is damaged: its {part} is not there")
        for name, tensor in tensors.items():
            numbers = isinstance(tensor, Tensor) and tensor.is_floating_point()
            if not numbers or not tensor.float().isfinite().all():
                raise ConfigError(f"{file} is damaged: {part} {name} is not finite")
    return spec, networks
