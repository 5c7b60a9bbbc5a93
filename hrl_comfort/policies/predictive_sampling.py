"""Model-predictive control by sampling: motions are tried in MuJoCo, and the cheapest one begins.

Predictive sampling (Howell et al. 2022, arXiv:2212.00541) over joint velocities, without a warm start and with the same
noise at every decision, so that the policy has no memory. Motions are rolled out for every row: straight to postures of
the goal at several paces, a stop, and random variations of these, beside the person where they stand now. A motion
costs its control steps and those that are left to the nearest posture, its touches, and its discomfort at the level in
force. It forecasts neither people nor the shield.
"""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np
import torch
from mujoco import rollout
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.terms import discomfort, present
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EnvConfig
from hrl_comfort.policies.collision_checker import CollisionChecker
from hrl_comfort.policies.scripted import StageGoals, standing_limbs
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import CONTROL_SPEC, Scene
from hrl_comfort.sim.controls import pack_controls
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]

HORIZON = 6
"""Decisions of a motion; in the last one it brakes, so that no motion ends fast beside a table."""
PACES = (1.0, 0.5, 0.2)
"""Shares of full speed of the straight motions."""
VARIATIONS = 12
"""Random variations of the straight motions."""
SPREAD = 0.5
"""Standard deviation of their joint velocities, which change once on the way, in shares of full speed."""
POSTURES = 4
"""Postures kept of a goal at most, those nearest to home."""
SOUGHT, TRIES = 12, 200
"""Postures from which those are chosen, and seeds of inverse kinematics from which they are sought."""
BEND_RAD = np.radians(60.0)
"""Standard deviation of a seed's joints from home; the first one is turned towards the goal."""
TOLERANCE = 0.5
"""Distance of a posture's tool from the goal, in tolerances of the task."""
ARRIVED_RAD = np.radians(1.0)
"""Distance of every joint from a posture at which nothing is left of the way."""
TOUCH_STEPS = 300.0
"""Price of a control step in touch, in control steps: an arm that touches leaves at once."""
DEEPEST_M = 1.0
"""Depth up to which the planner is told of touches without forces, which steps of 20 ms cannot resolve."""
DISCOMFORT_STEPS = 4.0
"""Price of a control step of discomfort 1, in control steps."""


class PredictiveSampling:
    """Policy for any rows of any subtask; a function of the state."""

    def __init__(self, scene: Scene, config: EnvConfig, subtask: Subtask) -> None:
        self._goals = StageGoals("predictive_sampling", config, subtask)
        self._scene, self._comfort, self._repeat = scene, config.comfort, config.task.action_repeat
        self._max_step_deg = config.task.max_step_deg
        self._step = np.radians(config.task.max_step_deg)
        self._rating = None if config.robot.rating == "paper" else rating_of(config.robot)
        precision = config.task.precision
        self._tolerance = TOLERANCE * min(precision.grasp_tolerance_m, precision.place_tolerance_m)
        model = copy(scene.model)
        model.opt.timestep = CONTROL_STEP_S
        model.geom_margin[:], model.geom_gap[:] = -DEEPEST_M, DEEPEST_M
        self._model, self._data, self._rollout = model, mujoco.MjData(model), rollout.Rollout(nthread=0)
        self._checker, self._separation = CollisionChecker(scene), Separation(scene)
        self._known: dict[tuple[bytes, ...], Array] = {}
        early = HORIZON // 2
        noise = np.random.default_rng(0).standard_normal((VARIATIONS, 2, len(scene.home)))
        self._noise = SPREAD * np.repeat(noise, [early, HORIZON - early], axis=1)

    @torch.no_grad()
    def act(self, state: State) -> Tensor:
        """Return actions (N, J) in [-1, 1]: joint increments in units of `max_step_deg` a control step."""
        points, homeward = self._goals(state)
        there = zip(points, homeward, state.joint_home.numpy(), state.layout.numpy(), strict=True)
        goals = np.stack([self._postures(point, back, home, layout) for point, back, home, layout in there])
        motions = self.motions(state.joint_target.numpy(), goals)
        cost = self._cost(state, motions, goals)
        return torch.from_numpy(motions[np.arange(len(cost)), cost.argmin(axis=1), 0])

    def motions(self, joints: Array, goals: Array) -> Array:
        """Return K motions (N, K, HORIZON, J) in shares of full speed, from `joints` (N, J) rad.

        `goals` (N, G, J) rad are postures.
        """
        way = goals - joints[:, None]
        length = np.abs(way).max(axis=-1)[..., None, None] / (self._step * self._repeat)
        pace = np.array(PACES)[:, None]
        share = np.clip(length - pace * np.arange(HORIZON), 0.0, pace)
        along = way / np.maximum(np.abs(way).max(axis=-1, keepdims=True), 1e-9)
        straight = share[..., None] * along[:, :, None, None]
        nearest = np.abs(way).max(axis=-1).argmin(axis=1)
        varied = np.clip(straight[np.arange(len(way)), nearest, 0][:, None] + self._noise, -1.0, 1.0)
        every = straight.reshape(len(way), -1, *straight.shape[-2:])
        motions = np.concatenate([every, np.zeros_like(every[:, :1]), varied], axis=1)
        motions[:, :, -1] = 0.0
        return motions

    def _cost(self, state: State, motions: Array, goals: Array) -> Array:
        """Return the cost (N, K), in control steps, of `motions` (N, K, HORIZON, J) on the way to `goals` (N, G, J)."""
        targets = self.targets(state, motions)
        limbs = standing_limbs(state, self._scene.floor_z)
        reached, touching = self._rolled_out(state, targets, limbs)
        left = np.abs(reached[:, :, :, None] - goals[:, None, None]).max(axis=-1).min(axis=-1)
        arrived = left < ARRIVED_RAD
        last = np.where(arrived.any(axis=-1), arrived.argmax(axis=-1), HORIZON - 1)
        steps = self._repeat * (1.0 + last) + np.where(arrived.any(axis=-1), 0.0, left[:, :, -1] / self._step)
        cost = steps + TOUCH_STEPS * touching
        if self._comfort.source != "none":
            until = np.arange(HORIZON) <= last[..., None]
            cost += DISCOMFORT_STEPS * self._repeat * (self._discomfort(state, reached, limbs) * until).sum(axis=-1)
        return np.asarray(cost)

    def targets(self, state: State, motions: Array) -> Array:
        """Return the targets (N, K, HORIZON * repeat, J) rad of an arm of this rating that follows `motions`."""
        n, count, _, joints = motions.shape
        asked = np.repeat(motions * self._step / CONTROL_STEP_S, self._repeat, axis=2).reshape(n * count, -1, joints)
        at, velocity = (np.repeat(each.numpy(), count, axis=0) for each in (state.joint_target, state.target_vel))
        arm, (low, high) = self._separation.arm, self._scene.joint_range.T
        targets = np.empty_like(asked)
        for k in range(asked.shape[1]):
            wanted = asked[:, k]
            if self._rating is not None:
                limited = self._rating.limited(arm, arm.pose(at), wanted)
                wanted = self._rating.follow(velocity, self._rating.within(low, high, at, limited))
            velocity = wanted
            at = np.clip(at + velocity * CONTROL_STEP_S, low, high)
            targets[:, k] = at
        return targets.reshape(n, count, -1, joints)

    def _rolled_out(self, state: State, targets: Array, limbs: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return the joints (N, K, HORIZON, J) rad after each decision, and how many control steps (N, K) touch.

        The first control step, where the arm is now, does not count. People stand at `limbs` (N, L, 7).
        """
        n, count, steps, joints = targets.shape
        rows = np.repeat(np.arange(n), count)
        state_of = np.concatenate([np.zeros((n, 1)), state.joint_pos.numpy(), state.joint_vel.numpy()], axis=1)
        beside = np.repeat(limbs[rows], steps, axis=0)
        nothing = np.zeros((n * count, 0, 3))
        flat = targets.reshape(n * count, steps, joints)
        objects = nothing, np.zeros((n * count, 0), dtype=np.int64)
        control = pack_controls(self._scene, flat, beside, state.layout.numpy()[rows], *objects, nothing)
        run = self._rollout.rollout(self._model, self._data, state_of[rows], control, control_spec=CONTROL_SPEC)
        sensed, at = run[1].reshape(n, count, steps, -1), self._scene.sensors
        touching = np.any([sensed[:, :, 1:, at[name]].any(axis=-1) for name in ("human", "table", "self")], axis=0)
        return sensed[:, :, self._repeat - 1 :: self._repeat, at["joint_pos"]], touching.sum(axis=-1)

    def _discomfort(self, state: State, reached: Array, limbs: Array) -> Array:
        """Return the discomfort (N, K, HORIZON) of the joints `reached` (N, K, HORIZON, J); 0 without a person."""
        n, count, ends, joints = reached.shape
        beside = np.repeat(limbs, count * ends, axis=0)
        distance = self._separation.gap(reached.reshape(-1, joints), beside).reshape(n, count, ends)
        begun = np.broadcast_to(state.joint_pos.numpy()[:, None, None], (n, count, 1, joints))
        moved = np.degrees(np.abs(np.diff(reached, axis=2, prepend=begun)).max(axis=-1)) / self._repeat
        level = state.level[:, None, None].expand(n, count, ends)
        cost = discomfort(torch.from_numpy(distance), torch.from_numpy(moved), level, self._max_step_deg, self._comfort)
        return np.asarray(torch.where(present(state.humans_pos)[:, None, None], cost, 0.0).numpy())

    def _postures(self, goal: Array, back: bool, home: Array, layout: Array) -> Array:
        """Return postures (POSTURES, J) rad, some of them alike, with the tool at `goal` (3,) m, or `home` (J,) rad.

        Raises:
          ConfigError: there is none without a collision.
        """
        if back:
            return np.tile(home, (POSTURES, 1))
        goal = goal.round(3)
        key = goal.tobytes(), home.tobytes(), layout.tobytes()
        if key not in self._known:
            self._checker.stand(layout)
            found, rng = [], np.random.default_rng(0)
            for _ in range(TRIES):
                seed = home + BEND_RAD * rng.standard_normal(len(home))
                tool = self._separation.arm.tool(seed[None])[0]
                turned = seed[0] + np.arctan2(goal[1], goal[0]) - np.arctan2(tool[1], tool[0])
                seed[0] = (turned + np.pi) % (2 * np.pi) - np.pi
                posture = self._checker.reach(np.clip(seed, *self._scene.joint_range.T), goal, self._tolerance)
                found += [] if posture is None else [posture]
                if len(found) == SOUGHT:
                    break
            if not found:
                raise ConfigError(f"no posture found that brings the tool to {goal.tolist()}: is it within reach?")
            found.sort(key=lambda each: float(np.abs(each - home).max()))
            self._known[key] = np.array(found)[np.arange(POSTURES) % len(found)]
        return self._known[key]
