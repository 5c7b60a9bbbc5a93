"""Unsafe contacts over every motion and policy: `python -m tests.safety.campaign CSV STEPS [RECORDINGS]`.

The table has a row a motion, policy and bound; `none` is without the shield. It grows round by round of STEPS control
steps a row (a quarter without the shield) until it is stopped, and goes on where it was. RECORDINGS are a folder of BVH
files.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.files.run_config import environment
from hrl_comfort.files.tables import write_table
from hrl_comfort.policies.load import make_policy
from hrl_comfort.scene.ratings import RATINGS
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State
from tests.safety import persistent

Array = NDArray[np.float64]
ROWS = 64
SLOW = ("expert", "potential_field")
"""Policies that get a quarter of the steps."""
MOTIONS = {
    "random_walk": (), "arc": (), "approach": ("human.bound_m=5",), "patrol": (), "worker": (), "reactive": (),
    "adversary": ("human.keep_out_m=0", "human.spawn=anywhere", "human.spawn_radius_m=[0.8,1.8]"),
    "recorded": (), "mixture": (),
}  # fmt: skip
BEHIND = "runs/reference/shielded/seed2"
SIGHT = ("task.observation=sight", "safety.clearance_m=0.01", "task.arrival_speed_rad_s=0.5")
LEVEL = ("comfort=conditioned", "comfort.source=fixed", "comfort.level=5")
POLICIES = {
    "frozen": ("tests.safety.campaign:frozen", "pick_place"),
    "random": ("random", "pick_place"), "expert": ("expert", "pick_place"),
    "potential_field": ("potential_field", "pick_place"), "pick": ("runs/reference/pick", "pick"),
    "place": ("runs/reference/place", "place"), "return": ("runs/reference/return", "return"),
    "shielded_pick": (f"{BEHIND}/pick", "pick", *SIGHT), "shielded_place": (f"{BEHIND}/place", "place", *SIGHT),
    "shielded_return": (f"{BEHIND}/return", "return", *SIGHT),
    **dict.fromkeys(persistent.POLICIES, ("persistent", "shift")),
    "comfort": ("runs/reference/comfort/stages/seed0", "pick_place", *LEVEL),
}  # fmt: skip
"""Name -> `policy=`, or `persistent` for one of `tests.safety.persistent`, task and overrides."""
WAYS = {
    "observed": ("safety=ssm", "safety.bound=observed"), "worst": ("safety=ssm", "safety.bound=worst"),
    "none": ("safety=none",),
}  # fmt: skip
WORLD = ("robot.rating=collaborative", "task.terminate_on=unsafe_contact")
CELL = ["motion", "policy", "bound"]


def frozen(observation: Array) -> Array:
    """Return the actions of an arm that stands still."""
    return np.zeros((*observation.shape[:-1], 6))


@dataclass
class Count:
    """Counts of some control steps."""

    steps: int = 0
    episodes: int = 0
    """That ended."""
    contacts: int = 0
    """Episodes with a touch."""
    unsafe_contacts: int = 0
    fastest_m_s: float = 0.0
    """Largest speed of the arm towards the person as a touch began."""
    protective_stops: int = 0
    outside_rating: int = 0
    """Set-points."""

    def plus(self, other: Count) -> Count:
        """Return both together."""
        fastest = max(self.fastest_m_s, other.fastest_m_s)
        both = {name: getattr(self, name) + getattr(other, name) for name in vars(self)}
        return Count(**{**both, "fastest_m_s": fastest})


def outside(engine: Engine, before: State, after: State, valid: NDArray[np.bool_]) -> int:
    """Return how many set-points of a decision exceed the rating of the arm.

    `before` (N) is the state at its beginning, `after` those after its K control steps, `valid` (N, K).
    """
    arm, scene = engine.episodes.separation.arm, engine.scene
    robot = engine.episodes.config.robot
    rated = RATINGS[robot.name][robot.rating]
    angles, velocity = (
        np.concatenate([getattr(before, name).numpy()[:, None], getattr(after, name).numpy()], axis=1)
        for name in ("joint_target", "target_vel")
    )
    change = np.abs(np.diff(velocity, axis=1)) / CONTROL_STEP_S
    # Set-points that are taken back to the arm stop at once.
    kept = np.abs(np.diff(angles, axis=1) - velocity[:, 1:] * CONTROL_STEP_S).max(axis=-1) < 1e-9
    low, high = scene.joint_range.T
    joints = angles.shape[-1]
    now, rate = angles[:, :-1].reshape(-1, joints), velocity[:, 1:].reshape(-1, joints)
    speed = arm.speeds(arm.pose(now), rate).max(axis=0).reshape(valid.shape)
    bad = (np.abs(velocity[:, 1:]) > np.radians(rated.speed_deg_s) * (1 + 1e-9)).any(axis=-1)
    bad |= (change > np.array(rated.acceleration_rad_s2) * (1 + 1e-9)).any(axis=-1) & kept
    bad |= ((angles[:, 1:] < low) | (angles[:, 1:] > high)).any(axis=-1)
    bad |= speed > rated.tool_speed_m_s * (1 + 1e-9)
    return int((bad & valid).sum())


def run(
    motion: str,
    policy: str,
    way: str,
    steps: int,
    seed: int,
    recordings: str,
    rows: int = ROWS,
    disturbance: str = "none",
) -> Count:
    """Run at least `steps` control steps and return what happened."""
    source, task, *levels = POLICIES[policy]
    file = [f"human.file={recordings}"] if motion == "recorded" else []
    said = [f"task={task}", f"human={motion}", *MOTIONS[motion], *file, *WORLD, *levels, *WAYS[way]]
    env = environment(compose("train", said))
    engine, speeds = Engine(env, rows, seed, disturbance=disturbance), [0.0]
    sensors = engine.episodes.referee.sensors
    measured = sensors.approach

    def approach(*given: Any) -> Array:
        found = measured(*given)
        speeds.append(float(found.max()))
        return found

    sensors.approach = approach  # type: ignore[method-assign]
    act: Callable[[State], Any]
    if source == "persistent":
        act = persistent.Policy(policy, rows, seed, engine.episodes.separation.arm)
    else:
        act = make_policy(source, engine.episodes.subtask, engine.scene, env, seed)
    state, found = engine.reset(), Count()
    while found.steps < steps:
        result = engine.step(np.asarray(act(state)))
        found.steps += int(result.valid.sum())
        found.outside_rating += outside(engine, state, result.instants, result.valid.numpy())
        after = result.state
        found.episodes += int(result.done.sum())
        found.contacts += int((after.contact & ~state.contact).sum())
        unsafe = result.instants.unsafe_contact & result.valid
        found.unsafe_contacts += int((unsafe.any(dim=1) & ~state.unsafe_contact).sum())
        found.protective_stops += int((after.protective_stops - state.protective_stops).sum())
        state = engine.reset(np.flatnonzero(result.done.numpy()))
    engine.close()
    found.fastest_m_s = max(speeds)
    return found


def main(path: Path, steps: int, recordings: str) -> None:
    """Add rounds to the table until stopped."""
    columns = [*CELL, "rounds", *vars(Count())]
    rows: dict[tuple[str, ...], dict[str, float]] = {}
    if path.exists():
        frame = pd.read_csv(path, keep_default_na=False)
        rows = {tuple(row[name] for name in CELL): row for row in frame.to_dict("records")}
    cells = [(motion, policy, way) for way in WAYS for policy in POLICIES for motion in MOTIONS]
    while True:
        turn = min(int(rows[cell]["rounds"]) if cell in rows else 0 for cell in cells)
        for motion, policy, way in cells:
            before = rows.get((motion, policy, way))
            if before is not None and before["rounds"] > turn:
                continue
            counted = Count(**{name: before[name] for name in vars(Count())}) if before else Count()
            share = steps // 4 if way == "none" or policy in SLOW else steps
            counted = counted.plus(run(motion, policy, way, share, 1000 + turn, recordings))
            key = dict(zip(CELL, (motion, policy, way), strict=True))
            rows[motion, policy, way] = {**key, "rounds": turn + 1, **vars(counted)}
            write_table(path, columns, ([row[name] for name in columns] for row in rows.values()))
            print(*key.values(), counted, flush=True)


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "tests/humans/reach.bvh")
