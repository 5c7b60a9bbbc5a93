"""Flat soft actor-critic that explores as a hierarchy does: for several decisions the same way.

Nachum et al. 2019 (arXiv:1909.10618) find that most of what hierarchies gain is such exploration.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from hrl_comfort.agents.sac import SAC
from hrl_comfort.config.learning import HeldKeys


class Held(SAC):
    """Soft actor-critic whose noise, in each environment, stays the same for some decisions."""

    Keys = HeldKeys
    own: HeldKeys

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._forget()

    def _forget(self) -> None:
        self._noise, self._drawn = torch.zeros(0, self.action_dim), torch.zeros(0, self.action_dim)
        """(N, A) in force: standard normal, and uniform in [-1, 1]."""
        self._left = torch.zeros(0, dtype=torch.int64)
        """(N,) decisions for which they stay."""

    @torch.no_grad()
    def act(self, now: TensorDictBase, exploration: float = 0.0) -> Tensor:
        """Return actions as soft actor-critic does, with the noise in force."""
        observation = now["observation"]
        shape = len(observation), self.action_dim
        if len(self._left) != len(observation):
            self._noise, self._drawn = torch.zeros(shape), torch.zeros(shape)
            self._left = torch.zeros(len(observation), dtype=torch.int64)
        over = (self._left == 0)[:, None]
        noise, drawn = (draw(shape, generator=self.generator) for draw in (torch.randn, torch.rand))
        self._noise = torch.where(over, noise, self._noise)
        self._drawn = torch.where(over, 2 * drawn - 1, self._drawn)
        self._left = torch.where(over[:, 0], self.own.hold, self._left) - 1
        if exploration == 1.0:
            return self._drawn
        seen = self.normaliser(observation.to(self.device))
        return self.actor.sample(seen, self._noise.to(self.device))[0].cpu()

    def observe(self, transitions: TensorDictBase) -> None:
        """Store transitions; where an episode is done, the next begins with noise of its own."""
        super().observe(transitions)
        self._left = self._left.masked_fill(transitions["next", "done"][:, 0], 0)

    def begin_stage(self, *given: Any) -> None:
        """Go on in another stage, whose episodes begin."""
        super().begin_stage(*given)
        self._forget()

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to continue, as plain data."""
        return {**super().state_dict(), "held": [self._noise, self._drawn, self._left]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        super().load_state_dict(state)
        self._noise, self._drawn, self._left = state["held"]
