"""A trained policy with memory as a function of the state."""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_comfort.policies.actor import Policy
from hrl_comfort.tasks import State
from hrl_comfort.tasks.subtask import StateFunction

MOST = 4096
"""Episodes that are remembered at a time, beside those that act."""


class Remembering:
    """A policy whose memory goes by the episode (`State.key`), so any rows of any cells may act.

    A decision that does not follow the one before within `action_repeat` control steps, such as the first after another
    option, begins anew; one that is asked for twice is answered twice the same.
    """

    def __init__(self, policy: Policy, observe: StateFunction, action_repeat: int) -> None:
        self._policy, self._observe, self._action_repeat = policy, observe, action_repeat
        assert policy.memory_dim is not None
        self._blank = torch.zeros(policy.memory_dim)
        self._known: dict[int, tuple[int, Tensor, Tensor]] = {}
        """Of an episode the control step of the latest decision, and the memory (M,) before and after it."""

    def __call__(self, state: State) -> Tensor:
        """Return actions (N, A) in [-1, 1], float64."""
        episodes = list(zip(state.key.tolist(), state.steps.tolist(), strict=True))
        before = torch.stack([self._before(key, step) for key, step in episodes])
        action, after = self._policy.remembering(self._observe(state).float(), before)
        for row, (key, step) in enumerate(episodes):
            self._known.pop(key, None)
            self._known[key] = step, before[row], after[row]
        for key in list(self._known)[: -MOST - len(episodes)]:
            del self._known[key]
        return action.double()

    def state_dict(self) -> dict[str, Tensor]:
        """Return what an exact continuation needs, (E, ...) of the episodes that are remembered."""
        known = list(self._known.values())
        none = self._blank[None][:0]
        return {
            "key": torch.tensor(list(self._known), dtype=torch.int64),
            "step": torch.tensor([step for step, *_ in known], dtype=torch.int64),
            "before": torch.stack([before for _, before, _ in known]) if known else none,
            "after": torch.stack([after for *_, after in known]) if known else none,
        }

    def load_state_dict(self, saved: dict[str, Tensor]) -> None:
        """Continue from `state_dict`."""
        steps = zip(saved["step"].tolist(), saved["before"], saved["after"], strict=True)
        self._known = dict(zip(saved["key"].tolist(), steps, strict=True))

    def _before(self, key: int, step: int) -> Tensor:
        """Return the memory (M,) with which an episode decides at a control step."""
        if key not in self._known:
            return self._blank
        latest, before, after = self._known[key]
        if step == latest:
            return before
        return after if 0 < step - latest <= self._action_repeat else self._blank
