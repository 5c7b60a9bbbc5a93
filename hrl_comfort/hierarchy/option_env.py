"""The semi-MDP of options as a TorchRL environment: an action starts an option (Sutton, Precup, Singh 1999).

Options end at different times in different rows. A step runs until the first of them ends; only the rows
marked `deciding` then choose, the others continue. With `together` the rows wait for one another instead: each step is
an option of every row, as learners expect.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from hrl_comfort.config import EnvConfig, EvaluateConfig
from hrl_comfort.config.checks import between
from hrl_comfort.envs.inputs import episode_seed
from hrl_comfort.hierarchy.decision import Decision
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.observation import observer
from hrl_comfort.hierarchy.semi_mdp import FLAGS, MakeOptions, SemiMDP, options_of
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.tasks import State
from hrl_comfort.tasks.subtask import StateFunction


def make_option_env(
    config: EvaluateConfig, num_envs: int, seed: int = 0, gamma: float = 1.0, observation: str | None = None
) -> OptionEnv:
    """Return the environment of the options of `hrl_comfort.options_of`, its rows `together`.

    `observation` is one of META_OBSERVATIONS, by default that of the task. TorchRL's value estimators raise their gamma
    to the duration of an option with `set_keys(steps_to_next_obs=("next", "steps_to_next_obs"))`; give both one gamma.

    Raises:
      ConfigError: as `OptionEnv` and `sorting_table`.
    """
    see, make = observer(config, observation), options_of(config)
    return OptionEnv(config, make, num_envs, seed, gamma, see, config.disturbance, together=True)


class OptionEnv(EnvBase):
    """N cells in which K options are run, batch size (N,).

    Action (N,) int64 in [0, K): the option to start in the rows that decide; elsewhere it is ignored.
    A step returns `observation` (N, D) float32; `action_mask` (N, K) bool, options that can start now;
    `deciding` (N, 1) bool, rows whose option has ended, or is interrupted and goes on if it is chosen again; for these
    `reward` (N, 1), its rewards discounted by gamma a control step since it was chosen (0 elsewhere),
    `steps_to_next_obs` (N, 1) int64, its control steps since, and `termination` (N, 1) int64, an index into
    `executor.TERMINATIONS`; `success` (N, 1) bool of the episode.
    """

    batch_locked = True

    def __init__(
        self,
        config: EnvConfig,
        make_options: MakeOptions,
        rows: int,
        seed: int,
        gamma: float,
        observe: StateFunction | None = None,
        disturbance: str = "none",
        together: bool = False,
    ) -> None:
        """Discount a control step by `gamma`.

        `observe` is the meta-controller's observation, the task's own by default. With `together` all rows decide at
        each step, and the first option that can start takes the place of one that cannot; without it, that is an error.

        Raises:
          ConfigError: `seed` is not a whole number from 0 to 2**32 - 1, or `gamma` is not in [0.001, 1].
        """
        between("gamma", gamma, 1e-3, 1.0)
        super().__init__(device="cpu", batch_size=torch.Size([rows]))
        self.engine = make_engine(config, rows, episode_seed(seed), disturbance=disturbance)
        self.executor = OptionExecutor(make_options(self.engine), self.engine.episodes)
        self._process = SemiMDP(self.engine, self.executor, gamma)
        self.gamma, self.together = gamma, together
        self._see = observe or self.engine.episodes.subtask.observe
        self._begin_rows = torch.ones(rows, dtype=torch.bool)
        state = self.engine.reset()
        self.last_state: State = state
        """State after the last step, before any row was reset."""
        self._origin = self._observe(state)
        self._origin_mask = self.executor.available(state)
        self._make_specs()
        self.engine.episodes.rewind()

    @property
    def earned(self) -> Tensor:
        """(N,) rewards of the last step, undiscounted, of every row."""
        return self._process.earned

    @property
    def decision(self) -> Decision:
        """The decision of a top now, in the rows whose option has ended."""
        return self.executor.decision(self._process.state, self._begin_rows)

    def _make_specs(self) -> None:
        n, count = self.batch_size[0], len(self.executor.table)
        flag, number = Binary(1, shape=(n, 1), dtype=torch.bool), Unbounded(shape=(n, 1), dtype=torch.int64)
        self.observation_spec = Composite(
            observation=Unbounded(shape=self._origin.shape, dtype=torch.float32),
            action_mask=Binary(count, shape=(n, count), dtype=torch.bool),
            deciding=flag.clone(),
            success=flag.clone(),
            steps_to_next_obs=number.clone(),
            termination=number.clone(),
            shape=(n,),
        )
        self.action_spec = Categorical(count, shape=(n,), dtype=torch.int64)
        self.reward_spec = Unbounded(shape=(n, 1), dtype=torch.float32)
        self.full_done_spec = Composite(done=flag.clone(), terminated=flag.clone(), truncated=flag.clone(), shape=(n,))

    def _observe(self, state: State) -> Tensor:
        return self._see(state).float()

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        rows = torch.ones(self.batch_size, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(-1)
        state = self.engine.reset(np.flatnonzero(rows.numpy()))
        self._begin_rows = self._begin_rows | rows
        nothing = torch.zeros(*self.batch_size, 1, dtype=torch.int64)
        return TensorDict(
            {
                "observation": self._observe(state),
                "action_mask": self.executor.available(state),
                "deciding": self._begin_rows[:, None].clone(),
                "steps_to_next_obs": nothing.clone(),
                "termination": nothing.clone(),
                **{name: nothing.bool() for name in ("success", "done", "terminated", "truncated")},
            },
            batch_size=self.batch_size,
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, action = self._process.state, tensordict["action"].reshape(-1)
        rows, acting = self._begin_rows, torch.ones(self.batch_size, dtype=torch.bool)
        if self.together:
            rows = acting = tensordict.get("_step", acting).reshape(-1)
            action = self._process.possible(action)
        self._origin = torch.where(rows[:, None], self._observe(state), self._origin)
        self._origin_mask = torch.where(rows[:, None], self.executor.available(state), self._origin_mask)
        self._process.begin(rows, action)
        ran = self._process.step(acting, self.together)
        ended, self.last_state = ran.ended, self._process.state
        self._begin_rows = ended
        flags = {name: ran.columns[name] for name in FLAGS}
        return TensorDict(
            {
                "observation": self._observe(self.last_state),
                "action_mask": self.executor.available(self.last_state),
                "reward": torch.where(ended, ran.reward, 0.0)[:, None].float(),
                "steps_to_next_obs": torch.where(ended, ran.duration, 0)[:, None],
                "termination": torch.where(ended, ran.termination, 0)[:, None],
                **{name: flag[:, None] for name, flag in {**flags, "deciding": ended, "done": ran.done}.items()},
            },
            batch_size=self.batch_size,
        )

    def transitions(self, after: TensorDictBase) -> TensorDict:
        """Return the options that ended in a step as transitions (F,) of the semi-MDP.

        `after` is the step's `next`; `row` (F,) numbers their environments. TorchRL's TD0 raises gamma to
        `steps_to_next_obs`, at the root, and so discounts the value of the next observation by the option's length.
        """
        rows = torch.nonzero(after["deciding"].reshape(-1)).squeeze(-1)
        names = ("observation", "action_mask", "reward", "done", "terminated", "truncated")
        return TensorDict(
            {
                "observation": self._origin[rows],
                "action_mask": self._origin_mask[rows],
                "action": self.executor.option[rows],
                "row": rows,
                "steps_to_next_obs": after["steps_to_next_obs"][rows],
                "next": TensorDict({name: after[name][rows] for name in names}, batch_size=[len(rows)]),
            },
            batch_size=[len(rows)],
        )

    _TENSORS = ("_begin_rows", "_origin", "_origin_mask")

    def state_dict(self, *_: Any, **__: Any) -> dict[str, Any]:
        """Return everything a bit-for-bit continuation needs, between two steps."""
        return {
            "engine": self.engine.state_dict(),
            "executor": self.executor.state_dict(),
            "returns": self._process.returns,
            "memories": self.executor.table.memories(),
            **{name: getattr(self, name) for name in self._TENSORS},
        }

    def close(self, *_: Any, **__: Any) -> None:
        """Stop the engine's threads and processes."""
        self.engine.close()
        super().close()

    def load_state_dict(self, state_dict: dict[str, Any], *_: Any, **__: Any) -> None:
        """Continue from `state_dict`."""
        self.engine.load_state_dict(state_dict["engine"])
        self.executor.load_state_dict(state_dict["executor"])
        self._process.returns = state_dict["returns"]
        self.executor.table.load_memories(state_dict.get("memories", []))
        for name in self._TENSORS:
            setattr(self, name, state_dict[name])

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.engine.episodes.rewind(episode_seed(seed))
