"""A scripted expert: goal postures by mink, straight joint-space paths, and a forecast of the person's walk.

At every decision and for every row it weighs plans: straight to one of the goal's postures, to one by way of
an upright posture, or to wait upright. A plan costs its control steps plus a price on the chance that the
person, who wanders like a Brownian particle, gets to where the arm will be. The first leg of the cheapest plan
that meets neither the cell nor the arm itself is followed for one decision; nothing is remembered but postures.
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.scene.human import (
    ARM_RADIUS_M,
    LIMBS,
    SHOULDER_HALF_WIDTH_M,
    SHOULDER_M,
    TRUNK_RADIUS_M,
)
from hrl_comfort.scene.robots import LINKS, ROBOTS
from hrl_comfort.scene.workcell import AWAY_M, CONTROL_STEP_S, Scene
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.subtask import by_stage

Array = NDArray[np.float64]

POSTURES = 16
"""Postures kept for a goal."""
LIBRARY = 20_000
"""Random postures that seed inverse kinematics."""
DISTINCT_RAD = np.radians(25.0)
"""Two postures of a goal differ by this in some joint."""
UPRIGHT_PANS_RAD = np.radians(np.arange(-180.0, 181.0, 45.0))
SAMPLES = 8
"""Instants at which a leg of a plan is checked."""
SPACING_M = 0.06
"""Between the spheres that stand for a capsule of the arm."""
CLEARANCE_M = 0.01
"""The arm keeps this from the cell, the person and itself."""
ARM_SWING_RAD = np.radians(15.0)
"""How far the arms of a person of random_walk swing."""
RISK_STEPS = 1500.0
"""Control steps that a certain collision is worth."""
WAIT_STEPS = 40.0
"""Control steps that waiting is reckoned to cost."""
NEGLIGIBLE = 2e-3
"""A straight plan with less risk is not compared with detours."""


class Expert:
    """Acts for any rows of any subtask; a function of the state."""

    def __init__(self, scene: Scene, config: EnvConfig, subtask: Subtask) -> None:
        if config.task.action != "joint":
            raise ConfigError(f"task.action={config.task.action!r} is not allowed with policy=expert; choose joint")
        self._goal = by_stage(subtask.stages, lambda stage: stage.goal)
        self._homeward = torch.tensor([stage.name == "return" for stage in subtask.stages])
        self._step = np.radians(config.task.max_step_deg)
        self._decision = self._step * config.task.steps_per_decision
        human, precision = config.human, config.task.precision
        self._sigma = human.jitter_m / np.sqrt(3.0)
        self._drift = human.speed_m_s * CONTROL_STEP_S if human.motion == "approach" else 0.0
        self._tolerance = 0.6 * min(precision.take_m, precision.leave_m)
        self._home, self._range = scene.home, scene.joint_range
        self._shoulder_z = scene.floor_z + SHOULDER_M
        self._upright = np.tile(scene.home, (len(UPRIGHT_PANS_RAD), 1))
        self._upright[:, 0] = UPRIGHT_PANS_RAD
        self._cell = Cell(scene)
        self._body = Body(scene, config.robot.name)
        self._library = self._seeds()
        self._known: dict[tuple[float, ...], tuple[Array, NDArray[np.bool_]]] = {}

    @torch.no_grad()
    def act(self, state: State) -> Tensor:
        """Return actions (N, 6) in [-1, 1]: joint increments in units of `max_step_deg` a control step."""
        joints = state.joint_target.numpy()
        index = state.stage.clamp(0, len(self._homeward) - 1)
        homeward = self._homeward[index].numpy()
        goals = self._goal(state.with_(stage=index)).numpy()
        known = [self._known_goal(None if home else goal) for goal, home in zip(goals, homeward, strict=True)]
        people = np.concatenate([state.human_pos.numpy(), state.human_yaw.numpy()[:, None]], axis=-1)

        postures = np.stack([item[0] for item in known])
        steps, risk = self._weigh(joints[:, None], postures, people[:, None], np.zeros(1))
        cost = steps + RISK_STEPS * risk
        target = np.empty_like(joints)
        for row in range(len(joints)):
            order = np.argsort(cost[row])
            ways, costs = postures[row], cost[row]
            if risk[row, order[0]] > NEGLIGIBLE or not self._cell.free(joints[row], ways[order[0]]):
                detours, extra = self._detours(joints[row], *known[row], people[row])
                ways, costs = np.concatenate([ways, detours]), np.concatenate([costs, extra])
                order = np.argsort(costs)
            target[row] = next((ways[i] for i in order if self._cell.free(joints[row], ways[i])), joints[row])
        move = target - joints
        largest = np.abs(move).max(axis=-1, keepdims=True)
        return torch.from_numpy(move / np.maximum(largest, self._decision))

    def _detours(self, joints: Array, postures: Array, free: NDArray[np.bool_], person: Array) -> tuple[Array, Array]:
        """Return where else to go (V + 1, 6) and its cost: an upright posture, or nowhere."""
        ways = np.concatenate([self._upright, joints[None]])
        steps, risk = self._weigh(joints, ways, person, np.zeros(1), hold=WAIT_STEPS / 2)
        waiting = steps + WAIT_STEPS + RISK_STEPS * risk
        first_steps, first_risk = self._weigh(joints, self._upright, person, np.zeros(1))
        more, later = self._weigh(self._upright[:, None], postures, person, first_steps[:, None])
        onward = np.where(free, more + RISK_STEPS * later, np.inf).min(axis=1)
        passing = first_steps + RISK_STEPS * first_risk + onward
        waiting[:-1] = np.minimum(waiting[:-1], passing)
        return ways, waiting

    def _weigh(
        self, start: Array, end: Array, person: Array, begun: Array, hold: float = 0.0
    ) -> tuple[Array, Array]:
        """Return control steps and chance of a collision (...,) of straight legs that begin `begun` steps from now."""
        steps = np.abs(end - start).max(axis=-1) / self._step
        share = np.arange(1, SAMPLES + 1) / SAMPLES
        legs = start[..., None, :] + share[:, None] * (end - start)[..., None, :]
        when = begun[..., None] + share * steps[..., None]
        when[..., -1] += hold
        gap = self._gap(self._body.spheres(legs), person[..., None, None, :]) - CLEARANCE_M - self._drift * when
        deviation = self._sigma * np.sqrt(np.maximum(when, 1.0))
        return steps, np.exp(-0.5 * (np.maximum(gap, 0.0) / deviation) ** 2).max(axis=-1)

    def _gap(self, spheres: Array, person: Array) -> Array:
        """Return the least distance (...,) m of spheres (..., P, 3) to a person (..., 1, 3) of x, y, yaw.

        The person is a pillar of the trunk's width, between arms that may swing to and fro.
        """
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

    def _seeds(self) -> Array:
        """Return random postures (LIBRARY, 6) rad round an upright home, pan at home."""
        rng = np.random.default_rng(0)
        bend = np.radians([0.0, 120.0, 120.0, 120.0, 80.0, 0.0])
        return np.clip(self._home + rng.uniform(-bend, bend, (LIBRARY, 6)), *self._range.T)

    def _known_goal(self, goal: Array | None) -> tuple[Array, NDArray[np.bool_]]:
        """Return postures (K, 6) that reach `goal` (home if None), and which uprights (V, K) lead straight to each."""
        key = () if goal is None else tuple(np.round(goal, 6))
        if key not in self._known:
            postures = np.tile(self._home, (POSTURES, 1)) if goal is None else self._postures(goal)
            free = np.array([[self._cell.free(way, end) for end in postures] for way in self._upright])
            self._known[key] = postures, free
        return self._known[key]

    def _postures(self, goal: Array) -> Array:
        """Return postures (K, 6), free of contact, that bring the tool to `goal`, the nearest to home first."""
        tool = self._body.tool(self._library)
        radius, height = np.hypot(tool[:, 0], tool[:, 1]), tool[:, 2]
        near = np.hypot(radius - np.hypot(goal[0], goal[1]), height - goal[2]) < 0.05
        seeds, tool = self._library[near].copy(), tool[near]
        turn = np.arctan2(goal[1], goal[0]) - np.arctan2(tool[:, 1], tool[:, 0])
        seeds[:, 0] += turn
        seeds[:, 0] = (seeds[:, 0] + np.pi) % (2 * np.pi) - np.pi
        found: list[Array] = []
        for seed in seeds[np.argsort(np.abs(seeds - self._home).max(axis=-1))]:
            if all(np.abs(seed - other).max() > DISTINCT_RAD for other in found):
                posture = self._cell.reach(seed, goal, self._tolerance)
                if posture is not None:
                    found.append(posture)
            if len(found) == POSTURES:
                break
        if not found:
            raise RuntimeError(f"no posture found that brings the tool to {goal.round(3).tolist()}: is it within reach?")
        return np.array(found)[np.arange(POSTURES) % len(found)]


class Body:
    """The arm as spheres, by batched DH kinematics."""

    def __init__(self, scene: Scene, robot: str) -> None:
        self._robot = ROBOTS[robot]
        model, data = scene.model, mujoco.MjData(scene.model)
        mujoco.mj_kinematics(model, data)
        links = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"robot/{link}") for link in LINKS]
        places, radii, self._link = [], [], []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            while body not in links and body != 0:
                body = int(model.body_parentid[body])
            if body == 0:
                continue  # the pedestal side of the arm, and everything that is not the arm
            size, half = model.geom_size[geom][:2]
            along = np.linspace(-half, half, max(2, int(np.ceil(2 * half / SPACING_M)) + 1))
            world = data.geom_xpos[geom] + along[:, None] * data.geom_xmat[geom].reshape(3, 3)[:, 2]
            places.append((world - data.xpos[body]) @ data.xmat[body].reshape(3, 3))
            radii.append(np.full(len(along), size))
            self._link.append(links.index(body))
        self._places, self.radius = places, np.concatenate(radii)
        tcp = data.site("robot/tcp").xpos
        self._tcp = (tcp - data.xpos[links[-1]]) @ data.xmat[links[-1]].reshape(3, 3)

    def _frames(self, joints: Array) -> list[tuple[Array, Array]]:
        """Return rotation (..., 3, 3) and origin (..., 3) of each link's DH frame."""
        robot = self._robot
        turn, origin = np.broadcast_to(np.eye(3), (*joints.shape[:-1], 3, 3)), np.zeros((*joints.shape[:-1], 3))
        frames = []
        for i in range(6):
            cos, sin = np.cos(joints[..., i, None]), np.sin(joints[..., i, None])
            ca, sa = np.cos(robot.alpha_rad[i]), np.sin(robot.alpha_rad[i])
            x, y, z = turn[..., 0], turn[..., 1], turn[..., 2]
            along, across = cos * x + sin * y, cos * y - sin * x
            turn = np.stack([along, ca * across + sa * z, ca * z - sa * across], axis=-1)
            origin = origin + robot.d_m[i] * z + robot.a_m[i] * along
            frames.append((turn, origin))
        return frames

    def spheres(self, joints: Array) -> Array:
        """Return the spheres' centres (..., P, 3) m."""
        frames = self._frames(joints)
        parts = []
        for link, places in zip(self._link, self._places, strict=True):
            turn, origin = frames[link]
            parts.append(origin[..., None, :] + places @ np.swapaxes(turn, -1, -2))
        return np.concatenate(parts, axis=-2)

    def tool(self, joints: Array) -> Array:
        """Return the tool centre point (..., 3) m."""
        turn, origin = self._frames(joints)[-1]
        return origin + turn @ self._tcp


class Cell:
    """Inverse kinematics and contact checks in the cell without a person."""

    def __init__(self, scene: Scene) -> None:
        self._model = mujoco.MjModel.from_xml_string(scene.xml, dict(scene.assets))
        self._model.geom_margin[:] = CLEARANCE_M
        self._configuration = mink.Configuration(self._model)
        self._tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-4)
        self._limits = [mink.ConfigurationLimit(self._model)]
        self._data = self._configuration.data
        self._data.mocap_pos[: len(LIMBS), 0] = AWAY_M

    def _depth(self, joints: Array) -> float:
        """Return the distance (m) of the closest contact, CLEARANCE_M if there is none nearer."""
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return float(min(self._data.contact.dist.min(initial=CLEARANCE_M), CLEARANCE_M))

    def free(self, start: Array, end: Array) -> bool:
        """Return whether the straight way keeps its clearance, or no less than it has at the start."""
        least = min(self._depth(start) - 1e-3, CLEARANCE_M - 1e-3)
        shares = np.arange(1, SAMPLES + 1) / SAMPLES
        return all(self._depth(start + share * (end - start)) >= least for share in shares)

    def reach(self, seed: Array, goal: Array, tolerance: float) -> Array | None:
        """Return a posture near `seed` whose tool is within `tolerance` of `goal` and touches nothing, if found."""
        self._configuration.update(seed)
        self._tool.set_target(mink.SE3.from_translation(goal))
        for _ in range(20):
            if np.linalg.norm(self._data.site("robot/tcp").xpos - goal) < tolerance:
                posture = self._configuration.q.copy()
                return posture if self._depth(posture) >= CLEARANCE_M - 1e-3 else None
            velocity = mink.solve_ik(self._configuration, [self._tool], 0.5, "daqp", damping=1e-4, limits=self._limits)
            self._configuration.integrate_inplace(velocity, 0.5)
        return None
