"""The expert with a hand that holds: plans of the scripted expert up to an object, then a grasp.

A function of the state. It picks from in front of the object: align, advance, close, lift. It places from above: lower,
open, retreat. An object that has fallen is picked where it lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.policies.expert import NEAREST, SAMPLES, WAIT_STEPS, Expert, Goal
from hrl_comfort.policies.hand.beside import WAITING, Beside, of_rows, people_of
from hrl_comfort.policies.hand.carrying import carried
from hrl_comfort.policies.hand.fitting import (
    FIT_M,
    FIT_RAD,
    HOVER_M,
    SQUARE_M,
    angle_of,
    axes_of,
    level_turns,
    slots,
)
from hrl_comfort.policies.hand.postures import GoalPostures
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.variation.grasps import ABOVE_M, BACK_M, Grasps, approaches, rise_above_m
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]
OPEN, CLOSED = -1.0, 1.0
BALL = ("sphere",)
ROUND = ("sphere", "cylinder", "capsule")
"""Shapes that a hand grasps from any side."""
PICK, PLACE = 0.0, 1.0
"""First number of a goal, in front of an object or above its place; then the kind, and where the tool grasps it."""
ROUND_M, ROUND_RAD = 0.005, 0.05
"""Objects that are nearer to each other than this have the same postures."""
LATERAL_M, AHEAD_M = 0.02, 0.03
"""The hand is in front of an object up to this distance from its line, and farther away than it should by this."""
TILTED_RAD, ROLLED_RAD, YAWED_RAD = 0.7, 0.25, 0.3
"""Largest tilt of a hand that advances, and angle of the line from pad to pad with the horizontal and with a side."""
ALIGNED_M, REACHED_M, CLOSING_M = 0.006, 0.006, 0.015
"""Distance from the line at which the hand advances, from the object at which it closes, and goes on closing."""
LOWER_M, DOWN_M = 0.025, 0.005
"""Distance from above its place at which an object is lowered, and height at which it is let go."""
HIGH = 0.8
"""Part of ABOVE_M from which an object is high enough to be carried."""
RETREAT_M = 0.09
"""Distance from an object up to which an open hand retreats."""
SPEED_M_S, LIFT_SPEED_M_S = 0.30, 0.40
SLOWER, SLOWEST_M = 0.5, 0.004
"""Part of the way left, and shortest way, of a decision in which a hand approaches what it may touch."""
FIRM = 0.95
"""Set-point of the fingers from which a hand that touches an object holds it."""
OPENED, EMPTY = 0.05, 0.98
"""Position up to which fingers are open, and from which they have closed on nothing."""
NEARER = (1.0, 0.75, 0.5)
"""Parts of BACK_M and ABOVE_M that are tried for postures in front of an object and above its place."""
TOUCH_STEPS = 100.0
"""Price of a certain touch in control steps behind the shield, where people step back from an arm that rests."""
STANDING_M_S, STANDING_STEPS, IMPATIENCE = 0.2, 600.0, 0.5
"""Speed below which people stand, price of waiting for them behind the shield, in steps, and its growth in each."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Step:
    """Next move of an arm: to go on by joint increments (J,) rad in a decision, or with a plan if there are none."""

    fingers: float
    move: Array | None = None


class GraspingExpert(Expert):
    """Policy for any rows of any subtask in a cell with a gripper; a function of the state."""

    def __init__(self, scene: Scene, config: EnvConfig, subtask: Subtask) -> None:
        super().__init__(scene, config, subtask)
        self._grasps, self._scene = Grasps(scene), scene
        self._goal_postures, self._beside = GoalPostures(scene, self._grasps), Beside(scene, config)
        self._shielded = config.safety.kind != "none"
        shapes = [each.shape for each in config.cell.objects.values()]
        self._round, self._ball = ([each in kind for each in shapes] for kind in (ROUND, BALL))
        self._slots = slots(config.cell)
        stages = [*subtask.stages, subtask.stages[-1]]
        self._grasping = np.array([stage.grasps for stage in stages])
        self._releasing = np.array([stage.releases for stage in stages])
        self._decision_s = config.task.action_repeat * CONTROL_STEP_S
        self._largest = self._step * config.task.action_repeat

    @torch.no_grad()
    def act(self, state: State) -> Tensor:
        """Return actions (N, 7) in [-1, 1]: joint increments in units of `max_step_deg` a control step, and fingers."""
        rows, joints = state.joint_target.shape
        action = torch.zeros(rows, joints + 1, dtype=torch.float64)
        _, pace = self._margin_and_pace(state)
        planned = []
        for row in range(rows):
            step = self._step_of(state, row)
            action[row, joints] = step.fingers
            if step.move is None:
                planned.append(row)
                continue
            move = step.move * min(1.0, self._largest * pace[row] / max(np.abs(step.move).max(), 1e-9))
            action[row, :joints] = torch.from_numpy(move / self._largest)
        if planned:
            index = torch.tensor(planned)
            move = self._largest * super().act(state.rows(index)).numpy()
            slow = carried(self._body.arm, state.joint_target[index].numpy(), move, self._decision_s)
            carries = action[index, joints:].numpy() == CLOSED
            action[index, :joints] = torch.from_numpy(np.where(carries, slow, move) / self._largest)
        return action

    # ---- steps -----------------------------------------------------------------------------------------

    def _step_of(self, state: State, row: int) -> Step:
        """Return what the arm of a row does next."""
        stage, target = int(state.stage[row]), int(state.target[row])
        obj = state.objects[row, target].numpy()
        holds = bool(state.pads[row, target].all() and state.grip_target[row] > FIRM)
        if self._grasping[stage]:
            return self._lift(state, row) if holds else self._pick(state, row, obj)
        if self._releasing[stage]:
            return self._place(state, row, obj)
        away = float(np.linalg.norm(obj - state.tcp_pos[row].numpy()))
        return self._retreat(state, row) if away < RETREAT_M and not holds else Step(OPEN)

    def _pick(self, state: State, row: int, obj: Array) -> Step:
        """Return the next step towards a grasp of the target at `obj` (3,) m."""
        place, turn = obj + self._rise(state, row), axes_of(state.tcp_quat[row].numpy())
        level, off = self._level(turn, state, row)
        ahead = turn.T @ (place - state.tcp_pos[row].numpy())
        lateral, grip = float(np.hypot(*ahead[:2])), float(state.grip_target[row])
        closing = grip > OPENED and lateral < CLOSING_M and abs(ahead[2]) < CLOSING_M
        if closing or np.linalg.norm(ahead) < REACHED_M:
            return Step(OPEN if self._opens(state, row) else CLOSED, np.zeros(len(self._range)))
        in_front = lateral < LATERAL_M and -CLOSING_M < ahead[2] < BACK_M + AHEAD_M
        if not (in_front and turn[2, 2] < -np.cos(TILTED_RAD) and off):
            return Step(OPEN)
        left = ahead[2] - self._advance(ahead[2]) if lateral < ALIGNED_M else ahead[2]
        return Step(OPEN, self._move(state, row, place - max(left, 0.0) * level[:, 2], level))

    def _rise(self, state: State, row: int) -> Array:
        """Return the way (3,) m from the target to the tool that grasps it."""
        return UP * rise_above_m(self._scene, float(state.kind_sizes[row, int(state.target_kind[row]), 2]))

    def _opens(self, state: State, row: int) -> bool:
        """Return whether a hand has closed on nothing, or is opening after that: fingers follow their set-point."""
        grip = float(state.grip[row])
        return grip > EMPTY or grip > max(OPENED, float(state.grip_target[row]))

    def _advance(self, left: float) -> float:
        """Return the way, m, of the next decision of a hand that has `left` m to go, so that it arrives slowly."""
        return float(np.clip(SLOWER * left, SLOWEST_M, SPEED_M_S * self._decision_s))

    def _level(self, turn: Array, state: State, row: int) -> tuple[Array, bool]:
        """Return the axes (3, 3) nearest to those of the tool whose pads meet sides, and whether it is near to them."""
        across = turn[:, 0] * [1.0, 1.0, 0.0]
        across /= max(float(np.linalg.norm(across)), 1e-6)
        rolled, yawed = abs(float(np.arcsin(np.clip(turn[2, 0], -1, 1)))), 0.0
        side = self._side(state, row)
        if side is not None:
            yaw, between = side
            bearing = float(np.arctan2(across[1], across[0])) - yaw
            yawed = bearing - between * round(bearing / between)
            bearing += yaw - yawed
            across = np.array([np.cos(bearing), np.sin(bearing), 0.0])
        down = turn[:, 2] - (turn[:, 2] @ across) * across
        down /= max(float(np.linalg.norm(down)), 1e-6)
        level = np.stack([across, np.cross(down, across), down], axis=1)
        return level, rolled < ROLLED_RAD and abs(yawed) < YAWED_RAD

    def _side(self, state: State, row: int) -> tuple[float, float] | None:
        """Return the bearing, rad, of a side of the target that pads take, and to the next one; None if it is round.

        It is the narrow side, of a square any.
        """
        target = int(state.target[row])
        if self._round[int(state.kinds[row, target])]:
            return None
        axes = axes_of(state.objects_quat[row, target].numpy())
        level = np.abs(axes[2]).argsort()[:2]
        half = state.kind_sizes[row, int(state.kinds[row, target])].numpy()[level]
        square = np.ptp(half) < SQUARE_M
        side = axes[:, level[0 if square else half.argmin()]]
        return float(np.arctan2(side[1], side[0])), np.pi / 2 if square else np.pi

    def _lift(self, state: State, row: int) -> Step:
        at, turn = self._grasps.pose(state.joint_target[row].numpy())
        rise = np.array([0.0, 0.0, LIFT_SPEED_M_S * self._decision_s])
        return Step(CLOSED, self._move(state, row, at + rise, turn))

    def _place(self, state: State, row: int, obj: Array) -> Step:
        """Return the next step that brings the target at `obj` (3,) m to its place."""
        target = int(state.target[row])
        way, touched = state.target_place[row].numpy() - obj, bool(state.pads[row, target].any())
        over = float(np.hypot(*way[:2])) < LOWER_M
        if not touched or state.grip_target[row] < FIRM:
            near = np.linalg.norm(way) < float(state.place_tolerance[row])
            if near and (touched or state.free_steps[row, target] < 5):
                return Step(OPEN, np.zeros(len(self._range)))
            if near:
                away = float(np.linalg.norm(obj - state.tcp_pos[row].numpy()))
                return self._retreat(state, row) if away < BACK_M else Step(OPEN, np.zeros(len(self._range)))
            return self._pick(state, row, obj)
        if over:
            if -way[2] < DOWN_M:
                return Step(OPEN, np.zeros(len(self._range)))
            return self._lower(state, row, obj, way)
        low = float(obj[2] - state.ground[row, target]) < HIGH * ABOVE_M and -way[2] < HIGH * ABOVE_M
        return self._lift(state, row) if low else Step(CLOSED)

    def _lower(self, state: State, row: int, obj: Array, way: Array) -> Step:
        """Return the next step that lowers the target at `obj` (3,) m, `way` (3,) m from its place."""
        _, turn = self._grasps.pose(state.joint_target[row].numpy())
        fit, down = np.eye(3), self._advance(-way[2])
        if (slot := self._slots[int(state.target_kind[row])]) is not None:
            yaw = slot.yaw(state.layout[row].numpy())
            fit = slot.fit(axes_of(state.objects_quat[row, int(state.target[row])].numpy()), yaw)
            if np.hypot(*way[:2]) > FIT_M or angle_of(fit) > FIT_RAD:
                down = min(down, -way[2] - HOVER_M)
        way[2] = -down
        place = obj + way + fit @ (state.tcp_pos[row].numpy() - obj)
        return Step(CLOSED, self._move(state, row, place, fit @ turn))

    def _retreat(self, state: State, row: int) -> Step:
        """Return the next step of an open hand straight up: its pads stay beside what lies between them."""
        at, turn = self._grasps.pose(state.joint_target[row].numpy())
        return Step(OPEN, self._move(state, row, at + SPEED_M_S * self._decision_s * UP, turn))

    def _move(self, state: State, row: int, place: Array, turn: Array) -> Array:
        """Return joint increments (J,) rad that bring the tool to `place` (3,) m with axes `turn` (3, 3)."""
        joints = state.joint_target[row].numpy()
        return self._grasps.towards(joints, place, turn, 3) - joints

    # ---- plans -----------------------------------------------------------------------------------------

    def _goals_of(self, state: State) -> list[Goal]:
        """Return the goal of each row: in front of the target, above its place, or home (None)."""
        goals: list[Goal] = []
        for row, stage in enumerate(state.stage.tolist()):
            target = int(state.target[row])
            kind, obj, rise = int(state.target_kind[row]), state.objects[row, target].numpy(), self._rise(state, row)
            held = self._releasing[stage] and bool(state.pads[row, target].any())
            if held:
                up, side = _rounded(self._upright(state, row), 0.1), self._fitted_side(state, row)
                goals.append((PLACE, kind, *(_rounded(state.target_place[row].numpy(), ROUND_M) + rise), *up, *side))
            elif self._grasping[stage] or self._releasing[stage]:
                goals.append((PICK, kind, *(_rounded(obj, ROUND_M) + rise), *self._rounded_side(state, row)))
            else:
                goals.append(None)
        return goals

    def _rounded_side(self, state: State, row: int) -> tuple[float, ...]:
        """Return the bearing, to ROUND_RAD, of a side of the target, and to the next one; empty if it is round."""
        if (side := self._side(state, row)) is None:
            return ()
        return float(_rounded(np.array([side[0] % side[1]]), ROUND_RAD)[0]), side[1]

    def _upright(self, state: State, row: int) -> Array:
        """Return the axis (3,) of the held target, in the tool's frame, that is to be vertical when it is put down.

        It is the one that points most towards the flange, since hands grasp from above; of a ball the tool's.
        """
        target = int(state.target[row])
        if self._ball[int(state.kinds[row, target])]:
            return -UP  # of a tool that points down
        axes = axes_of(state.tcp_quat[row].numpy()).T @ axes_of(state.objects_quat[row, target].numpy())
        index = int(np.abs(axes[2]).argmax())
        return np.asarray(-axes[:, index] * np.sign(axes[2, index]))

    def _fitted_side(self, state: State, row: int) -> tuple[float, ...]:
        """Return a side (3,) beside `_upright`, to ROUND_RAD, of a target for a slot; empty where any side fits."""
        target, slot = int(state.target[row]), self._slots[int(state.target_kind[row])]
        if slot is None or slot.between is None:
            return ()
        axes = axes_of(state.tcp_quat[row].numpy()).T @ axes_of(state.objects_quat[row, target].numpy())
        side = axes[:, 0 if np.abs(axes[2]).argmax() != 0 else 1]
        return tuple(_rounded(side, ROUND_RAD))

    def _solve(self, goal: tuple[float, ...], more: bool) -> Array:
        """Return postures (NEAREST, 6) in front of an object, or above its place with the object level in the hand."""
        if more:
            return self._postures(goal)
        slot, place = self._slots[int(goal[1])], np.array(goal[2:5])
        self._grasps.stand(self._layout)
        home, found = self._here.home, np.empty((0, len(self._range)))
        for part in NEARER:  # at the edge of the arm's reach, the way to the object is shorter
            if goal[0] == PICK:
                turns = list(approaches(place, *goal[5:]))
                found = self._goal_postures.found(place, turns, home, NEAREST, back_m=part * BACK_M)
            else:
                turns = level_turns(place, np.array(goal[5:]), slot, slot.yaw(self._layout) if slot else 0.0)
                found = self._goal_postures.found(place, turns, home, NEAREST, up_m=part * ABOVE_M)
            if len(found):
                return found[np.arange(NEAREST) % len(found)]
        return np.tile(home, (NEAREST, 1))  # out of reach: nothing can be done, until time is up

    # ---- people ----------------------------------------------------------------------------------------

    def _people(self, state: State, margin: Array, pace: Array) -> Array:
        """Return people as `Expert._people`, the price of waiting, and capsules, which count in the place of axes."""
        standing = (state.humans_vel.norm(dim=-1) < STANDING_M_S).all(dim=-1).numpy()
        wait = np.full(len(standing), WAIT_STEPS)
        if self._shielded:
            wait = np.where(standing, STANDING_STEPS, WAIT_STEPS) + IMPATIENCE * state.steps.numpy()
        return np.column_stack([super()._people(state, margin, pace), wait, people_of(state)])

    def _wait(self, person: Array) -> float:
        return float(person[WAITING])

    def _price(self, state: State) -> Array:
        return np.full(len(state.steps), TOUCH_STEPS) if self._shielded else super()._price(state)

    def _weigh(self, start: Array, end: Array, person: Array, begun: Array | float = 0.0) -> tuple[Array, Array]:
        """See `Expert._weigh`; legs take longer where the shield slows the arm."""
        steps, risk = super()._weigh(start, end, person, begun)
        if not self._shielded:
            return steps, risk
        share = np.arange(1, SAMPLES + 1)[:, None] / SAMPLES
        way = (end - start)[..., None, :]
        legs = start[..., None, :] + share * way
        velocity = np.broadcast_to(way / np.maximum(steps, 1.0)[..., None, None] / CONTROL_STEP_S, legs.shape)
        when = np.asarray(begun)[..., None] + share[:, 0] * steps[..., None]
        part = of_rows(self._beside.passed, person, legs, when, velocity)
        return steps * (1 / part).mean(axis=-1), risk

    def _onward(self, way: Array, goals: Array, cost: Array, waiting: float) -> float:
        """See `Expert._onward`; every leg is checked, or the arm would go to and fro between ways that lead nowhere."""
        order = [index for index in np.argsort(cost) if cost[index] < waiting]
        free = (float(cost[index]) for index in order if self._cell.free(way, goals[index]))
        return next(free, waiting)

    def _gap(self, postures: Array, when: Array, person: Array) -> Array:
        """Return the least distance (..., S) m of `postures` (..., S, 6) to the capsules of people then."""
        return of_rows(lambda *given: self._beside.gaps(*given)[1].min(axis=0), person, postures, when)


def _rounded(values: Array, unit: float) -> Array:
    return np.asarray((np.round(values / unit) * unit).round(6))
