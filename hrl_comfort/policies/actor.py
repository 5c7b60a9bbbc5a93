"""Trained policies and the files they live in."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.networks import Actor, Normaliser, TwinCritics
from hrl_comfort.config import ConfigError
from hrl_comfort.files.provenance import step_files

if TYPE_CHECKING:
    from hrl_comfort.agents.sac import SAC  # it imports torchrl, seconds

SPEC: dict[str, type] = {
    "task": str, "observation_dim": int, "action_dim": int, "hidden": list, "normalise": bool, "environment": dict,
}  # fmt: skip
"""Keys and types of a policy file's `spec`."""
PLAIN = (str, int, float, bool, type(None))
WIDEST = 10**6


class ActorPolicy:
    """A trained actor behind its normaliser; acts with the mode of its distribution.

    `spec` holds task, observation_dim, action_dim, hidden, normalise, `environment`, what the cell it acts in must
    share, as a dict of plain values, and in files of version 0.2 `config`, the whole environment of its training as in
    config.yaml, which `files.run_config.trained_environment` reads.
    """

    def __init__(
        self, actor: Actor, normaliser: Normaliser, spec: dict[str, Any], critics: TwinCritics | None = None
    ) -> None:
        self.actor, self.normaliser, self.spec, self.critics = actor, normaliser, spec, critics

    @torch.no_grad()
    def __call__(self, observation: Tensor) -> Tensor:
        """Return deterministic actions (N, A) in [-1, 1] for raw observations (N, D)."""
        expected = self.spec["observation_dim"]
        if observation.shape[-1] != expected:
            task, given = self.spec["task"], observation.shape[-1]
            raise ConfigError(f"the policy for {task} was trained on {expected} observations, got {given}")
        return self.actor.mode(self.normaliser(observation.float()))

    @torch.no_grad()
    def value(self, observation: Tensor) -> Tensor:
        """Return the lower critic's values (N,) of raw observations (N, D) at the actions taken there."""
        assert self.critics is not None
        return self.critics(self.normaliser(observation.float()), self(observation)).amin(0)


def save_policy(
    path: Path,
    networks: dict[str, Any],
    spec: dict[str, Any],
    counters: dict[str, Any] | None = None,
    critics: bool = True,
) -> None:
    """Write a policy file: `SAC.policy_state()`, the policy's spec, and how far training was.

    Training can go on from the file alone; without `critics` the file is a third of the size and only acts.
    """
    if missing := SPEC.keys() - spec.keys():
        raise ConfigError(f"policy spec lacks {', '.join(sorted(missing))}")
    kept = networks if critics else {name: networks[name] for name in networks if name != "critics"}
    checkpoint.save(path, {"networks": kept, "spec": spec, "counters": counters or {}})


def load_policy(path: Path | str, critics: bool = False) -> ActorPolicy:
    """Read the policy of a policy file, a checkpoint or a run folder, on demand with its critics.

    Raises:
        ConfigError: there is none, it is damaged, or it lacks the critics asked for.
    """
    file = policy_file(Path(path))
    spec, networks = _read("policy", file, critics)
    sizes = spec["observation_dim"], spec["action_dim"], spec["hidden"]
    with torch.device("meta"):  # the sizes are what the file says: nothing is allocated before they fit
        actor, normaliser = Actor(*sizes), Normaliser(spec["observation_dim"], spec["normalise"])
        values = TwinCritics(*sizes, _layer_norm(networks)) if critics else None
    parts: dict[str, nn.Module | None] = {"actor": actor, "normaliser": normaliser, "critics": values}
    for name, module in parts.items():
        if module is not None:
            try:
                module.load_state_dict(networks[name], assign=True)
            except (KeyError, RuntimeError) as error:
                raise ConfigError(f"policy={str(file)!r} is damaged: {str(error).splitlines()[0]}") from error
            module.requires_grad_(False)
    if not actor.float().bounded() or (normaliser.variance < 0).any():
        raise ConfigError(f"policy={str(file)!r} is damaged: its actions are not always finite")
    return ActorPolicy(actor, normaliser, spec, values)


def policy_file(path: Path) -> Path:
    """Return the file that holds the policy of `path`: itself, or for a run folder its newest good one.

    Raises:
        ConfigError: there is none.
    """
    if not path.is_dir():
        return path
    for candidate in (path / "policy.pt", *reversed(step_files(path / "checkpoints"))):
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
        ConfigError: the file does not hold networks of the learner's shape, or no critics.
    """
    file = policy_file(path)
    spec, networks = _read("initial_policy", file, critics=True)
    config = learner.config
    mine = {
        "observation_dim": learner.observation_dim,
        "action_dim": learner.action_dim,
        "hidden": list(config.hidden),
        "normalise": config.normalise,
        "critic_layer_norm": config.critic_layer_norm,
    }
    theirs = {**spec, "critic_layer_norm": _layer_norm(networks)}
    for key, value in mine.items():
        if theirs[key] != value:
            raise ConfigError(f"initial_policy={file} has {key}={theirs[key]}, this training {value}")
    try:
        learner.load_networks(networks)
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ConfigError(f"initial_policy={file} is damaged: {str(error).splitlines()[0]}") from error


def _read(key: str, file: Path, critics: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return spec and networks of a policy file, types checked."""
    state = checkpoint.load(file)
    if "spec" not in state or "networks" not in state:
        raise ConfigError(f"{key}={str(file)!r} is not a policy file; checkpoints/step_*.pt and policy.pt are")
    damaged = f"{key}={str(file)!r} is damaged: its"
    spec, networks = state["spec"], state["networks"]
    for name, kind in SPEC.items():
        if not isinstance(spec, dict) or type(spec.get(name)) is not kind:
            raise ConfigError(f"{damaged} {name} is not of type {kind.__name__}")
    sizes = [spec["observation_dim"], spec["action_dim"], *spec["hidden"]]
    sized = all(type(size) is int and 1 <= size <= WIDEST for size in sizes)
    if not sized or any(type(value) not in PLAIN for value in spec["environment"].values()):
        raise ConfigError(f"{damaged} spec is {spec}")
    for part in ("actor", "critics", "normaliser"):
        tensors = networks.get(part, {}) if isinstance(networks, dict) else None
        if not isinstance(tensors, dict):
            raise ConfigError(f"{damaged} {part} is not there")
        for name, tensor in tensors.items():
            floating = isinstance(tensor, Tensor) and tensor.is_floating_point()
            if not floating or not tensor.float().isfinite().all():
                raise ConfigError(f"{damaged} {part} {name} is not finite")
    if critics and not networks.get("critics"):
        raise ConfigError(f"{key}={str(file)!r} was saved without its critics; give a run folder that has them")
    return spec, networks


def _layer_norm(networks: dict[str, Any]) -> bool:
    return "layer_norm_mark" in networks.get("critics", {})
