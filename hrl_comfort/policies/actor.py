"""Trained policies and the files they live in."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.networks import Actor, Critics, Normaliser
from hrl_comfort.config import AgentConfig, ConfigError
from hrl_comfort.config.checks import section
from hrl_comfort.config.learning import SKILL_LEARNERS
from hrl_comfort.files.provenance import step_files

SPEC: dict[str, type] = {
    "task": str, "observation_dim": int, "action_dim": int, "hidden": list, "normalise": bool, "environment": dict,
}  # fmt: skip
"""Keys and types of a policy file's `spec`."""
PLAIN = (str, int, float, bool, type(None))
WIDEST = 10**6
UNFIT = (AttributeError, KeyError, IndexError, TypeError, ValueError, RuntimeError)
"""Errors of networks that do not fit."""


class Policy:
    """A trained policy: `module` maps raw observations (N, D) to deterministic actions (N, A) in [-1, 1].

    `spec` holds task, observation_dim, action_dim, hidden, normalise, `environment`, what the cell it acts in must
    share, as a dict of plain values, and in files of version 0.2 `config`, the whole environment of its training as in
    config.yaml, which `files.run_config.trained_environment` reads. Where a learner of a user's trained it, there are
    `learner`, its name, and `agent`, the configuration with which that is made again.
    """

    def __init__(self, module: nn.Module, spec: dict[str, Any]) -> None:
        self.module, self.spec = module, spec
        self.memory_dim: int | None = getattr(module, "memory_dim", None)
        """M, the numbers that it remembers from one decision to the next; None: it has no memory."""

    def __call__(self, observation: Tensor) -> Tensor:
        """Return deterministic actions (N, A) in [-1, 1] for raw observations (N, D), the first of an episode each."""
        memory = torch.zeros(len(observation), self.memory_dim or 0)
        return self.remembering(observation, memory)[0]

    @torch.no_grad()
    def remembering(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (N, A) and what to remember (N, M) after observations (N, D) and what was remembered."""
        expected = self.spec["observation_dim"]
        if observation.shape[-1] != expected:
            task, given = self.spec["task"], observation.shape[-1]
            raise ConfigError(f"the policy for {task} was trained on {expected} observations, got {given}")
        if self.memory_dim is None:
            return self.module(observation.float()), memory
        actions, after = self.module(observation.float(), memory)
        return actions, after


class Deterministic(nn.Module):
    """The mode of an actor behind its normaliser."""

    def __init__(self, actor: Actor, normaliser: Normaliser) -> None:
        super().__init__()
        self.actor, self.normaliser = actor, normaliser

    def forward(self, observation: Tensor) -> Tensor:
        """Return actions (N, A) for raw observations (N, D)."""
        return self.actor.mode(self.normaliser(observation))


class ActorPolicy(Policy):
    """A trained actor behind its normaliser; acts with the mode of its distribution."""

    def __init__(
        self, actor: Actor, normaliser: Normaliser, spec: dict[str, Any], critics: Critics | None = None
    ) -> None:
        super().__init__(Deterministic(actor, normaliser), spec)
        self.actor, self.normaliser, self.critics = actor, normaliser, critics

    @torch.no_grad()
    def value(self, observation: Tensor) -> Tensor:
        """Return the critics' values (N,) of raw observations (N, D) at the actions taken there."""
        return self.value_of(self.normaliser(observation.float()))

    @torch.no_grad()
    def value_of(self, seen: Tensor) -> Tensor:
        """Return the critics' values (N,) of normalised observations (N, D) at the actions taken there."""
        assert self.critics is not None
        return self.critics.value(seen, self.actor.mode(seen))


def save_policy(
    path: Path,
    networks: dict[str, Any],
    spec: dict[str, Any],
    counters: dict[str, Any] | None = None,
    critics: bool = True,
) -> None:
    """Write a policy file: what `networks_of` returns, the policy's spec, and how far training was.

    Training can go on from the file alone; without `critics` the file is a third of the size and only acts.
    """
    if missing := SPEC.keys() - spec.keys():
        raise ConfigError(f"policy spec lacks {', '.join(sorted(missing))}")
    kept = networks if critics else {name: networks[name] for name in networks if name != "critics"}
    checkpoint.save(path, {"networks": kept, "spec": spec, "counters": counters or {}})


def networks_of(learner: Any, name: str) -> dict[str, Any]:
    """Return the networks that a policy file keeps: actor, critics and normaliser, or a learner's own `policy`.

    `name` is that of the learner, as `agent.name`.
    """
    own = name not in SKILL_LEARNERS
    found: dict[str, Any] = {"policy": learner.policy.state_dict()} if own else learner.policy_state()
    return found


def load_policy(path: Path | str, critics: bool = False) -> Policy:
    """Read the policy of a policy file, a checkpoint or a run folder.

    With `critics` it is an ActorPolicy that has them.

    Raises:
        ConfigError: there is none, it is damaged, or it lacks the critics asked for.
    """
    file = policy_file(Path(path))
    spec, networks = _read("policy", file, critics)
    if "policy" in networks:
        return _own_policy(file, spec, networks["policy"])
    sizes = spec["observation_dim"], spec["action_dim"], spec["hidden"]
    values = _critics_of(file, spec, networks["critics"]) if critics else None
    with torch.device("meta"):  # the sizes are what the file says: nothing is allocated before they fit
        actor, normaliser = Actor(*sizes), Normaliser(spec["observation_dim"], spec["normalise"])
    parts: dict[str, nn.Module | None] = {"actor": actor, "normaliser": normaliser, "critics": values}
    for name, module in parts.items():
        if module is not None:
            try:
                module.load_state_dict(networks[name], assign=True)
            except (KeyError, RuntimeError) as error:
                raise _damaged(file, error) from error
            module.requires_grad_(False)
    if not actor.float().bounded() or (normaliser.variance < 0).any():
        raise ConfigError(f"policy={str(file)!r} is damaged: its actions are not always finite")
    return ActorPolicy(actor, normaliser, spec, values)


def _critics_of(file: Path, spec: dict[str, Any], state: dict[str, Tensor]) -> Critics:
    """Return critics for the state of those in a file, without memory of their own."""
    from hrl_comfort.agents.learners import SKILLS  # seconds, for torchrl

    kind = SKILLS[spec.get("learner", "sac")].critics_type
    try:
        with torch.device("meta"):
            return kind.of_state(spec["observation_dim"], spec["action_dim"], spec["hidden"], state)
    except UNFIT as error:
        raise _damaged(file, error) from error


def _own_policy(file: Path, spec: dict[str, Any], state: dict[str, Tensor]) -> Policy:
    """Return the policy of a learner of a user's own, which is made again for it."""
    from hrl_comfort.agents.learners import make_learner  # seconds, for torchrl

    try:
        agent = section(AgentConfig, {**spec["agent"], "device": "cpu"})
        learner = make_learner("agent", agent, spec["observation_dim"], spec["action_dim"])
        learner.policy.load_state_dict(state)
    except ConfigError as error:
        raise ConfigError(f"policy={str(file)!r}: {error}") from error
    except UNFIT as error:
        raise _damaged(file, error) from error
    return Policy(learner.policy.requires_grad_(False).eval(), spec)


def _damaged(file: Path, error: Exception) -> ConfigError:
    return ConfigError(f"policy={str(file)!r} is damaged: {[*str(error).splitlines(), type(error).__name__][0]}")


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


def load_initial_policy(learner: Any, path: Path) -> None:
    """Let `learner` begin with the networks of a policy file or run folder, or its `parts` with those in a folder.

    Raises:
        ConfigError: the file does not hold networks of the learner's kind and shape, or no critics, or the learner
            cannot begin with any.
    """
    if parts := getattr(learner, "parts", None):
        for name, part in parts.items():
            load_initial_policy(part, path / name)
        return
    if not hasattr(learner, "load_networks"):
        raise ConfigError(f"initial_policy={path}: this agent.name has no load_networks, so it begins from nothing")
    file = policy_file(path)
    spec, networks = _read("initial_policy", file, critics=True)
    config = learner.config
    mine = {
        "observation_dim": learner.observation_dim,
        "action_dim": learner.action_dim,
        "hidden": list(config.hidden),
        "normalise": config.normalise,
        "learner": config.name,
    }
    theirs = {"learner": "sac", **spec}
    if _layer_norm(networks) != _layer_norm(learner.networks_state()):
        mine["critic_layer_norm"], theirs["critic_layer_norm"] = config.critic_layer_norm, _layer_norm(networks)
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
    learner, own = spec.get("learner", "sac"), "policy" in networks if isinstance(networks, dict) else False
    if type(learner) is not str or own == (learner in SKILL_LEARNERS):
        raise ConfigError(f"{damaged} learner is {learner!r}")
    for part in ("policy",) if own else ("actor", "critics", "normaliser"):
        tensors = networks.get(part, {}) if isinstance(networks, dict) else None
        if not isinstance(tensors, dict):
            raise ConfigError(f"{damaged} {part} is not there")
        for name, tensor in tensors.items():
            number = isinstance(tensor, Tensor) and (own or tensor.is_floating_point())
            if not number or not tensor.float().isfinite().all():
                raise ConfigError(f"{damaged} {part} {name} is not finite")
    if critics and own:
        raise ConfigError(
            f"{key}={str(file)!r} is of agent.name={learner}, which keeps no critics; choose a policy of one of "
            f"{', '.join(SKILL_LEARNERS)}"
        )
    if critics and not networks.get("critics"):
        raise ConfigError(f"{key}={str(file)!r} was saved without its critics; give a run folder that has them")
    return spec, networks


def _layer_norm(networks: dict[str, Any]) -> bool:
    return "layer_norm_mark" in networks.get("critics", {})
