"""TorchRL front: N cells as one batched environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from hrl_comfort.comfort.terms import human_distance
from hrl_comfort.config import EnvConfig
from hrl_comfort.envs.columns import step_columns
from hrl_comfort.envs.inputs import checked_action, episode_seed
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.sim.step_result import StepResult

_FLAGS = ("success", "contact", "unsafe_contact", "other_collision", "terminated", "truncated", "done")
_COUNTS = ("steps", "decision_steps", "protective_stops")
_NUMBERS = ("human_distance", "shield_share_mean")


class CellEnv(EnvBase):
    """N cells as one TorchRL environment of batch size (N,); a step is a decision.

    Action (N, A) in [-1, 1], observation (N, D) float32. A step also returns the values of `step_columns`,
    (N, 1) each, and `reward_terms` (N, T).
    """

    batch_locked = True

    def __init__(self, config: EnvConfig, rows: int, seed: int, evaluation: EvaluationSet | None = None) -> None:
        super().__init__(device="cpu", batch_size=torch.Size([rows]))
        self.engine = make_engine(config, rows, episode_seed(seed), evaluation)
        self.reward_names = self.engine.episodes.reward_names
        self.last: StepResult | None = None
        """Result of the latest step, with all its control steps."""
        self._make_specs()

    def _make_specs(self) -> None:
        n = self.batch_size
        self.layout = self.engine.episodes.subtask.layout(self.engine.reset())
        """Columns of the observation by the name of a term."""
        width = self.engine.observe().shape[-1]
        flag, count = Binary(1, shape=(*n, 1), dtype=torch.bool), Unbounded(shape=(*n, 1), dtype=torch.int64)
        self.observation_spec = Composite(
            observation=Unbounded(shape=(*n, width), dtype=torch.float32),
            **{name: flag.clone() for name in _FLAGS[:4]},
            **{name: count.clone() for name in _COUNTS},
            **{name: Unbounded(shape=(*n, 1), dtype=torch.float32) for name in _NUMBERS},
            reward_terms=Unbounded(shape=(*n, len(self.reward_names)), dtype=torch.float32),
            shape=n,
        )
        self.action_spec = Bounded(-1.0, 1.0, shape=(*n, self.engine.episodes.action_dim), dtype=torch.float32)
        self.reward_spec = Unbounded(shape=(*n, 1), dtype=torch.float32)
        self.full_done_spec = Composite({name: flag.clone() for name in _FLAGS[4:]}, shape=n)
        self.engine.episodes.rewind()

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        rows = None
        if tensordict is not None and "_reset" in tensordict:
            rows = np.flatnonzero(tensordict["_reset"].reshape(-1).numpy())
        state = self.engine.reset(rows)
        observation = self.engine.observe().float()
        return TensorDict(
            {
                "observation": observation,
                **{name: torch.zeros(self.rows, 1, dtype=torch.bool) for name in _FLAGS},
                "steps": state.steps[:, None].clone(),
                **{name: torch.zeros(self.rows, 1, dtype=torch.int64) for name in _COUNTS[1:]},
                "human_distance": human_distance(state.tcp_pos, state.humans_pos)[:, None].float(),
                "shield_share_mean": torch.ones(self.rows, 1),
                "reward_terms": torch.zeros(self.rows, len(self.reward_names)),
            },
            batch_size=self.batch_size,
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        outcome = self.engine.step(checked_action(tensordict["action"], (self.rows, self.engine.episodes.action_dim)))
        self.last = outcome
        columns = step_columns(outcome)
        columns |= {name: columns[name].float() for name in _NUMBERS}
        columns |= {name: columns[name].clone() for name in _COUNTS}
        columns |= {name: getattr(outcome, name) for name in _FLAGS[4:]}
        return TensorDict(
            {
                "observation": self.engine.observe().float(),
                "reward": outcome.reward[:, None].float(),
                **{name: value[:, None] for name, value in columns.items()},
                "reward_terms": outcome.reward_terms.float(),
            },
            batch_size=self.batch_size,
        )

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.engine.episodes.rewind(episode_seed(seed))

    @property
    def rows(self) -> int:
        """Number of cells."""
        return self.batch_size[0]

    def set_precision(self, precision_m: float) -> None:
        """Set the grasp tolerance from each row's next episode on, m; the other tolerances keep their ratio to it."""
        self.engine.episodes.precision_m = precision_m

    def set_reach(self, reach: float) -> None:
        """Set the part of the way from in front of the object to home up to which each row's next episode begins."""
        self.engine.episodes.sampler.reach = reach

    def state_dict(self, *_: Any, **__: Any) -> dict[str, Any]:
        """Return the state for a bit-identical continuation."""
        return self.engine.state_dict()

    def close(self, *_: Any, **__: Any) -> None:
        """Stop the engine's threads and processes."""
        self.engine.close()
        super().close()

    def load_state_dict(self, state_dict: dict[str, Any], *_: Any, **__: Any) -> None:
        """Continue from `state_dict`."""
        self.engine.load_state_dict(state_dict)
