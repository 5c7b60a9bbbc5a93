"""N cells whose actions are options, as the Gymnasium and Stable-Baselines3 fronts step them."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import Space
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from hrl_comfort.config import EvaluateConfig
from hrl_comfort.config.checks import between
from hrl_comfort.envs.cells import Array, Cells
from hrl_comfort.envs.gymnasium import CellGym, CellVector, of_batch
from hrl_comfort.hierarchy.decision import Decision
from hrl_comfort.hierarchy.executor import OptionExecutor
from hrl_comfort.hierarchy.observation import observer
from hrl_comfort.hierarchy.semi_mdp import Ran, SemiMDP, options_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.view import View

Masks = NDArray[np.bool_]


class OptionCells(Cells):
    """N cells of which a step runs an option each until it ends or is interrupted; rows that are done wait for others.

    Args are those of `OptionGym`.
    """

    config: EvaluateConfig

    def __init__(
        self,
        config: EvaluateConfig,
        num_envs: int,
        render_mode: str | None = None,
        gamma: float = 1.0,
        observation: str | None = None,
    ) -> None:
        between("gamma", gamma, 1e-3, 1.0)
        config.check_left_out()
        self._layout, self.gamma = observation, gamma
        super().__init__(config, num_envs, render_mode)

    def _build(self) -> None:
        config = self.config
        self._see = observer(config, self._layout)
        self.engine = Engine(config, config.engine.num_envs, 0, disturbance=config.disturbance)
        self.executor = OptionExecutor(options_of(config)(self.engine), self.engine.episodes)
        self._process = SemiMDP(self.engine, self.executor, self.gamma)
        self.engine.reset()
        self._view = View(self.engine)

    @property
    def names(self) -> list[str]:
        """Names of the K options."""
        return list(self.executor.table.names)

    @property
    def spaces(self) -> tuple[Space[Any], Space[Any]]:
        """Spaces of an observation (D,) and of an action in [0, K), of one cell."""
        return Box(-np.inf, np.inf, (self.width,), np.float32), Discrete(len(self.executor.table))

    def decision(self) -> Decision:
        """Return what a top decides on now."""
        return self.executor.decision(self._process.state)

    def action_masks(self) -> Masks:
        """Return (N, K) whether an option can start."""
        able: Masks = self.executor.available(self._process.state).numpy()
        return able.copy()

    def known(self) -> dict[str, NDArray[Any]]:
        """Return what is known at the start of an episode."""
        return {"action_mask": self.action_masks()}

    def step(self, action: object, shape: tuple[int, ...]) -> tuple[Ran, Array, dict[str, NDArray[Any]]]:
        """Run an option in every row; return what it earned, the observations (N, D) and values by name, (N, ...) each.

        Raises:
          ValueError: `action` is not whole numbers of `shape`, each the index of an option.
        """
        chosen = self._process.possible(torch.from_numpy(self._checked(action, shape)))
        every = torch.ones(len(chosen), dtype=torch.bool)
        self._process.begin(every, chosen)
        ran = self._process.step(every, together=True)
        values = {"option": chosen, "duration": ran.duration, "termination": ran.termination, **ran.columns}
        del values["terminated"], values["truncated"]
        return ran, self._seen(), {**{name: each.numpy().copy() for name, each in values.items()}, **self.known()}

    def _checked(self, action: object, shape: tuple[int, ...]) -> NDArray[np.int64]:
        count = len(self.executor.table)
        try:
            given = np.asarray(action)
        except ValueError:
            given = np.empty(0)
        whole = np.issubdtype(given.dtype, np.integer)
        if given.shape != shape or not whole or not ((given >= 0) & (given < count)).all():
            said = " ".join(repr(action).split())[:60]
            raise ValueError(f"action={said} must be {shape} whole numbers from 0 to {count - 1}, each an option")
        return given.astype(np.int64).reshape(-1)

    def _observe(self) -> Array:
        observed: Array = self._see(self._process.state).float().numpy()
        return observed.copy()

    def __getstate__(self) -> dict[str, Any]:
        left_out = ("executor", "_process", "_see")
        kept = {name: value for name, value in super().__getstate__().items() if name not in left_out}
        return {**kept, "executor_state": self.executor.state_dict(), "memories": self.executor.table.memories()}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        executor, memories = kept.pop("executor_state"), kept.pop("memories")
        super().__setstate__(kept)
        self.executor.load_state_dict(executor)
        self.executor.table.load_memories(memories)


class OptionGym(CellGym):
    """One cell; a step runs an option until it ends (a semi-Markov decision process).

    With `meta_controller.interruption_steps` a step may end before the option, which goes on if it is chosen again.

    Action: index of an option of `names`, in [0, K). Observation (D,) float32, `meta_observation`. The reward is the
    sum of the rewards of the step's control steps, each discounted by `gamma` a control step from the choice; with 1,
    the default, their plain sum. A value of the next observation is to be discounted by `gamma ** info["duration"]`.

    `info` holds `duration`, control steps since the choice; `action_mask` (K,) bool, options that can start next;
    `option`, which ran: the first that could where the one chosen could not; `termination`, an index into
    `executor.TERMINATIONS`; and values of `step_columns` of the episode so far. Seeds and episodes are as of `CellGym`.

    Args:
      config: `hrl_comfort.options_of(...)`.
      render_mode: as of `CellGym`; pictures show the ends of options.
      gamma: discount factor of a control step.
      observation: one of META_OBSERVATIONS; by default that of the task.
    """

    def __init__(
        self,
        config: EvaluateConfig,
        render_mode: str | None = None,
        gamma: float = 1.0,
        observation: str | None = None,
    ) -> None:
        """Build the cell; raise ConfigError for a value that is not allowed, or a policy that does not fit."""
        self._front(OptionCells(config, 1, render_mode, gamma, observation))

    @property
    def names(self) -> list[str]:
        """Names of the K options."""
        return self._cells.names

    def action_masks(self) -> Masks:
        """Return (K,) whether an option can start now."""
        masks: Masks = self._cells.action_masks()[0]
        return masks

    def decision(self) -> Decision:
        """Return what a top decides on now, of one cell; `int(top(env.decision()))` is an action."""
        return self._cells.decision()


class OptionVector(CellVector):
    """N cells as `OptionGym`, in one batch: a step runs an option in every row, and rows wait for one another.

    Action (N,), observation (N, D). A row whose episode ends restarts within the same step; then `action_mask` is that
    of the new episode, and `final_info` has the other. Args are those of `OptionGym` and `num_envs`.
    """

    def __init__(
        self,
        config: EvaluateConfig,
        num_envs: int,
        render_mode: str | None = None,
        gamma: float = 1.0,
        observation: str | None = None,
    ) -> None:
        """Build the cells; raise as `OptionGym` and `CellVector` do."""
        self._front(OptionCells(config, num_envs, of_batch(render_mode), gamma, observation))

    @property
    def names(self) -> list[str]:
        """Names of the K options."""
        return self._cells.names

    def action_masks(self) -> Masks:
        """Return (N, K) whether an option can start now."""
        return self._cells.action_masks()

    def decision(self) -> Decision:
        """Return what a top decides on now."""
        return self._cells.decision()
