"""Trained skills that go on learning together in the whole task: end to end, each under the one that follows.

Where the stage of the task changes, the skill that made it earns what the critics of the next one expect by then, as
with `agent.next_skill`. These learn too: the value is that of their target critics at the time of an update.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from hrl_comfort.agents.baselines.turns import seldom
from hrl_comfort.agents.sac import SAC
from hrl_comfort.config import AgentConfig, ConfigError
from hrl_comfort.config.learning import EndToEndKeys

NONE = -1
"""No other skill goes on."""


class StagePolicy(nn.Module):
    """The actor of the stage in force, which the columns `stages` of the observation tell and no actor sees."""

    def __init__(self, parts: list[SAC], stages: list[int], observation_dim: int) -> None:
        super().__init__()
        self._pairs = [(part.average, part.normaliser) for part in parts]
        self.pairs = nn.ModuleList(nn.ModuleList(part) for part in self._pairs)
        self._stages, self._others = stages, [each for each in range(observation_dim) if each not in stages]

    def forward(self, observation: Tensor) -> Tensor:
        """Return actions (N, A) for raw observations (N, D)."""
        stage, seen = self.split(observation)
        actions = torch.stack([actor.mode(normaliser(seen)) for actor, normaliser in self._pairs], dim=1)
        return actions.gather(1, stage[:, None, None].expand(-1, 1, actions.shape[2])).squeeze(1)

    def split(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return whose stage is in force (N,), and what a skill sees (N, D - K); of several rounds all are alike."""
        return observation[:, self._stages].argmax(1) % len(self._pairs), observation[:, self._others]


class EndToEnd:
    """The learner: a soft actor-critic for each skill, `parts`, which take turns in updates.

    Raises:
        ConfigError: the columns are not those of the observation, as many for each skill, or as soft actor-critic.
    """

    Keys = EndToEndKeys
    columns = ("stages",)
    """Own keys that are columns of the observation, here by number."""
    terms = SAC.terms

    def __init__(self, config: AgentConfig, observation_dim: int, action_dim: int, own: EndToEndKeys) -> None:
        stages = [*map(int, own.stages)]
        if not stages or len(stages) % len(own.skills) or max(stages) >= observation_dim:
            raise ConfigError(
                f"agent.own.stages={stages} must be columns from 0 to {observation_dim - 1}, one a round for each "
                f"of agent.own.skills={own.skills}"
            )
        self.config, self._updates = config, 0
        alone = self._alone(config, len(own.skills))
        size = observation_dim - len(stages)
        self.parts = {name: SAC(alone, size, action_dim) for name in own.skills}
        for part in self.parts.values():
            part.terminal_value = self._values
        self.policy = StagePolicy([*self.parts.values()], stages, observation_dim)

    def _alone(self, config: AgentConfig, skills: int) -> AgentConfig:
        """Return the configuration of one of the skills, which share the buffer and the updates."""
        return seldom(replace(config, name="sac", own={}), skills)

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return the actions (N, A) of the skills of the stages in force."""
        stage, seen = self.policy.split(now["observation"])
        action = torch.zeros(0)
        for index, part in enumerate(self.parts.values()):
            rows = (stage == index).nonzero()[:, 0]
            if len(rows):
                own = part.act(TensorDict({"observation": seen[rows]}), exploration)
                action = action if len(action) else own.new_zeros(len(stage), own.shape[1])
                action[rows] = own
        return action

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions (F,), each for the skill that acted; to it, one to another stage is an end with a value."""
        then = transitions["next"]
        (stage, seen), (following, after) = (self.policy.split(each["observation"]) for each in (transitions, then))
        passes = (stage != following) & ~then["terminated"][:, 0]
        end = {
            "observation": after,
            "reward": then["reward"],
            "terminated": then["terminated"] | passes[:, None],
            "skill": following.where(passes, NONE),
        }
        kept = {name: transitions[name] for name in ("action", "steps_to_next_obs", "demonstrated")}
        own = TensorDict({**kept, "observation": seen, "next": end}, batch_size=[len(stage)])
        for index, part in enumerate(self.parts.values()):
            if bool((mine := stage == index).any()):
                part.observe(own[mine])

    @torch.no_grad()
    def _values(self, transitions: TensorDictBase) -> Tensor:
        """Return what the skills that go on after transitions (B,) expect (B,), at the modes of their actors."""
        following, after = transitions["next", "skill"], transitions["next", "observation"]
        found = torch.zeros(len(following), device=after.device)
        for index, part in enumerate(self.parts.values()):
            rows = (following == index).nonzero()[:, 0]
            if len(rows):
                assert part.targets is not None
                own = part.normaliser(after[rows])
                found[rows] = part.targets.value(own, part.actor.mode(own))
        return found

    def update(self) -> dict[str, float]:
        """Update the skill whose turn it is among those that have acted; return its terms."""
        acted = [part for part in self.parts.values() if len(part.buffer)]
        self._updates += 1
        return acted[self._updates % len(acted)].update() if acted else {}

    def begin_stage(self, config: AgentConfig, keep_replay: bool, keep_optimiser: bool) -> None:
        """Go on under `config`, of the same sizes."""
        self.config = config
        for part in self.parts.values():
            part.begin_stage(self._alone(config, len(self.parts)), keep_replay, keep_optimiser)

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {"updates": self._updates, **{f"of_{name}": part.state_dict() for name, part in self.parts.items()}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`, in a learner that has stored nothing yet."""
        self._updates = state["updates"]
        for name, part in self.parts.items():
            part.load_state_dict(state[f"of_{name}"])
