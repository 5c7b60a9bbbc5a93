"""Starts of subtasks: at home, or with the tool at the object or where the object belongs.

A start of an arm of J joints is 3 J numbers: joint angles, rad, velocities, rad/s, and servo targets, rad. Starts
by inverse kinematics are at rest; recorded ones keep the motion of the arm that a chained policy takes over. These may
have three numbers more, on which the terminal states of a policy depend: the human's x, y (m) and the level,
NaN without one.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from zipfile import ZipFile

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.files.archives import DAMAGED, check_archive
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import Start

Array = NDArray[np.float64]

PARTS, WITH_HUMAN = 3, 3
"""Numbers of a start: for each joint, and for the human and the level."""
MOST_BYTES = 10**8
"""Largest size of the arrays of a file, unpacked."""
MOST = 100.0
"""Largest angle, rad, velocity, rad/s, and coordinate, m, of a valid start."""
COUNT = 96
"""Number of inverse-kinematics starts for each goal."""
ITERATIONS, STEP_S = 40, 0.1
CLEARANCE_M = 0.02
"""Smallest distance between arm and tables in an inverse-kinematics start."""
SPREAD_RAD = np.radians([15.0, 25.0, 30.0, 35.0, 30.0, 40.0])
"""Standard deviation of the initial posture of inverse kinematics, further joints as the last; policies leave the
wrist at any angle."""


def start_states(scene: Scene, config: EnvConfig, start: Start) -> list[Array]:
    """Return the starts (M, 3 J or 3 J + 3) of a subtask, an array for each kind of object.

    With `task.start=ik` they come from inverse kinematics; otherwise `task.start` is an .npz with an array named as
    each kind of `cell.objects`, as `evaluate terminal_states=` records them.

    Raises:
      ConfigError: the file is missing, damaged or of more levels than `comfort.levels`.
    """
    if start == Start.HOME:
        return [at_rest(scene.home[None])] * len(config.cell.objects)
    if config.task.start != "ik":
        return recorded(config.task.start, config.comfort.levels, len(scene.joints), config.cell.kinds)
    precision, cell, home = config.task.precision, config.cell, tuple(scene.home)
    picked = start == Start.AT_OBJECT
    near = precision.grasp_tolerance_m if picked else precision.place_tolerance_m
    goals = [cell.centre(kind, each.arrives_at if picked else each.belongs_at) for kind, each in cell.objects.items()]
    return [at_rest(inverse_kinematics(scene.xml, tuple(goal), near, home)) for goal in goals]


def _bank(archive: ZipFile, name: str) -> Array:
    """Return an array of an .npz; raise ValueError if the file holds less than its header says."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    if math.prod(shape) * dtype.itemsize > archive.getinfo(name).file_size:
        raise ValueError(f"{name} is cut short")
    with archive.open(name) as file:
        return np.asarray(np.lib.format.read_array(file), dtype=np.float64)


def at_rest(joint_pos: Array) -> Array:
    """Return the starts (M, 3 J) of joint angles (M, J) at rest, the servo targets at the joint angles."""
    return np.concatenate([joint_pos, np.zeros_like(joint_pos), joint_pos], axis=1)


def recorded(path: str, levels: int, joints: int, kinds: tuple[str, ...]) -> list[Array]:
    """Return the recorded starts (M, 3 J or 3 J + 3) of each of `kinds`; their levels are 1 to `levels`."""
    arm = PARTS * joints
    whole = arm + WITH_HUMAN
    if not Path(path).is_file():
        raise ConfigError(f"task.start={path!r} is neither 'ik' nor an existing .npz file")
    try:
        check_archive(Path(path), MOST_BYTES)
        with ZipFile(path) as archive:
            banks = [_bank(archive, f"{kind}.npy") for kind in kinds]
    except DAMAGED as error:
        raise ConfigError(
            f"task.start={path!r} must hold an array of shape (M, {arm}) or (M, {whole}) for each of {', '.join(kinds)}"
        ) from error
    for kind, bank in zip(kinds, banks, strict=True):
        shaped = bank.ndim == 2 and bank.shape[1] in (arm, whole) and len(bank)
        if not shaped or not (np.abs(bank[:, : whole - 1]) < MOST).all():
            raise ConfigError(
                f"task.start={path!r}: {kind!r} has shape {bank.shape}; "
                f"it must be (M, {arm}) or (M, {whole}), finite, every value within ±{MOST:g}"
            )
        level = bank[:, whole - 1 :]
        if not (np.isnan(level) | ((level >= 1) & (level <= levels))).all():
            raise ConfigError(f"task.start={path!r}: {kind!r} has levels that are not in 1 to {levels}")
    return banks


@lru_cache(maxsize=32)
def inverse_kinematics(xml: str, goal: tuple[float, ...], precision_m: float, home: tuple[float, ...]) -> Array:
    """Return (COUNT, J) rad: postures free of contact with the tool within `precision_m` of `goal`.

    Each is solved from home, turned towards the goal, plus Gaussian noise, for a point near the surface of the
    sphere round the goal, where a policy stops.
    """
    model = mujoco.MjModel.from_xml_string(xml)
    model.geom_margin[model.geom_contype == 0] = CLEARANCE_M  # tables, pedestal, floor
    rng = np.random.default_rng(0)
    configuration = mink.Configuration(model)
    tool = mink.FrameTask("robot/tcp", "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-3)
    limits = [mink.ConfigurationLimit(model)]
    found: list[Array] = []
    spread = np.resize(SPREAD_RAD, len(home))
    spread[len(SPREAD_RAD) :] = SPREAD_RAD[-1]
    mujoco.mj_kinematics(model, configuration.data)
    facing = configuration.data.body("robot/base").xmat[[3, 0]]
    towards = np.arctan2(goal[1], goal[0]) - np.arctan2(*facing)
    towards *= -1.0 if configuration.data.xaxis[0, 2] < 0 else 1.0
    for _ in range(50 * COUNT):
        posture = np.array(home) + rng.normal(size=len(home)) * spread
        # The arm may reach over the shoulder, as at home, or turned by half a circle.
        posture[0] += towards + rng.choice([-np.pi, 0.0, np.pi])
        posture[0] = (posture[0] + np.pi) % (2 * np.pi) - np.pi
        direction = rng.normal(size=3)
        point = np.array(goal) + direction / np.linalg.norm(direction) * precision_m * rng.uniform(0.6, 0.98)
        configuration.update(posture)
        tool.set_target(mink.SE3.from_translation(point))
        for _ in range(ITERATIONS):
            velocity = mink.solve_ik(configuration, [tool], STEP_S, "daqp", damping=1e-3, limits=limits)
            configuration.integrate_inplace(velocity, STEP_S)
            if np.linalg.norm(configuration.data.site("robot/tcp").xpos - goal) < precision_m * 0.98:
                break
        reached = np.linalg.norm(configuration.data.site("robot/tcp").xpos - goal) < precision_m
        mujoco.mj_forward(model, configuration.data)
        if reached and configuration.data.ncon == 0:
            found.append(configuration.q.copy())
            if len(found) == COUNT:
                return np.array(found)
    raise ConfigError(f"only {len(found)} of {COUNT} starts found at cell point {goal}: is it within reach?")
