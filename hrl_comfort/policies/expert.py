"""A scripted expert: goal postures by mink, straight joint-space legs, and a forecast of the person's walk.

At every decision it weighs plans for every row: straight to one of the goal's postures, to one by way of an
intermediate posture, or to wait in such a posture. A plan costs its control steps plus a price on the chance
that the person, modelled as Brownian motion, reaches the arm; of several people it sees the one nearest to the tool.
The expert follows the first leg of the cheapest plan without collision for one decision. It remembers nothing but
postures.

Where there is a comfort level, the person counts as wider at a low one (`comfort.alpha`), and joints move more slowly
(`comfort.beta`).
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.adapt import longest_max_episode_steps
from hrl_comfort.comfort.terms import ease, present
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EnvConfig
from hrl_comfort.policies.collision_checker import CLEARANCE_M, ArmSpheres, CollisionChecker
from hrl_comfort.policies.scripted import StageGoals, comfortable_pace, nearest_person
from hrl_comfort.scene.human import ARM_RADIUS_M, SHOULDER_HALF_WIDTH_M, SHOULDER_M, TRUNK_RADIUS_M
from hrl_comfort.scene.ur import UR_ARMS
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]
Goal = tuple[float, ...] | None
"""Tool position, m; None for the home posture."""

NEAREST, SPREAD = 12, 36
"""Postures kept for a goal: those nearest to home, and others, weighed only where those do not suffice."""
CONSIDERED = 12
"""Safest goal postures, to which detours are weighed."""
LIBRARY = 20_000
"""Random postures that seed inverse kinematics."""
DISTINCT_RAD = np.radians(25.0)
"""Two postures of a goal differ by this in some joint."""
UPRIGHT_PANS_RAD = np.radians(np.arange(-225.0, 226.0, 45.0))
PARTS = np.array(list(product([False], *[[False, True]] * 4, [False])))
"""(16, 6) bool, the joints that a partial homing brings home."""
BRAKING = 2.0
"""Decisions before the end of a leg from which on a rated arm slows down: it cannot stop at once."""
WITHIN, RATED_WITHIN = 0.6, 0.8
"""Part of the tolerance within which a posture of a goal is; a rated arm, which strays as it stops, keeps farther from
what the object lies on."""
SAMPLES = 12
"""Instants at which a leg of a plan is checked for the person."""
ARM_SWING_RAD = np.radians(15.0)
"""Swing of the arms of a person of random_walk."""
FORESIGHT_STEPS = 30.0
"""Horizon of the forecast; the next decisions can answer to what comes later."""
RISK_STEPS, LAST_RISK_STEPS = 1500.0, 150.0
"""Price of a certain collision in control steps, at the beginning and at the time limit."""
WAIT_STEPS = 120.0
"""Price of waiting in control steps."""
MARGIN_M = 0.5
"""Width added to the person at level 1; none is at level N_c."""
SLOWEST = 0.2
"""Smallest share of full speed, at level 1: more slowly, the time beside the person costs more than the speed."""
NEGLIGIBLE = 2e-3
"""Collision chance below which a straight plan is not compared with detours."""


class _Known:
    """Knowledge of the expert about a layout whose home posture is `home` (6,) rad."""

    def __init__(self, home: Array) -> None:
        self.home = home
        self.upright = np.tile(home, (len(UPRIGHT_PANS_RAD), 1))
        self.upright[:, 0] = UPRIGHT_PANS_RAD
        self.postures: dict[tuple[tuple[float, ...], bool], Array] = {}
        self.passages: dict[Goal, dict[tuple[int, int], bool]] = {}


class Expert:
    """Policy for any rows of any subtask; a function of the state.

    Raises:
      ConfigError: the robot is not one of UR_ARMS.
    """

    NAME = "expert"
    """By which `policy=` chooses it."""

    def __init__(self, scene: Scene, config: EnvConfig, subtask: Subtask) -> None:
        if config.robot.name not in UR_ARMS:
            raise ConfigError(
                f"robot.name={config.robot.name} is not allowed with policy={self.NAME}; "
                f"choose one of {', '.join(UR_ARMS)}, or policy=potential_field"
            )
        self._goals, self._comfort = StageGoals(self.NAME, config, subtask), config.comfort
        self._step = np.radians(config.task.max_step_deg)
        rated = config.robot.rating != "paper"
        self._slowing = self._step * config.task.action_repeat * (BRAKING if rated else 1.0)
        self._limit = longest_max_episode_steps(config.task.max_episode_steps, config.comfort)
        human, precision = config.human, config.task.precision
        self._sigma = human.jitter_m / np.sqrt(3.0)
        self._drift = human.speed_m_s * CONTROL_STEP_S if human.motion == "approach" else 0.0
        within = RATED_WITHIN if rated else WITHIN
        self._tolerance = within * min(precision.grasp_tolerance_m, precision.place_tolerance_m)
        self._range, self._shoulder_z = scene.joint_range, scene.floor_z + SHOULDER_M
        self._cell = CollisionChecker(scene)
        self._body = ArmSpheres(scene)
        self._library = self._seeds(scene.home)
        self._library_tool = self._body.arm.tool(self._library)
        self._layouts: dict[bytes, _Known] = {}
        self._here, self._layout = _Known(scene.home), scene.layout

    @torch.no_grad()
    def act(self, state: State) -> Tensor:
        """Return actions (N, 6) in [-1, 1]: joint increments in units of `max_step_deg` a control step."""
        layout, home = state.layout.numpy(), state.joint_home.numpy()
        alike: dict[bytes, list[int]] = {}
        for row in range(len(home)):
            alike.setdefault(layout[row].tobytes() + home[row].tobytes(), []).append(row)
        if len(alike) == 1:
            return self._act(state, layout[0], home[0])
        action = torch.empty_like(state.joint_target)
        for rows in alike.values():
            action[rows] = self._act(state.rows(torch.tensor(rows)), layout[rows[0]], home[rows[0]])
        return action

    def _act(self, state: State, layout: Array, home: Array) -> Tensor:
        """Return the actions of cells of one layout (F, 7) and home posture (6,) rad; see `act`."""
        self._stand(layout, home)
        joints = state.joint_target.numpy()
        goals = self._goals_of(state)
        margin, pace = self._margin_and_pace(state)
        people, price = self._people(state, margin, pace), self._price(state)

        nearest = np.stack([self._postures(goal)[:NEAREST] for goal in goals])
        steps, risk = self._weigh(joints[:, None], nearest, people[:, None])
        best = (steps + price[:, None] * risk).argmin(axis=1)
        target = nearest[np.arange(len(best)), best]
        for row, choice in enumerate(best):
            slowed = steps[row, choice] > self._steps(joints[row], target[row], people[row]) + 1.0
            if slowed or risk[row, choice] > NEGLIGIBLE or not self._cell.free(joints[row], target[row]):
                target[row] = self._deliberate(joints[row], people[row], goals[row], price[row])
        move = target - joints
        largest = np.abs(move).max(axis=-1, keepdims=True)
        return torch.from_numpy(move / np.maximum(largest / pace[:, None], self._slowing))

    def _stand(self, layout: Array, home: Array) -> None:
        """Go to cells of one layout (F, 7) and home posture (6,) rad."""
        self._here = self._layouts.setdefault(layout.tobytes() + home.tobytes(), _Known(home))
        self._cell.stand(layout)
        self._layout = layout

    def _goals_of(self, state: State) -> list[Goal]:
        """Return the goal of each row."""
        points, homeward = self._goals(state)
        return [None if home else tuple(point) for point, home in zip(points.round(6), homeward, strict=True)]

    def _margin_and_pace(self, state: State) -> tuple[Array, Array]:
        """Return the width (N,) m added to the person, and the share (N,) of full speed; 0 and 1 without a person."""
        margin, there = torch.zeros_like(state.level), present(state.humans_pos)
        if self._comfort.source != "none" and self._comfort.alpha:
            margin = MARGIN_M * (1 - ease(state.level, self._comfort))
        pace = comfortable_pace(state.level, self._comfort).clamp(min=SLOWEST)
        return torch.where(there, margin, 0.0).numpy(), torch.where(there, pace, 1.0).numpy()

    def _people(self, state: State, margin: Array, pace: Array) -> Array:
        """Return the people (N, 5) as `_weigh` takes them: x, y, yaw, and the margin and pace (N,) of the level."""
        return np.column_stack([*nearest_person(state), margin, pace])

    def _price(self, state: State) -> Array:
        """Return the price (N,) of a certain collision in control steps."""
        return np.asarray(RISK_STEPS + (LAST_RISK_STEPS - RISK_STEPS) * state.steps.numpy() / self._limit)

    def _wait(self, person: Array) -> float:
        """Return the price of waiting beside `person` (D,) in control steps."""
        return WAIT_STEPS

    def _deliberate(self, joints: Array, person: Array, goal: Goal, price: float) -> Array:
        """Return the end (6,) of the first leg: a posture of the goal, or one on the way or to wait in."""
        postures = self._postures(goal, more=True)
        steps, risk = self._weigh(joints, postures, person)
        direct = steps + price * risk
        blocked = not self._cell.free(joints, postures[direct.argmin()])
        end_risk = self._risk(postures[:, None], np.ones((len(postures), 1)), person)
        safest = np.argsort(steps + price * end_risk)[:CONSIDERED]
        # Upright at some pan; any of shoulder to second wrist at home; raised; or the present posture.
        raised = self._cell.raised(joints) if blocked else joints[None]
        ways = np.concatenate([self._here.upright, np.where(PARTS, self._here.home, joints), raised])
        first_steps, first_risk = self._weigh(joints, ways, person)
        first = first_steps + price * first_risk
        steps_on = self._steps(ways[:, None], postures[safest], person)
        clear = np.tile(first_steps[:, None] > 1.0, (1, len(safest)))  # from here, `direct` is the cost
        there = np.clip(first_steps + FORESIGHT_STEPS / 2, 1.0, FORESIGHT_STEPS)
        exposed = self._risk(ways[:, None], there[:, None], person)
        waiting = self._wait(person) + steps_on.min(axis=1) + price * exposed
        least = first + np.minimum(np.where(clear, steps_on, np.inf).min(axis=1), waiting)

        # Best first: legs after a way count as free and safe, until it is the best and they are weighed.
        targets = np.concatenate([postures, ways])
        queue = [(cost, choice) for choice, cost in enumerate(np.concatenate([direct, least]))]
        heapify(queue)
        unweighed = set(range(len(postures), len(targets)))
        while queue:
            _, choice = heappop(queue)
            if choice in unweighed:
                unweighed.remove(choice)
                way = choice - len(postures)
                if way < len(self._here.upright):
                    clear[way] &= self._clear(goal, safest, way)
                goals = safest[clear[way] & (steps_on[way] < waiting[way])]
                on, risk_on = self._weigh(ways[way], postures[goals], person, first_steps[way])
                onward = self._onward(ways[way], postures[goals], on + price * risk_on, waiting[way])
                heappush(queue, (first[way] + onward, choice))
            elif self._cell.free(joints, targets[choice]):
                return targets[choice]
        return self._cell.escape(joints)

    def _onward(self, way: Array, goals: Array, cost: Array, waiting: float) -> float:
        """Return what it costs to go on from `way` (6,): to the cheapest of `goals` (K, 6) at `cost` (K,), or to wait.

        Legs that are not checked for the cell count as free.
        """
        return float(min(cost.min(initial=np.inf), waiting))

    def _weigh(self, start: Array, end: Array, person: Array, begun: Array | float = 0.0) -> tuple[Array, Array]:
        """Return control steps and collision chance (...,) of straight legs that begin in `begun` steps.

        `person` (..., D) are rows of `_people`.
        """
        steps = self._steps(start, end, person)
        share = np.arange(1, SAMPLES + 1) / SAMPLES
        legs = start[..., None, :] + share[:, None] * (end - start)[..., None, :]
        when = np.clip(np.asarray(begun)[..., None] + share * steps[..., None], 1.0, FORESIGHT_STEPS)
        return steps, self._risk(legs, when, person)

    def _steps(self, start: Array, end: Array, person: Array) -> Array:
        """Return the control steps (...,) of straight legs."""
        return np.asarray(np.abs(end - start).max(axis=-1) / self._step / person[..., 4])

    def _risk(self, postures: Array, when: Array, person: Array) -> Array:
        """Return the greatest chance (...,) that the person meets `postures` (..., S, 6) in `when` (..., S) steps."""
        gap = self._gap(postures, when, person)
        gap = gap - CLEARANCE_M - person[..., 3, None] - self._drift * when
        z = np.maximum(gap, 0.0) / np.maximum(self._sigma * np.sqrt(when), 1e-6)
        # Within 10 % of the chance that Brownian motion has passed z standard deviations by then.
        return np.asarray((np.exp(-0.5 * z**2) / (1.0 + z)).max(axis=-1))

    def _gap(self, postures: Array, when: Array, person: Array) -> Array:
        """Return the least distance (..., S) m of `postures` (..., S, 6) to a person, whose x, y and yaw count.

        The person is a cylinder of the trunk's width between two swinging arms, wherever `when` (..., S) is.
        """
        spheres, person = self._body.spheres(postures), person[..., None, None, :]
        x, y = spheres[..., 0] - person[..., 0], spheres[..., 1] - person[..., 1]
        cos, sin = np.cos(person[..., 2]), np.sin(person[..., 2])
        ahead, aside = np.abs(cos * x + sin * y), np.abs(cos * y - sin * x)
        below = self._shoulder_z - spheres[..., 2]
        swing = np.tan(ARM_SWING_RAD) * np.maximum(below, 0.0)
        arm = np.hypot(np.maximum(ahead - swing, 0.0), aside - SHOULDER_HALF_WIDTH_M) - ARM_RADIUS_M
        arm = np.where(below > -0.1, arm, np.inf)
        trunk = np.hypot(ahead, aside) - TRUNK_RADIUS_M
        return np.asarray((np.minimum(arm, trunk) - self._body.radius).min(axis=-1))

    # ---- postures --------------------------------------------------------------------------------------

    def _seeds(self, home: Array) -> Array:
        """Return random postures (LIBRARY, 6) rad around `home` (6,) rad, pan at home."""
        rng = np.random.default_rng(0)
        bend = np.radians([0.0, 120.0, 120.0, 120.0, 80.0, 0.0])
        return np.clip(home + rng.uniform(-bend, bend, (LIBRARY, len(bend))), *self._range.T)

    def _postures(self, goal: Goal, more: bool = False) -> Array:
        """Return collision-free postures (K, 6) with the tool at `goal`, the NEAREST to home first, or home itself.

        `more` adds others.
        """
        if goal is None:
            return np.tile(self._here.home, (NEAREST, 1))
        if (goal, more) not in self._here.postures:
            self._here.postures[goal, more] = self._solve(goal, more)
        return self._here.postures[goal, more]

    def _solve(self, goal: tuple[float, ...], more: bool) -> Array:
        tool = self._library_tool
        radius, height = np.hypot(tool[:, 0], tool[:, 1]), tool[:, 2]
        near = np.hypot(radius - np.hypot(goal[0], goal[1]), height - goal[2]) < 0.05
        seeds, tool = self._library[near].copy(), tool[near]
        seeds[:, 0] += np.arctan2(goal[1], goal[0]) - np.arctan2(tool[:, 1], tool[:, 0])
        seeds[:, 0] = (seeds[:, 0] + np.pi) % (2 * np.pi) - np.pi
        count = NEAREST + SPREAD if more else NEAREST
        found: list[Array] = list(self._postures(goal)) if more else []
        if not more:
            seeds = seeds[np.argsort(np.abs(seeds - self._here.home).max(axis=-1))]
        for seed in seeds:
            if all(np.abs(seed - other).max() > DISTINCT_RAD for other in found):
                posture = self._cell.reach(seed, np.array(goal), self._tolerance)
                if posture is not None:
                    found.append(posture)
            if len(found) == count:
                break
        if not found:
            raise ConfigError(
                f"no posture found that brings the tool to {np.round(goal, 3).tolist()}: is it within reach?"
            )
        postures = np.array(found)[np.arange(count) % len(found)]
        if more:  # the same with the pan turned fully around, where its range allows
            turned = postures - np.sign(postures) * np.array([2 * np.pi, 0, 0, 0, 0, 0])
            postures = np.concatenate([postures, turned[np.abs(turned[:, 0]) < UPRIGHT_PANS_RAD[-1]]])
        return postures

    def _clear(self, goal: Goal, chosen: NDArray[np.int64], way: int) -> NDArray[np.bool_]:
        """Return (K,) whether the leg from an upright way to each `chosen` (K,) of the goal's postures is free.

        They are those of `_postures(goal, more=True)`.
        """
        known, postures = self._here.passages.setdefault(goal, {}), self._postures(goal, more=True)
        for index in chosen:
            if (way, index) not in known:
                known[way, index] = self._cell.free(self._here.upright[way], postures[index])
        return np.array([known[way, index] for index in chosen])
