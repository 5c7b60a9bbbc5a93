"""A non-learning baseline: an artificial potential field that depends on the comfort level, followed by mink.

The goal of the stage attracts the tool, and the axis of the person nearest to it repels it within a radius that the
level sets (Khatib, Int. J. Robotics Research 5(1), 1986, 10.1177/027836498600500106). Three departures from the
textbook avoid local minima: repulsion fades towards the goal, which may lie beside a person (Ge and Cui, IEEE Trans.
Robotics and Automation 16(5), 2000, 10.1109/70.880813); attraction towards the person is deflected around
them; and the path leads around the robot's base, retracted and raised, on the side with less repulsion. A
quadratic program turns tool velocity into joint velocity and keeps the links off person, cell and each other.
Where the comfort model weighs speed (`comfort.beta`), joints move no faster than is comfortable. The policy
has no memory.
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.comfort.terms import SMALLEST_M, threshold_levels
from hrl_comfort.config import CONTROL_STEP_S, EnvConfig
from hrl_comfort.policies.scripted import StageGoals, comfortable_pace, nearest_person, standing_limbs
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State, Subtask

Array = NDArray[np.float64]

SPEED_M = 0.04
"""Largest displacement of the tool towards the goal per control step; the joints seldom reach it."""
SLOWING = 0.3
"""Largest share of the remaining way in one control step, so that the tool settles at the goal."""
PUSH = 2.0
"""Repulsion over attraction where the tool is at the person's axis and far from the goal."""
FADE_M = 0.25
"""Distance from the goal at which repulsion starts to fade. A larger one keeps the tool off a goal beside a person."""
SIDE_WEIGHT = 4.0
"""Extra cost of a turn around the base through the repulsive field, at the person's axis."""
CRUISE_M, CRUISE_HEIGHT_M = 0.26, 0.50
"""Distance from the base's axis, and height, of the tool on its way around the base."""
BLOCKED_M = 0.34
"""A way around the base is blocked where it passes so near the person's axis."""
DESCENT, ABOVE_M = 0.4, 0.05
"""Slope, rise over run, of the descent to the goal (flatter, the fingers touch the table's edge), and the distance
from the goal's vertical at which the slope ends."""
TURNING_RAD = np.radians(20.0), np.radians(70.0)
"""Between these remaining angles the target blends from the goal to the way around the base."""
PERSON_M, PERSON_SEEN_M = 0.08, 0.40
"""Smallest distance of the links to the person, whose arms swing, and the distance below which it is enforced."""
CELL_M, CELL_SEEN_M = 0.03, 0.12
"""Likewise to tables, pedestal and the arm itself."""
APPROACH = 0.3
"""Share of the room above the smallest distance that links may close in one control step."""


class PotentialField:
    """Policy for any rows of any subtask; a function of the state."""

    def __init__(self, scene: Scene, config: EnvConfig, subtask: Subtask) -> None:
        self._goals = StageGoals("potential_field", config, subtask)
        self._comfort, self._floor_z = config.comfort, scene.floor_z
        self._step = np.radians(config.task.max_step_deg)
        self._solves = config.task.action_repeat
        self._range, self._furniture = scene.joint_range, slice(scene.first_furniture, scene.first_prop)
        model = mujoco.MjModel.from_xml_string(scene.xml, dict(scene.assets))
        self._configuration = mink.Configuration(model)
        self._tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.0)
        self._posture = mink.PostureTask(model, cost=np.append(0.0, np.ones(len(scene.joints) - 1)) * 3e-3)
        self._homing = mink.PostureTask(model, cost=1.0)
        speed = self._step / CONTROL_STEP_S
        names = [model.geom(index).name for index in range(model.ngeom)]
        owners = {name: model.body(model.geom(name).bodyid[0]).name for name in names}
        arm = [name for name in names if name.startswith("robot/") and owners[name] != "robot/base"]
        person = [name for name in names if owners[name] in scene.limbs]
        cell = [name for name in names if owners[name] in ("robot/base", *scene.still)]
        self._limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, dict.fromkeys(scene.joints, speed)),
            mink.CollisionAvoidanceLimit(model, [(arm, person)], APPROACH, PERSON_M, PERSON_SEEN_M),
            mink.CollisionAvoidanceLimit(model, [(arm, cell), (arm, arm)], APPROACH, CELL_M, CELL_SEEN_M),
        ]

    @torch.no_grad()
    def act(self, state: State) -> Tensor:
        """Return actions (N, J) in [-1, 1]: joint increments in units of `max_step_deg` a control step."""
        goals, homeward = self._goals(state)
        level = state.level.nan_to_num(nan=(1 + self._comfort.levels) / 2)
        radius = threshold_levels(level, self._comfort).clamp(min=SMALLEST_M).numpy()
        pace = comfortable_pace(level, self._comfort).numpy()
        (people, _), limbs = nearest_person(state), standing_limbs(state, self._floor_z)
        before, data = state.joint_target.numpy(), self._configuration.data
        joints, layout, home = before.copy(), state.layout.numpy(), state.joint_home.numpy()
        for row in range(len(joints)):
            data.mocap_pos[self._furniture], data.mocap_quat[self._furniture] = layout[row, :, :3], layout[row, :, 3:]
            self._posture.set_target(home[row])
            data.mocap_pos[: limbs.shape[1]], data.mocap_quat[: limbs.shape[1]] = limbs[row, :, :3], limbs[row, :, 3:]
            for _ in range(self._solves):
                ahead = self._follow(
                    joints[row], goals[row], people[row], radius[row], home[row] if homeward[row] else None
                )
                joints[row] += pace[row] * (ahead - joints[row])
        return torch.from_numpy(np.clip((joints - before) / (self._solves * self._step), -1.0, 1.0))

    def _follow(self, joints: Array, goal: Array, person: Array, radius: float, home: Array | None) -> Array:
        """Return the joints (J,) rad after one control step, towards `home` (J,) rad or else the `goal` (3,) m."""
        self._configuration.update(joints)
        tool = self._configuration.data.site("robot/tcp").xpos.copy()
        tasks: list[mink.Task]
        if home is not None:
            move = home - joints
            self._homing.set_target(joints + move * min(1.0, self._step / max(np.abs(move).max(), 1e-9)))
            tasks = [self._homing]
        else:
            move = self.displacement(tool, goal, person, radius, joints[0])
            self._tool.set_target(mink.SE3.from_translation(tool + move))
            tasks = [self._tool, self._posture]
        try:
            velocity = mink.solve_ik(
                self._configuration, tasks, CONTROL_STEP_S, "daqp", damping=1e-4, limits=self._limits
            )
        except mink.NoSolutionFound:
            return joints  # the limits leave no motion
        return joints + velocity * CONTROL_STEP_S

    def displacement(self, tool: Array, goal: Array, person: Array, radius: float, pan: float) -> Array:
        """Return the displacement (3,) m of the tool in a control step.

        Cell frame: tool and goal (3,) m, person (2,) m; `radius` m of the repulsion; `pan` rad of the first joint.
        """
        left = float(np.linalg.norm(goal - tool))
        pull = self._pull(tool, goal, person, radius, pan)
        away = np.append(tool[:2] - person, 0.0)
        distance = float(np.linalg.norm(away))
        away /= max(distance, 1e-6)
        strength = max(0.0, 1.0 - distance / radius) * min(1.0, left / FADE_M)
        towards = min(0.0, float(pull @ away))
        if towards < 0.0:
            speed = np.linalg.norm(pull)
            turned = pull - strength * towards * away
            pull = turned * speed / max(float(np.linalg.norm(turned)), 1e-6)
        return pull + PUSH * SPEED_M * strength * away

    def _pull(self, tool: Array, goal: Array, person: Array, radius: float, pan: float) -> Array:
        """Return the attraction (3,) m a control step towards the goal, around the base."""
        angle, turn = np.arctan2(tool[1], tool[0]), self._turn(tool, goal, person, radius, pan)
        low, high = TURNING_RAD
        travelling = np.clip((abs(turn) - low) / (high - low), 0.0, 1.0)
        out, end = np.hypot(tool[0], tool[1]), np.hypot(goal[0], goal[1])
        height = goal[2] + DESCENT * max(0.0, float(np.hypot(*(goal - tool)[:2])) - ABOVE_M)
        wished = np.array([end, height]) * (1 - travelling) + travelling * np.array(
            [CRUISE_M, max(CRUISE_HEIGHT_M, goal[2])]
        )
        drawn = SLOWING * (wished - [out, tool[2]])
        around = SLOWING * turn * max(out, 0.1)
        along = np.array([np.cos(angle), np.sin(angle)])
        pull = np.append(drawn[0] * along + around * np.array([-along[1], along[0]]), drawn[1])
        return pull * min(1.0, SPEED_M / max(float(np.linalg.norm(pull)), 1e-9))

    def _turn(self, tool: Array, goal: Array, person: Array, radius: float, pan: float) -> float:
        """Return the angle (rad, left positive) about the base's axis to the goal, by the cheaper way around."""
        angle = np.arctan2(tool[1], tool[0])
        short = (np.arctan2(goal[1], goal[0]) - angle + np.pi) % (2 * np.pi) - np.pi
        ways = np.array([short, short - np.sign(short) * 2 * np.pi])
        passed = angle + ways[:, None] * np.linspace(0.0, 1.0, 13)
        reach = max(CRUISE_M, np.hypot(tool[0], tool[1]))
        gap = np.hypot(reach * np.cos(passed) - person[0], reach * np.sin(passed) - person[1])
        cost = np.abs(ways) * (1.0 + SIDE_WEIGHT * np.maximum(0.0, 1.0 - gap / radius).mean(axis=-1))
        end = pan + ways
        cost += 2 * np.pi * (gap.min(axis=-1) < BLOCKED_M)
        cost[(end < self._range[0, 0]) | (end > self._range[0, 1])] = np.inf
        return float(ways[cost.argmin()])
