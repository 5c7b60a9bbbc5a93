"""An engine whose arm is a robot: one cell in real time, its surroundings those of the simulated cell."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_comfort.comfort.sources import Live
from hrl_comfort.config import CONTROL_STEP_S, EnvConfig, HumanConfig, SafetyConfig
from hrl_comfort.deploy.arms import Reading
from hrl_comfort.deploy.held import Objects
from hrl_comfort.deploy.links import Link
from hrl_comfort.deploy.predictor import SPLINE_S, Predictor
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.humans.motions.live import CheckedPoses, pose_source
from hrl_comfort.scene.workcell import CONTROL_SPEC, Scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.physics import state_of
from hrl_comfort.sim.sensors import COLLISIONS
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.sim.variation.randomisation import Values
from hrl_comfort.tasks import State

Array = NDArray[np.float64]
APPROACH_SHARE, APPROACH_GAIN = 0.25, 4.0
"""Way to the start of an episode: largest share of `task.max_step_deg`, and speed over the angle that is left, 1/s."""
AT_START_RAD = 2e-3
PATIENCE_S = 60.0
"""Longest time for the way to the start, on which the shield may wait for people."""
CHECKED_RAD = np.radians(1.0)
"""Distance of the poses that are checked on the way."""
AT_ONCE_M_S = 1e3
"""Speed of a live person in the cell, who is where the source says."""


class RobotEngine(Engine):
    """One cell, whose arm is at the other end of a link and whose contacts are those of the model at its pose.

    A decision is `task.action_repeat` control steps, each planned on the newest state of arm and person.

    Args:
      config: of the cell.
      link: to the streamer of the arm.
      entries: episodes of an evaluation split.
      interrupted: returns whether somebody wants the arm to stop.
      endure: shield stops do not end the run, and nothing is too old.
    """

    def __init__(
        self, config: EnvConfig, link: Link, entries: EvaluationSet, interrupted: Callable[[], bool], endure: bool
    ) -> None:
        self._repeat, self.link = config.task.action_repeat, link
        self._interrupted, self._endure = interrupted, endure
        config = replace(config, engine=replace(config.engine, substeps=1))
        # The streamer's spline follows the plan half a control step later.
        late = replace(config, safety=replace(config.safety, latency_s=config.safety.latency_s + SPLINE_S))

        def physics(scene: Scene, _: EnvConfig, __: int) -> RobotPhysics:
            self._robot = RobotPhysics(scene, config.safety, link)
            return self._robot

        super().__init__(late, 1, 0, entries, measure_arm=True, physics=physics, steps=1, takes_back=False)
        self._entries = entries
        self.episodes.people.follow_at(AT_ONCE_M_S)
        self._people = sources_of(config.human)

    def start(self, index: int) -> State:
        """Take the arm to the start of the episode `index` of the entries and begin it; return its first state.

        Raises:
          StoppedError: no way there is free, or the arm was stopped on it.
        """
        first = self._begin(index)
        self._robot.lay()
        self._approach(first.joint_pos[0].numpy())
        self._begin(index)
        return self._follow()

    def lying(self) -> list[str]:
        """Return where each object of the episode has to lie, frame of the robot's base."""
        draw, names = self.episodes.draw, self.scene.cell.kinds
        found = zip(draw.kinds[0], draw.objects(np.arange(1))[0], draw.turns[0], strict=True)
        return [
            f"{names[kind]} with its middle at ({x:.3f}, {y:.3f}, {z:.3f}) m, turned by {np.degrees(turn):.0f} degrees"
            for kind, (x, y, z), turn in found
        ]

    def step(self, action: Array, rows: NDArray[np.int64] | None = None) -> StepResult:
        """Run one decision, action (1, A) in [-1, 1], and return its result.

        Raises:
          StoppedError: the arm has been brought to rest, or is about to be.
        """
        results: list[StepResult] = []
        while len(results) < self._repeat and not (results and self._over(results)):
            results.append(self._control_step(action))
        return joined(results, self._repeat)

    def _over(self, results: list[StepResult]) -> bool:
        return bool(results[-1].done) or int(results[-1].state.stage) != self._stage

    def _control_step(self, action: Array) -> StepResult:
        assert self.episodes.state is not None
        self._stage = int(self.episodes.state.stage)
        self._check_fresh()
        result = super().step(action)
        state = self._follow()
        if bool(state.braking) and not self._endure:
            raise StoppedError("shield at zero: a person could reach the arm before it is slow")
        return replace(result, state=state)

    def _check_fresh(self) -> None:
        """Raise StoppedError where somebody wants the arm to stop, or the person's position or the level is old."""
        if self._interrupted():
            raise StoppedError("interrupted", 130)
        if self._endure:
            return
        for person in self._people:
            person()
            age = time.monotonic() - person.arrived_s + CONTROL_STEP_S
            if age > self.episodes.config.safety.delay_s:
                raise StoppedError(f"stale person: position {age:.3g} s old, safety.delay_s is "
                                   f"{self.episodes.config.safety.delay_s:g}")  # fmt: skip
        level = self.episodes.source.levels
        if isinstance(level, Live) and level.stalled:
            raise StoppedError(f"stale level: no good value for {self.episodes.config.comfort.stream.stall_s:g} s")

    def _follow(self) -> State:
        """Return the state with the set-points that were sent, which need not be those that were planned."""
        report = self.link.report
        return self.episodes.measured(joint_target=report.point[None], target_vel=report.velocity[None])

    def _begin(self, index: int) -> State:
        return super().reset(np.zeros(1, dtype=np.int64), self._entries.part(index, index + 1))

    def _approach(self, start: Array) -> None:
        """Move the arm to the joint angles `start` (J,) rad, slowly and behind the shield, which waits for people."""
        largest = np.radians(self.episodes.config.task.max_step_deg)
        here, opened = self.link.report.reading, np.full(int(self.scene.gripper is not None), -1.0)
        self._robot.measure(here)
        self.episodes.measured(joint_pos=here.angles[None], joint_vel=here.velocity[None])
        self._follow()
        left_steps = round(PATIENCE_S / CONTROL_STEP_S)
        for goal in self._way(start):
            while np.abs(left := goal - self.link.report.point).max() > AT_START_RAD:
                asked = APPROACH_GAIN * CONTROL_STEP_S * left / largest
                asked = np.append(asked / max(1.0, np.abs(asked).max() / APPROACH_SHARE), opened)
                state = self._control_step(asked[None]).state
                if bool(self.episodes.subtask.failure(state)):
                    hit = [name for name in ("touching", *COLLISIONS, "unsafe_contact") if bool(getattr(state, name))]
                    raise StoppedError(f"on the way to the start: {hit[0].replace('_', ' ')}")
                left_steps -= 1
                if not left_steps:
                    raise StoppedError(
                        f"on the way to the start: not there after {PATIENCE_S:g} s; somebody is in the way, or "
                        f"task.max_step_deg={self.episodes.config.task.max_step_deg:g} is too slow"
                    )
        self.link.rest()

    def _way(self, start: Array) -> list[Array]:
        """Return the joint angles (J,) rad to go straight to, one after the other: `start`, or home before it.

        Raises:
          StoppedError: neither way is free.
        """
        here = self.link.report.reading.angles
        for way in ([start], [self.scene.home, start]):
            if not (touched := next(filter(None, map(self._touched, [here, *way], way)), "")):
                return way
        degrees = np.degrees(here).round().astype(int).tolist()
        raise StoppedError(
            f"the way from {degrees} degrees to the start would touch the {touched}: move the arm by hand"
        )

    def _touched(self, begin: Array, end: Array) -> str:
        """Return what the arm would touch straight from `begin` to `end` (J,) rad: table, self, or nothing."""
        count = int(np.ceil(np.abs(end - begin).max() / CHECKED_RAD)) + 1
        for share in np.linspace(0.0, 1.0, max(count, 2)):
            sensed = self._robot.touch(begin + share * (end - begin), np.zeros_like(begin))
            for key in ("table", "self"):
                if sensed[self.scene.sensors[key]].any():
                    return key
        return ""


class RobotPhysics:
    """The arm at the other end of `link`, beside the surroundings of the model `scene`; one cell, see `Physics`."""

    def __init__(self, scene: Scene, safety: SafetyConfig, link: Link) -> None:
        self._scene, self._safety, self._link = scene, safety, link
        self._twin, self.state = mujoco.MjData(scene.model), np.zeros((1, scene.nstate))
        self._angles, self._velocity = np.split(scene.moving - 1, 2)
        self._velocity = self._velocity - scene.model.nq
        self._objects = None if scene.gripper is None else Objects(scene)

    @property
    def joints(self) -> Array:
        """See `Physics`."""
        return self.state[:, self._scene.moving]

    def measure(self, reading: Reading) -> None:
        """Take the joints from a reading."""
        self.state[0, self._scene.moving] = np.concatenate([reading.angles, reading.velocity])

    def sense(self, rows: NDArray[np.int64], bodies: Array, control: Array, values: Values) -> Array:
        """See `Physics`."""
        twin, model = self._twin, self._scene.model
        mujoco.mj_setState(model, twin, control[0], CONTROL_SPEC)
        twin.qpos[:], twin.qvel[:] = np.split(bodies[0], [model.nq])
        mujoco.mj_forward(model, twin)
        return twin.sensordata.copy()[None]

    def touch(self, angles: Array, velocity: Array, control: Array | None = None) -> Array:
        """Return the sensors (nsensor,) of the model at joint angles and velocities (J,), beside those of `control`."""
        twin, model = self._twin, self._scene.model
        if control is not None:
            mujoco.mj_setState(model, twin, control, CONTROL_SPEC)
        twin.qpos[self._angles], twin.qvel[self._velocity] = angles, velocity
        if self._objects is not None:
            self._objects.put(twin)
        mujoco.mj_forward(model, twin)
        sensed = twin.sensordata.copy()
        if self._objects is not None:
            self._objects.tell(sensed)
        return sensed

    def begin(self, rows: NDArray[np.int64], bodies: Array, values: Values) -> None:
        """See `Physics`."""
        self.state[rows] = state_of(bodies)
        if self._objects is not None:
            self._objects.begin(bodies[0, : self._scene.model.nq])
        self._predictor = Predictor(self._safety.lag_s, self._safety.latency_s, self._link.report.point)

    def begin_decision(self) -> None:
        """See `Physics`."""

    def lay(self) -> None:
        """Lay the objects where the episode begins."""
        if self._objects is not None:
            self._link.lay(self._objects.poses)

    def run(self, control: Array, rows: NDArray[np.int64] | None) -> Array:
        """Give the set-point of `control` (1, T, ncontrol), the last one.

        Return the readings (1, T, nsensor), all of them those where the arm will be when it comes.
        """
        joints, target = len(self._scene.home), control[0, -1]
        if self._objects is None:
            report = self._link.step(target[:joints])
        else:
            opened, shut = self._scene.model.actuator_ctrlrange[joints]
            closed = float((target[joints] - opened) / (shut - opened))
            report = self._link.step(np.append(target[:joints], closed))
        if report.stopped:
            raise StoppedError(report.stopped)
        self._predictor.follow(report.point)
        reading = self._predictor.ahead(report.reading)
        self.measure(reading)
        if self._objects is not None and report.reading.hand is not None:
            self._objects.follow(report.reading.hand, closed, reading.angles)
        sensed = self.touch(reading.angles, reading.velocity, target)
        return np.tile(sensed, (1, control.shape[1], 1))

    def end_decision(self, steps: NDArray[np.int64], rows: NDArray[np.int64] | None) -> None:
        """See `Physics`; an arm does not go back."""

    def close(self) -> None:
        """See `Physics`; the link is its owner's."""


def sources_of(human: HumanConfig) -> list[CheckedPoses]:
    """Return the outside sources of the positions of live people."""
    sources = [pose_source(each.file) for each in human.everyone if each.motion == "live"]
    return [source for source in sources if isinstance(source, CheckedPoses)]


def joined(results: list[StepResult], count: int) -> StepResult:
    """Return decisions of one control step each as one of at most `count`, those that did not come void."""
    last, missing = results[-1], count - len(results)
    padded = results + [last] * missing
    taken = torch.arange(count)[None] < len(results)
    moving = {name: np.concatenate([each.moving[name] for each in padded], axis=1) for name in last.moving}
    return replace(
        last,
        reward_terms=torch.stack([each.reward_terms for each in results]).sum(dim=0),
        step_rewards=torch.cat([each.step_rewards for each in padded], dim=1) * taken,
        decision_steps=torch.tensor([len(results)]),
        before=results[0].before,
        moving=moving,
    )
