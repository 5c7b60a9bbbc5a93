"""Unsafe contacts under policies that persist: `python -m tests.safety.persistent CSV STEPS [people=2] [POLICY …]`.

The table has a row a task, motion of people, bound and policy, each of STEPS control steps behind the shield; rows that
are there are left alone, so that the command goes on where it was stopped. With `people=2` the rows are those of two
people in the cell.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import environment
from hrl_comfort.files.tables import write_table
from hrl_comfort.safety.geometry import ArmGeometry
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
ROWS, STEPS_A_ROW = 1024, 200
"""Most cells at once, and control steps (4 s) that each of them gets at least, as people come to the arm first."""
TASKS, PEOPLE, BOUNDS = ("shift", "sort", "cycle"), ("mixture", "adversary"), ("observed", "worst")
PAIRS = {"pair": ("human=pair",), "adversaries": ("human=adversary", "+human.others.second={}")}
"""Two people, by the name that the table has for them."""
WORLD = ("safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact")
CELL = ["task", "human", "bound", "policy"]


class Policy:
    """Actions of `rows` arms that are drawn anew, for each arm by itself, after some decisions.

    Args:
      kind: `held`: each joint stands or moves at full speed one way for 3 to 40 decisions; `square`: the same, turned
        round every 1 to 4 decisions, about the servos' period; `chatter`: turned round at random; `press`: the tool
        straight down, and aside, for 10 to 100 decisions.
      rows: number of arms.
      seed: of what is drawn.
      arm: its geometry.
    """

    def __init__(self, kind: str, rows: int, seed: int, arm: ArmGeometry) -> None:
        self.kind, self._arm, self._rng = kind, arm, np.random.default_rng(seed)
        self._left = np.zeros(rows, dtype=np.int64)
        self._held = np.zeros((rows, arm.joints))
        self._half, self._step = np.ones(rows, dtype=np.int64), 0

    def __call__(self, state: State) -> Array:
        """Return the actions (N, J) in the state."""
        (new,) = (self._left <= 0).nonzero()
        low, high = (10, 101) if self.kind == "press" else (3, 41)
        self._held[new] = self._rng.integers(-1, 2, (len(new), self._arm.joints))
        self._left[new] = self._rng.integers(low, high, len(new))
        self._half[new] = self._rng.integers(1, 5, len(new))
        self._left -= 1
        self._step += 1
        if self.kind == "square":
            return self._held * np.where(self._step // self._half % 2, 1.0, -1.0)[:, None]
        if self.kind == "chatter":
            return self._held * self._rng.choice([-1.0, 1.0], (len(self._held), 1))
        if self.kind == "press":
            return np.clip(self._down(state.joint_pos.numpy()) + 0.5 * self._held, -1.0, 1.0)
        return self._held

    def _down(self, angles: Array) -> Array:
        """Return the actions (N, J), the largest entry 1, that take the tool straight down at `angles` (N, J) rad."""
        pose = self._arm.pose(angles)
        offset = self._arm.tool(angles).T[:, None] - pose.anchor
        lift = pose.axis[0] * offset[1] - pose.axis[1] * offset[0]
        return -(lift / np.maximum(np.abs(lift).max(axis=0), 1e-9)).T


POLICIES = ("held", "square", "chatter", "press")


@dataclass
class Count:
    """Counts of some control steps."""

    control_steps: int = 0
    contacts: int = 0
    """Touches that began."""
    unsafe_contacts: int = 0
    fastest_m_s: float = 0.0
    """Largest speed of the arm towards the person as a pair of capsules began to touch."""
    largest_error_rad: float = 0.0
    """Largest distance of a joint from its set-point, of all readings of the physics."""
    excess_rad: float = -np.inf
    """Largest excess of it over the bound of its joint, `Drive.error_rad`; not above 0."""
    protective_stops: int = 0
    human_beyond_bound: int = 0
    """Control steps in which the person came nearer to a link than the shield assumes."""
    unsafe: list[str] = field(default_factory=list)
    """Records of the unsafe contacts."""


def watched(engine: Engine, found: Count) -> list[Array]:
    """Let `found` measure approach speeds; return the list to which following errors (N, J) rad are added.

    Each is the largest of the physics steps of a control step.
    """
    sensors, joints = engine.episodes.referee.sensors, len(engine.scene.joints)
    measured, run, errors = sensors.approach, engine.physics.run, []

    def approach(*given: object) -> Array:
        speed = measured(*given)  # type: ignore[arg-type]
        found.fastest_m_s = max(found.fastest_m_s, float(speed.max()))
        return speed

    def running(control: Array, rows: NDArray[np.int64] | None) -> Array:
        sensed = run(control, rows)
        # A reading belongs to the instant before a physics step, in which the servo sees this error.
        errors.append(np.abs(control[..., :joints] - sensed[..., engine.scene.sensors["joint_pos"]]).max(axis=1))
        return sensed

    sensors.approach, engine.physics.run = approach, running  # type: ignore[method-assign]
    return errors


def run(task: str, human: str, bound: str, policy: str, steps: int, seed: int, rows: int, *more: str) -> Count:
    """Run at least `steps` control steps and return what happened."""
    said = [f"task={task}", *PAIRS.get(human, (f"human={human}",)), f"safety.bound={bound}", *WORLD, *more]
    engine, found = Engine(environment(compose("train", said)), rows, seed), Count()
    errors, drive = watched(engine, found), engine.episodes.drive
    assert drive is not None
    act = Policy(policy, rows, seed, engine.episodes.separation.arm)
    state = engine.reset()
    while found.control_steps < steps:
        errors.clear()
        result = engine.step(act(state)[:, : engine.episodes.action_dim])
        error = np.stack(errors, axis=1)[result.valid.numpy()]
        found.largest_error_rad = max(found.largest_error_rad, float(error.max()))
        found.excess_rad = max(found.excess_rad, float((error - drive.error_rad).max()))
        after, last = result.instants, (result.decision_steps - 1)[:, None]
        touching = after.touching
        began = touching & ~torch.cat([state.touching[:, None], touching[:, :-1]], dim=1) & result.valid
        unsafe = after.unsafe_contact.gather(1, last)[:, 0] & ~state.unsafe_contact
        found.control_steps += int(result.valid.sum())
        found.contacts += int(began.sum())
        found.unsafe_contacts += int(unsafe.sum())
        found.unsafe += [f"row {row} step {int(state.steps[row])}" for row in torch.nonzero(unsafe)[:, 0].tolist()]
        found.protective_stops += int((result.state.protective_stops - state.protective_stops).sum())
        found.human_beyond_bound += int((result.state.human_beyond_bound - state.human_beyond_bound).sum())
        state = engine.reset(np.flatnonzero(result.done.numpy()))
    engine.close()
    return found


def main(path: Path, steps: int, people: tuple[str, ...], policies: list[str]) -> None:
    """Add the rows that the table has not got, of some people and policies."""
    columns = [*CELL, *(name for name in vars(Count()) if name != "unsafe")]
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    there = {tuple(row[name] for name in CELL) for row in rows}
    for cell in product(TASKS, people, BOUNDS, policies):
        if cell in there:
            continue
        found = run(*cell, steps, 0, min(ROWS, max(steps // STEPS_A_ROW, 1)))
        rows.append({**dict(zip(CELL, cell, strict=True)), **vars(found)})
        write_table(path, columns, ([row[name] for name in columns] for row in rows))
        print(*cell, found, flush=True)


if __name__ == "__main__":
    torch.set_num_threads(1)
    given = [word for word in sys.argv[3:] if word != "people=2"]
    chosen = tuple(PAIRS) if "people=2" in sys.argv else PEOPLE
    main(Path(sys.argv[1]), int(sys.argv[2]), chosen, given or list(POLICIES))
