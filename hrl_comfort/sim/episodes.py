"""Episodes of N cells: begun by draws, planned, run by whoever has the physics, and judged.

All fronts share this definition of an episode: `engine` runs it in batches, `envs.dm` one cell at a time and
`deploy.robot` on a real arm. Every random number of it comes from (seed, row, episode).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.comfort.adapt import with_comfort
from hrl_comfort.comfort.sources import Live, Source, make_source
from hrl_comfort.config import ConfigError, EnvConfig, HumanConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.safety.drive import Drive
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.episode_sampler import ATTEMPTS, DISTURBANCE_STREAM, EpisodeSampler
from hrl_comfort.sim.objects import choose_target
from hrl_comfort.sim.people import People
from hrl_comfort.sim.plan import Joints, Plan
from hrl_comfort.sim.referee import Referee
from hrl_comfort.sim.step_result import StepResult, tensors
from hrl_comfort.sim.variation.disturbance import Disturbance
from hrl_comfort.sim.variation.randomisation import Values, observed
from hrl_comfort.tasks import Start, State, Subtask, subtask
from hrl_comfort.tasks.observations.standard import share

Array = NDArray[np.float64]
Probe = Callable[[NDArray[np.int64], Array, Array, Values], Array]
"""`Physics.sense`."""


class Episodes:
    """The episodes of `rows` cells.

    With an `evaluation` set, row r runs the set's entry r (modulo its length). `measure_arm` fills
    `State.arm_distance` even if no reward needs it; `disturbance` is one of `config.DISTURBANCES`. `steps` are the
    control steps of a decision, `task.action_repeat` by default; `takes_back` as of `Drive`. The rows may be some of
    more: their numbers begin at `first_row`. `live` levels are opened and closed elsewhere.
    """

    def __init__(
        self,
        scene: Scene,
        config: EnvConfig,
        rows: int,
        seed: int,
        evaluation: EvaluationSet | None = None,
        measure_arm: bool = False,
        disturbance: str = "none",
        steps: int | None = None,
        takes_back: bool = True,
        first_row: int = 0,
        live: Live | None = None,
    ) -> None:
        self.scene, self.config, self.rows, self._first_row = scene, config, rows, first_row
        task = config.task
        known = subtask(task.name, task.observation, task.objects, config.robot.gripper.holds)
        plain = replace(known, terminate_on=task.terminate_on, arrival_speed=task.arrival_speed_rad_s)
        seen = with_comfort(plain, config.comfort, task.max_step_deg)
        self.subtask: Subtask = seen.observing(share=share) if config.safety.kind != "none" else seen
        self.reward_names = tuple(self.subtask.rewards)
        self.precision_m = task.precision.grasp_tolerance_m
        self.sampler = EpisodeSampler(scene, config, self.subtask, seed, evaluation)
        self.separation, self._disturbance = Separation(scene), Disturbance(disturbance, rows)
        self.plan = Plan(
            scene, self.separation, config, self.subtask, self.sampler, self._disturbance, rows,
            task.action_repeat if steps is None else steps, takes_back,
        )  # fmt: skip
        pushing = self.plan.drive is None and not self.plan.people_stop
        self.referee = Referee(
            scene, self.separation, config, self.subtask, make_source(config.comfort, rows, live), self._disturbance,
            measure_arm, pushing,
        )  # fmt: skip
        self.episode = np.full(rows, -1, dtype=np.int64)
        self._ready = np.zeros(rows, dtype=bool)
        self.draw = self.sampler.blank(rows)
        """Values drawn for the episode of each row."""
        self.state: State | None = None

    @property
    def action_dim(self) -> int:
        """Size A of an action."""
        return self.plan.action_dim

    @property
    def drive(self) -> Drive | None:
        """The drive of the arms; None for arms without a rating."""
        return self.plan.drive

    @property
    def people(self) -> People:
        """The people, as they are now and as they were in the last decision."""
        return self.plan.people

    @property
    def walk(self) -> humans.Walk:
        """The first person (N) as they are now."""
        return self.people.now.walks[0]

    @property
    def human(self) -> HumanConfig:
        """Configuration by which the first person moves now."""
        return self.people.everyone[0]

    @property
    def source(self) -> Source:
        """Source of the comfort levels."""
        return self.referee.source

    def begin(self, rows: NDArray[np.int64], probe: Probe, entries: EvaluationSet | None = None) -> Array:
        """Begin the next episode of `rows` (r,); return their bodies (r, nq + nv): positions and velocities.

        Without a gripper these are the joints (r, 2 J): angles rad, velocities rad/s.

        With `entries` (r,) of an evaluation split the rows begin these; the next call without them begins the episode
        that they would have begun now. Draws are repeated until the cell begins free of contact and unsolved,
        and an object that is in the hand between both pads.

        Raises:
          ConfigError: no such start was found.
        """
        if entries is None:
            self.episode[rows] += 1
            attempts = {row: self.sampler.attempts(self._number(row), int(self.episode[row])) for row in rows}
        else:
            sampler = EpisodeSampler(self.scene, self.config, self.subtask, 0, entries)
            attempts = {row: sampler.attempts(index, 0) for index, row in enumerate(rows)}
        pending, model = rows, self.scene.model
        bodies = np.empty((self.rows, model.nq + model.nv))
        for _ in range(ATTEMPTS):
            for row in pending:
                for name, value in vars(next(attempts[row])).items():
                    getattr(self.draw, name)[row] = value
                rng = self.sampler.generator(self._number(row), int(self.episode[row]), DISTURBANCE_STREAM)
                drop = self.draw.kind_places[row, self.draw.kinds[row, 0]]
                place = self._disturbance.begin(row, drop, self.config.human.keep_out_m, rng)
                if place is not None:
                    self.draw.spawn_id[row], self.draw.spawn[row, 0] = -1, place
            self.source.draws[pending] = self.draw.level[pending]
            self.source.person[pending] = self.draw.person[pending]
            self.source.begin(pending)
            values = self.values(pending)
            planned, control = self.plan.begin(pending, self.draw, values)
            bodies[pending] = planned.bodies
            sensed = probe(pending, planned.bodies, control, values)
            state = self.referee.first(sensed, planned, self._drawn(pending))
            if self.state is None and len(pending) < self.rows:
                raise ConfigError("the first reset must reset every row")
            self.state = state if self.state is None else self.state.put(torch.from_numpy(pending), state)
            self.plan.accepted(pending, planned.limbs[:, 0])
            bad = self.subtask.begins_done(state) | state.touching | self.subtask.failure(state)
            if self.scene.gripper is not None and self.subtask.start == Start.AT_OBJECT:
                bad |= ~state.pads[:, 0].all(dim=-1)
            pending = pending[bad.numpy()]
            if not len(pending):
                self._ready[rows] = True
                return bodies[rows]
        numbers = [self._number(row) for row in pending]
        raise ConfigError(f"no free start for {self.subtask.name} in rows {numbers} after {ATTEMPTS} attempts")

    def _number(self, row: np.int64) -> int:
        """Return the number of `row` among the rows of which these are some."""
        return self._first_row + int(row)

    def begun_elsewhere(self, rows: NDArray[np.int64], draw: dict[str, NDArray[Any]], following: bool) -> None:
        """Take what another process drew (r, ...) for episodes of `rows` (r,), each `following` its row's latest."""
        self.episode[rows] += following
        for name, value in draw.items():
            getattr(self.draw, name)[rows] = value
        self._ready[rows] = True

    def _drawn(self, rows: NDArray[np.int64]) -> dict[str, Tensor]:
        """Return the fields (r, ...) of `rows` (r,) that stay, or begin, as drawn.

        The first object is the target, none is placed. All tolerances scale with `precision_m`.
        """
        precision, draw = self.config.task.precision, self.draw
        n, scale, kinds = len(rows), self.precision_m / precision.grasp_tolerance_m, draw.kinds[rows]
        constant = {
            "target": np.int64(0),
            "stage": np.int64(0),
            "grasp_tolerance": self.precision_m,
            "place_tolerance": scale * precision.place_tolerance_m,
            "home_tolerance": scale * np.radians(precision.home_tolerance_deg),
        }
        known = {
            **{name: np.repeat(np.asarray(value)[None], n, axis=0) for name, value in constant.items()},
            "tcp_home": draw.tcp_home[rows],
            "joint_home": draw.home[rows],
            "layout": draw.layout(rows),
            "tops": draw.tops[rows],
            **self.plan.bodies(draw.start[rows, : len(self.scene.joints)], rows),
            "kind_places": draw.kind_places[rows],
            "points": draw.points[rows],
            "kinds": kinds,
            "placed": np.zeros(kinds.shape, dtype=bool),
            "key": draw.key[rows],
            "due": draw.due[rows, 0],
            "level": self.source.level[rows],
        }
        if self.scene.gripper is None:
            known["objects"] = draw.objects(rows)
        else:
            sizes = np.array([each.half_m for each in self.config.cell.objects.values()], dtype=np.float64)
            known["kind_sizes"] = sizes * draw.factors[rows, 2, :, None]
            if kinds.shape[1] > 1:
                known["object_slots"] = draw.slots[rows]
        return {name: torch.from_numpy(value) for name, value in known.items()}

    def rewind(self, seed: int | None = None) -> None:
        """Restart each row from its first episode, of another `seed` if given; it begins before the next decision."""
        if seed is not None:
            self.sampler.seed = seed
        self.episode[:] = -1
        self._ready[:] = False

    def again(self) -> None:
        """Let the next episode of each row be the present one again."""
        self.episode -= 1

    def controls(self, action: Array, joints: Joints) -> Iterator[Array]:
        """Yield the controls (N, T, ncontrol) of the next T physics steps of a decision; action (N, A) in [-1, 1].

        `joints` returns the joints (N, 2 J) as they are when it is called: angles, rad, velocities, rad/s.

        Raises:
          RuntimeError: a row has no episode yet.
          ValueError: the actions are of another shape.
        """
        return self.plan.controls(self.before(action), self.draw, action, joints)

    def before(self, action: Array) -> State:
        """Return the state in which a decision with `action` (N, A) begins; raise as `controls` does."""
        if self.state is None or not self._ready.all():
            raise RuntimeError("there is no episode yet: call reset before step")
        if action.shape != (shape := (self.rows, self.action_dim)):
            raise ValueError(f"actions of shape {action.shape} are not allowed; they must have shape {shape}")
        return self.state

    def advance(self, sensed: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Return the result of a decision from its readings (r, K * substeps, nsensor) in `rows` (r,), all by default.

        A decision ends where its stage or its episode does, so that the next one, perhaps of another policy,
        begins there. The caller takes each row's physics from the end of its last valid control step.
        """
        assert self.state is not None
        readings = sensed.reshape(len(sensed), -1, self.config.substeps, sensed.shape[-1])
        limbs = self.people.now.limbs
        result = self.referee.judge(self.state, self.draw, self.plan.planned, limbs, readings, rows)
        self.plan.end(result.decision_steps.numpy() - 1)
        self.state = result.state.with_(**tensors(self.plan.bodies(result.state.joint_pos.numpy())))
        return replace(result, state=self.state)

    def lay(self, result: StepResult, physics: Array) -> None:
        """Put the objects that arrived at the end of the decision of `result` into the `physics` (N, nstate)."""
        if "objects" in result.moving:
            last = np.arange(self.rows), result.decision_steps.numpy() - 1
            arrived = (result.state.objects.numpy() != result.moving["objects"][last]).any(axis=-1)
            self.plan.lay(result.state, arrived, physics)

    def values(self, rows: Any = slice(None)) -> Values:
        """Return how the cells of `rows`, all by default, differ from the model."""
        return Values(self.config.randomise, self.draw.world[rows], self.draw.factors[rows])

    def observe(self) -> Tensor:
        """Return the observations (N, D) of the cells as they are now."""
        assert self.state is not None
        return self.subtask.observe(self.observed(self.state))

    def observed(self, state: State) -> State:
        """Return the present `state` (N rows) as the sensors report it, for policies."""
        return observed(self.config.randomise, self.values(), self.draw.readings, state, self.separation.arm)

    def max_episode_steps(self, level: Tensor) -> Tensor:
        """Return the time limits (N,) in control steps at levels (N,)."""
        return self.referee.max_episode_steps(level)

    def aim(self, rows: Tensor, index: Tensor) -> None:
        """Make the objects `index` (r,) the targets of `rows` (r,).

        Raises:
          ValueError: a row is not to pick now, or the object has been placed.
        """
        assert self.state is not None
        self.state = choose_target(self.state, rows, index, self.subtask)

    def measured(self, **fields: Array) -> State:
        """Take `fields` (N, ...) of State, measured by somebody else, and return the state."""
        assert self.state is not None
        self.state = self.state.with_(**{name: torch.from_numpy(value.copy()) for name, value in fields.items()})
        return self.state

    def take_levels(self, source: Source) -> None:
        """Take the comfort levels of these episodes from another `source`, from the end of the next decision on."""
        source.draws, source.person = self.draw.level.copy(), self.draw.person.copy()
        self.referee.source = source

    def stand(self, walk: humans.Walk) -> None:
        """Let the episodes that have just begun, of all rows, begin with the first person as `walk` (N) instead."""
        self.measured(**self.plan.stand(walk, self.draw, self.values()))

    def go_on_as(self, human: HumanConfig) -> None:
        """Let the first person go on from where they are as `human` says; see `People.go_on_as`."""
        self.people.go_on_as(human)

    def state_dict(self) -> dict[str, Any]:
        """Return what an exact continuation needs, as tensors and plain numbers."""
        assert self.state is not None
        return {
            "precision_m": self.precision_m,
            "reach": self.sampler.reach,
            "episode": torch.from_numpy(self.episode.copy()),
            "draw": {name: torch.from_numpy(value.copy()) for name, value in vars(self.draw).items()},
            "state": dict(self.state.fields()),
            "plan": self.plan.state_dict(),
            "referee": self.referee.state_dict(),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from `state_dict`."""
        self.precision_m, self.sampler.reach = saved["precision_m"], saved["reach"]
        self.episode = saved["episode"].numpy().copy()
        for name, value in saved["draw"].items():
            getattr(self.draw, name)[:] = value.numpy()
        self.state = State(**saved["state"])
        self.plan.load_state_dict(saved["plan"])
        self.referee.load_state_dict(saved["referee"])
        self._ready[:] = True
