"""Engine of cells that child processes simulate, with the episodes of one process, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.engine import Engine, of_rows
from hrl_comfort.sim.episodes import Episodes
from hrl_comfort.sim.processes.child import PHYSICS, RESULT, STATE, Child
from hrl_comfort.sim.processes.children import Children
from hrl_comfort.sim.processes.memory import Arrays, Memory
from hrl_comfort.sim.step_result import StepResult, tensors
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
NOBODY = np.empty(0, dtype=np.int64)


def make_engine(
    config: EnvConfig,
    rows: int,
    seed: int,
    evaluation: EvaluationSet | None = None,
    measure_arm: bool = False,
    disturbance: str = "none",
) -> Engine:
    """Return an engine of `rows` cells in `engine.processes` processes, at most one for each cell; see `Engine`."""
    args = config.in_one_process(), rows, seed, evaluation, measure_arm, disturbance
    count = min(config.engine.processes, rows)
    return Engine(*args) if count == 1 else SharedEngine(*args, processes=count)


class SharedEngine(Engine):
    """Engine of cells that `processes` processes simulate.

    `episodes` are what is known of them here: state, counts, settings, and draws but those that are PLANNED; their
    people, drive and source stay as they began.
    """

    def __init__(
        self,
        config: EnvConfig,
        rows: int,
        seed: int,
        evaluation: EvaluationSet | None,
        measure_arm: bool,
        disturbance: str,
        processes: int,
    ) -> None:
        self.scene, self.num_envs, self._alike = scene_of(config), rows, {"disturbance": disturbance}
        self.episodes = Episodes(self.scene, config, rows, seed, evaluation, measure_arm, disturbance)
        parts = np.array_split(np.arange(rows), processes)
        self._parts = [slice(int(part[0]), int(part[-1]) + 1) for part in parts]
        args = config, seed, evaluation, measure_arm, disturbance
        self._children = Children([partial(_child, part, *args) for part in self._parts])
        self._memory: dict[str, Memory] = {}
        self._known: dict[str, Tensor] = {}
        """Fields of the state as the children have them."""
        self._held = NOBODY
        self._physics_state = np.empty((0, 0))

    @property
    def physics_state(self) -> Array:
        """See `Engine`."""
        return self._physics_state

    def reset(self, rows: NDArray[np.int64] | None = None, entries: EvaluationSet | None = None) -> State:
        """See `Engine`."""
        rows, episodes = np.arange(self.num_envs) if rows is None else rows, self.episodes
        if episodes.state is None and len(rows) < self.num_envs:
            raise ConfigError("the first reset must reset every row")
        if len(rows):
            settings = {
                "precision_m": episodes.precision_m, "seed": episodes.sampler.seed, "reach": episodes.sampler.reach,
            }  # fmt: skip
            mine = [(part.start <= rows) & (rows < part.stop) for part in self._parts]
            answers = self._ask("reset", [
                (rows[own] - part.start, None if entries is None else entries.at(np.flatnonzero(own)),
                 episodes.episode[part], settings)
                for part, own in zip(self._parts, mine, strict=True)
            ])  # fmt: skip
            for own, (_, draw) in zip(mine, answers, strict=True):
                episodes.begun_elsewhere(rows[own], draw, entries is None)
            self._take_state([state for state, _ in answers])
        assert episodes.state is not None
        return episodes.state

    def step(self, action: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """See `Engine`."""
        if rows is not None and not len(rows):
            raise ValueError("rows=[] is not allowed; name at least one row")
        before = self.episodes.before(action)
        answers = self._ask("step", [
            (action[part], None if rows is None else _within(part, rows), _within(part, self._held))
            for part in self._parts
        ])  # fmt: skip
        state = self._take_state([state for state, _ in answers])
        moving = self._arrays("result", [result for _, result in answers])
        outcome = tensors({name: moving.pop(name) for name in RESULT})
        return StepResult(state=state, before=before, moving=moving, **outcome)

    def observe(self) -> Tensor:
        """See `Engine`."""
        answers = self._ask("observe", [()] * len(self._parts))
        return torch.from_numpy(self._arrays("observation", answers)["observation"])

    @contextmanager
    def held(self, rows: Tensor) -> Iterator[None]:
        """See `Engine`."""
        self._held = rows.numpy()
        try:
            yield
        finally:
            self._held = NOBODY

    def close(self) -> None:
        """End the processes."""
        self._children.close()

    def state_dict(self) -> dict[str, Any]:
        """See `Engine`; it is that of one process."""
        saved: dict[str, Any] = joined(self._ask("state_dict", [()] * len(self._parts)))
        episodes = self.episodes
        saved["episodes"] |= {
            "precision_m": episodes.precision_m, "reach": episodes.sampler.reach,
            "episode": torch.from_numpy(episodes.episode.copy()),
        }  # fmt: skip
        return saved

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """See `Engine`."""
        self.episodes.load_state_dict(saved["episodes"])
        self._physics_state = saved["physics"].numpy().copy()
        assert self.episodes.state is not None
        self._known = self.episodes.state.fields()
        self._ask("load_state_dict", [(of_rows(saved, torch.arange(p.start, p.stop)),) for p in self._parts])

    def _ask(self, what: str, words: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Return the answers of the children, who first take the fields of the state that have been changed here."""
        state = self.episodes.state
        now = {} if state is None else state.fields()
        changed = {name: value for name, value in now.items() if value is not self._known.get(name)}
        self._known |= changed
        return self._children.ask(
            what, [{name: value[part].numpy() for name, value in changed.items()} for part in self._parts], words
        )

    def _take_state(self, answers: list[Arrays | None]) -> State:
        """Take and return the state, of which `answers` have what is not in shared memory."""
        arrays = self._arrays(STATE, answers)
        self._physics_state = arrays.pop(PHYSICS)
        state = self.episodes.state = State(**tensors(arrays))
        self._known = state.fields()
        return state

    def _arrays(self, group: str, answers: list[Arrays | None]) -> dict[str, NDArray[Any]]:
        """Return the arrays (N, ...) of `group`; the first time they are in `answers`, and memory is made for them."""
        if group not in self._memory:
            some = next(answer for answer in answers if answer is not None)
            memory = Memory({name: (each.dtype.str, (self.num_envs, *each.shape[1:])) for name, each in some.items()})
            for part, answer in zip(self._parts, answers, strict=True):
                memory.write(part.start, answer or {})
            self._children.ask(
                "attach", [{}] * len(self._parts), [(group, memory.layout, memory.name)] * len(self._parts)
            )
            memory.forget()
            self._memory[group] = memory
        return self._memory[group].read()


def _child(
    part: slice, config: EnvConfig, seed: int, evaluation: EvaluationSet | None, measure_arm: bool, disturbance: str
) -> Child:
    """Return what simulates the rows of `part` in a child process."""
    rows = part.stop - part.start
    return Child(Engine(config, rows, seed, evaluation, measure_arm, disturbance, first_row=part.start), part.start)


def _within(part: slice, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return those of `rows` (r,) that are of `part`, counted from its first."""
    return rows[(part.start <= rows) & (rows < part.stop)] - part.start


def joined(parts: Sequence[Any]) -> Any:
    """Return what was saved of all rows, of what was saved of each part of them; see `of_rows`."""
    first = parts[0]
    if isinstance(first, dict):
        return {name: joined([part[name] for part in parts]) for name in first}
    if isinstance(first, list):
        return [joined(each) for each in zip(*parts, strict=True)]
    return torch.cat(list(parts)) if isinstance(first, Tensor) else first
