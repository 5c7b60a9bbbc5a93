"""Compiled motions, one function each for one person, and what holds for people of all motions.

A motion is given who moves (`who`: x, y, yaw, velocity x, y and yaw rate, spawn x, y, pace and habit in [0, 1)), its
numbers (`of`, by their names in `moves`), memory and noise, and what it sees; it changes `memory`, and `limbs` if it
moves them, and returns position, m, and yaw, rad.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.compiled import kernel
from hrl_comfort.config import CONTROL_STEP_S
from hrl_comfort.humans.kernels import turned
from hrl_comfort.humans.motions.moves import (
    ACCELERATION,
    ARC,
    ARC_STEPS,
    CURIOSITY,
    FORWARD,
    FORWARD_PROBABILITY,
    FULL_TURN,
    JITTER,
    SPEED,
    STAY,
    before,
    minimum_jerk,
    pace,
    reach_out,
    towards,
    walking,
    way_round,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Place = tuple[float, float, float]
EPSILON = 1e-9
NEAR_STATION_M, NEAR_TABLE_M, NEAR_GOAL_M = 0.02, 0.05, 0.1
"""Distances at which `patrol`, `worker` and `reactive` have reached a station."""
REACH_S, STAY_S, PAUSE_S = 1.2, 0.8, 0.8
"""Reaching out, handling and pausing: reaches of 0.5 m take about a second (Jeannerod, Journal of Motor Behavior 16,
1984); the profile is that of minimum jerk (Flash and Hogan, Journal of Neuroscience 5, 1985), whose largest speed here
is 0.9 m/s."""
LOWEST_M, HIGHEST_M = 1.0, 1.25
"""Of the hands above the floor; the balls of the paper's cell lie at 1.04 m."""
ASIDE_M = 0.10
"""Farthest of the hands from the middle of the table to its side."""
ASTRAY, SHORTEST, LONGEST = 0.1, 0.8, 1.2
"""Probability that a `fetcher` turns back, and bounds of a stay as shares of `stay_s`."""
RELAXATION_S = 0.5
"""Time in which people reach their desired velocity (Helbing and Molnár, Physical Review E 51, 1995)."""
IMPORTANCE, RANGE, SHARP, SHARPER, FACTOR_M_S2 = 2.0, 0.35, 2.0, 3.0, 5.1
"""λ, γ, n, n′ (Moussaïd et al., Proceedings of the Royal Society B 276, 2009) and the strength that pedsim uses."""
LARGEST = math.log(1.5 * FACTOR_M_S2)
"""Logarithm of more than the largest force, m/s², of something at no distance."""
LOOKING_M = 0.7
"""Distance from the tool at which a curious human stops: the arm's length of two people who talk."""


@kernel
def random_walk(who: Array, of: Array, noise: Array) -> Place:
    """Move up to `jitter_m` along x and y or, with `forward_probability`, `forward_m` towards the base.

    The paper's "random forward walk", for which it gives no constants. The defaults are those of its released code,
    which also moves the human along an arc (motion `arc`).
    """
    x, y = who[0], who[1]
    if noise[2] < of[FORWARD_PROBABILITY]:
        yaw = math.atan2(-y, -x)
        x, y = x + of[FORWARD] * math.cos(yaw), y + of[FORWARD] * math.sin(yaw)
    else:
        x, y = x + (2 * noise[0] - 1) * of[JITTER], y + (2 * noise[1] - 1) * of[JITTER]
    return x, y, math.atan2(-y, -x)


@kernel
def arc(who: Array, of: Array, noise: Array, steps: int) -> Place:
    """Move the bearing by `arc_deg` over `arc_steps` and back; take the radius from `random_walk`.

    As in the paper's released code: an arc around the robot with a random-walk radius.
    """
    x, y, _ = random_walk(who, of, noise)
    radius, turns = math.sqrt(x * x + y * y), (steps + 1) / of[ARC_STEPS]
    bearing = math.atan2(who[7], who[6]) + math.radians(of[ARC]) * (1.0 - abs(1.0 - turns % 2.0))
    x, y = radius * math.cos(bearing), radius * math.sin(bearing)
    return x, y, math.atan2(-y, -x)


@kernel
def approach(who: Array, of: Array, tcp: Array) -> Place:
    """Walk straight at `speed_m_s` towards the tool centre point and face it: the paper's critical case."""
    dx, dy = tcp[0] - who[0], tcp[1] - who[1]
    distance = math.sqrt(dx * dx + dy * dy)
    stride, size = min(of[SPEED] * CONTROL_STEP_S, distance), max(distance, 1e-9)
    return who[0] + dx / size * stride, who[1] + dy / size * stride, math.atan2(dy, dx)


@kernel
def patrol(who: Array, of: Array, memory: Array, noise: Array, stations: Array, discs: Array, radius_m: float) -> Place:
    """Walk around the robot to the next of the stations, stay there for `stay_s` on average, and repeat.

    The stay has an exponential distribution; away from a station the human leaves at once. The direction is
    drawn on leaving. A working human faces the robot, a walking one the direction. With `acceleration_m_s2` the
    human turns before walking off, starts and stops gradually, and carries the arms before the body; without it
    they change direction and speed at once. Memory: way (1 anticlockwise, -1 clockwise, 0 staying), goal.
    """
    x, y, yaw = who[0], who[1], who[2]
    smooth, near = not math.isnan(of[ACCELERATION]), 5 * NEAR_STATION_M
    nearest, least = 0, np.inf
    for index in range(len(stations)):
        dx, dy = x - stations[index, 0], y - stations[index, 1]
        gap = math.sqrt(dx * dx + dy * dy)
        if gap < least:
            nearest, least = index, gap
    bearing, way, goal = math.atan2(y, x), memory[0], int(memory[1])
    away = least > (near if smooth else EPSILON)
    leaving = way == 0 and (away or noise[2] * of[STAY] < CONTROL_STEP_S)
    if leaving:
        way, shortest = 1.0 if noise[0] < 0.5 else -1.0, np.inf
        for index in range(len(stations)):
            ahead = (math.atan2(stations[index, 1], stations[index, 0]) - bearing) * way % FULL_TURN
            dx, dy = x - stations[index, 0], y - stations[index, 1]
            if ahead < EPSILON or (smooth and math.sqrt(dx * dx + dy * dy) < near):
                ahead += FULL_TURN
            if ahead < shortest:
                goal, shortest = index, ahead
    gx, gy = stations[goal]
    left = (math.atan2(gy, gx) - bearing) * way % FULL_TURN
    radius = math.sqrt(x * x + y * y)
    outwards = math.sqrt(gx * gx + gy * gy) - radius
    span = math.hypot(radius * left, outwards)
    share = min(1.0, of[SPEED] * CONTROL_STEP_S / max(span, EPSILON))
    direction, reached = bearing + way * left * share, radius + outwards * share
    tx, ty = reached * math.cos(direction), reached * math.sin(direction)
    arrived = span < NEAR_STATION_M if smooth else share == 1.0
    going = way != 0 and not arrived
    memory[0], memory[1] = 0.0 if arrived else way, goal
    if not smooth:
        if way != 0:
            x, y = (gx, gy) if arrived else (tx, ty)
        facing = math.atan2(-y, -x)
        return x, y, facing - way * math.pi / 2 if going else facing
    # Half of the acceleration is left for the bend of the path.
    speed, change = pace(who, of), of[ACCELERATION] / 2
    if going:  # along the path, once the human faces it
        dx, dy = tx - x, ty - y
        size = max(math.sqrt(dx * dx + dy * dy), EPSILON)
        px, py = dx / size, dy / size
        facing = max(px * math.cos(yaw) + py * math.sin(yaw), 0.0)
        wx, wy = towards(px * span, py * span, speed, change)
        wx, wy, heading = wx * facing, wy * facing, math.atan2(dy, dx)
    else:
        wx, wy = towards(stations[nearest, 0] - x, stations[nearest, 1] - y, speed, change)
        heading = math.atan2(-y, -x)
    there_x, there_y = walking(who, of, wx, wy, discs, radius_m)
    return there_x, there_y, turned(yaw, who[5], heading)


@kernel
def worker(
    who: Array, of: Array, memory: Array, limbs: Array, noise: Array, stations: Array, discs: Array, radius_m: float
) -> Place:
    """Walk to the station nearest to the spawn point, and there reach again and again to the place of the objects.

    Memory: time in the cycle of reaching (s), and the hands' height and offset to the side (m) of this reach.
    """
    x, y, yaw = who[0], who[1], who[2]
    sx, sy, least = 0.0, 0.0, np.inf
    for index in range(len(stations)):
        dx, dy = who[6] - stations[index, 0], who[7] - stations[index, 1]
        gap = math.sqrt(dx * dx + dy * dy)
        if gap < least:
            sx, sy, least = stations[index, 0], stations[index, 1], gap
    dx, dy = sx - x, sy - y
    there = math.sqrt(dx * dx + dy * dy) < NEAR_TABLE_M
    wx, wy = towards(dx, dy, pace(who, of), of[ACCELERATION] / 2)
    there_x, there_y = walking(who, of, wx, wy, discs, radius_m)
    tx, ty = before(sx, sy)
    heading = math.atan2(ty - there_y, tx - there_x) if there else math.atan2(dy, dx)

    whole, begun = 2 * REACH_S + STAY_S + PAUSE_S, memory[0]
    clock = begun + CONTROL_STEP_S if there or begun > 0 else 0.0
    if clock > whole or begun == 0:
        memory[1], memory[2] = LOWEST_M + (HIGHEST_M - LOWEST_M) * noise[0], ASIDE_M * (2 * noise[1] - 1)
    memory[0] = clock = CONTROL_STEP_S if clock > whole else clock
    share = minimum_jerk(clock / REACH_S) - minimum_jerk((clock - REACH_S - STAY_S) / REACH_S)
    reach_out(limbs, x, y, yaw, tx, ty, share, memory[1], memory[2])
    return there_x, there_y, turned(yaw, who[5], heading)


@kernel
def fetcher(
    who: Array, of: Array, memory: Array, limbs: Array, noise: Array, stations: Array, discs: Array, radius_m: float
) -> Place:
    """Go from station to station by habit, and reach into the place before each for about `stay_s`.

    Each goes round the robot in a direction of their own, and turns back with the probability ASTRAY. Memory: number
    of the station from 1 on, time at it (s; 0 on the way), and how long this stay lasts (s).
    """
    x, y, yaw, count = who[0], who[1], who[2], len(stations)
    if memory[0] == 0:
        least = np.inf
        for index in range(count):
            dx, dy = stations[index, 0] - x, stations[index, 1] - y
            gap = math.sqrt(dx * dx + dy * dy)
            if gap < least:
                memory[0], least = index + 1, gap
    if memory[1] > 0 and memory[1] >= memory[2]:
        way = 1 if (who[9] < 0.5) == (noise[0] >= ASTRAY) else -1
        memory[0], memory[1] = (int(memory[0]) - 1 + way) % count + 1, 0.0
    sx, sy = stations[int(memory[0]) - 1]
    dx, dy = sx - x, sy - y
    there = math.sqrt(dx * dx + dy * dy) < NEAR_TABLE_M
    if there and memory[1] == 0:
        memory[2] = of[STAY] * (SHORTEST + (LONGEST - SHORTEST) * noise[1])
    memory[1] = clock = memory[1] + CONTROL_STEP_S if there or memory[1] > 0 else 0.0
    dx, dy = way_round(x, y, sx, sy)
    wx, wy = towards(dx, dy, pace(who, of), of[ACCELERATION] / 2)
    there_x, there_y = walking(who, of, wx, wy, discs, radius_m)
    tx, ty = before(sx, sy)
    heading = math.atan2(ty - there_y, tx - there_x) if there else math.atan2(dy, dx)
    share = minimum_jerk(clock / REACH_S) - minimum_jerk((clock + REACH_S - memory[2]) / REACH_S)
    reach_out(limbs, x, y, yaw, tx, ty, max(share, 0.0) if clock > 0 else 0.0, LOWEST_M, 0.0)
    return there_x, there_y, turned(yaw, who[5], heading)


def other_stays(memory: Array, stay_s: float, uniform: Array) -> Array:
    """Return `memory` (n, MEMORY) of `fetcher` in which who stays leaves at another time that fits what is seen.

    Who has begun to draw the hands back leaves as before. uniform (n,) in [0, 1).
    """
    seen_s = memory[:, 1] + REACH_S
    shortest = np.maximum(seen_s, SHORTEST * stay_s)
    drawn = shortest + np.maximum(LONGEST * stay_s - shortest, 0.0) * uniform
    changed = memory.copy()
    changed[:, 2] = np.where((memory[:, 1] > 0) & (seen_s < memory[:, 2]), drawn, memory[:, 2])
    return changed


@kernel
def strength(apart_x: float, apart_y: float, approach_x: float, approach_y: float) -> float:
    """Return the logarithm of more than the size of `social_force`, of the same arguments.

    Both its parts shrink with the square of an angle, which is not smaller than the chord of its arc.
    """
    far = math.sqrt(apart_x * apart_x + apart_y * apart_y)
    distance = max(far, 1e-9)
    away_x, away_y = apart_x / distance, apart_y / distance
    x, y = away_x - IMPORTANCE * approach_x, away_y - IMPORTANCE * approach_y
    size = max(math.sqrt(x * x + y * y), 1e-9)
    reach, chord_squared = RANGE * size, 2 * (far / distance - (away_x * x + away_y * y) / size)
    return LARGEST - distance / reach - SHARP * SHARP * reach * reach * chord_squared


@kernel
def social_force(apart_x: float, apart_y: float, approach_x: float, approach_y: float) -> tuple[float, float, float]:
    """Return the acceleration, m/s², by which a person avoids something, and its size.

    `apart` m leads from it to the person, `approach` m/s is the person's velocity less its own (Moussaïd et al. 2009,
    equations 3 to 6).
    """
    distance = max(math.sqrt(apart_x * apart_x + apart_y * apart_y), 1e-9)
    away_x, away_y = apart_x / distance, apart_y / distance
    x, y = away_x - IMPORTANCE * approach_x, away_y - IMPORTANCE * approach_y
    size = max(math.sqrt(x * x + y * y), 1e-9)
    reach, along_x, along_y = RANGE * size, x / size, y / size
    theta = (math.atan2(along_y, along_x) - math.atan2(away_y, away_x) + math.pi) % FULL_TURN - math.pi
    slow, fast = SHARPER * reach * theta, SHARP * reach * theta
    braking = math.exp(-distance / reach - slow * slow)
    evading = -math.copysign(1.0, theta) * math.exp(-distance / reach - fast * fast) if theta != 0 else 0.0
    force_x = FACTOR_M_S2 * (braking * along_x - evading * along_y)
    force_y = FACTOR_M_S2 * (braking * along_y + evading * along_x)
    return force_x, force_y, math.sqrt(force_x * force_x + force_y * force_y)


@kernel
def reactive(
    who: Array, of: Array, memory: Array, first: bool, noise: Array, stations: Array, discs: Array, radius_m: float,
    tcp: Array, points: Array, moving: Array,
) -> Place:  # fmt: skip
    """Walk between the stations under social forces, one of which is the moving arm's.

    `curiosity` 0 is afraid: the nearest moving link repels twice as another person would. At 0.5 it repels as one. 1
    is curious: nothing repels, and the human goes to look at the tool. Memory: goal (station number), remaining stay
    (s).
    """
    x, y, yaw, count = who[0], who[1], who[2], len(stations)
    goal = int(math.floor(noise[0] * count) if first else memory[0])
    dx, dy = stations[goal, 0] - x, stations[goal, 1] - y
    if math.sqrt(dx * dx + dy * dy) < NEAR_GOAL_M and noise[2] * of[STAY] < CONTROL_STEP_S:
        goal = int((goal + 1 + math.floor(noise[0] * (count - 1))) % count)
    memory[0] = goal

    gx, gy = stations[goal]
    speed, change = pace(who, of), of[ACCELERATION] / 2
    dx, dy = way_round(x, y, gx, gy)
    wx, wy = towards(dx, dy, speed, change)
    tool_x, tool_y = tcp[0] - x, tcp[1] - y
    share = 1 - LOOKING_M / max(math.sqrt(tool_x * tool_x + tool_y * tool_y), LOOKING_M)
    look_x, look_y = towards(tool_x * share, tool_y * share, speed, change)
    curious = max(2 * of[CURIOSITY] - 1, 0.0)
    wx, wy = wx + curious * (look_x - wx), wy + curious * (look_y - wy)

    vx, vy, most, nearest, rx, ry, strongest = who[3], who[4], -np.inf, 0, 0.0, 0.0, 0.0
    bounds = np.empty(len(points))
    for index in range(len(points)):
        ax, ay, bx, by = x - points[index, 0], y - points[index, 1], vx - moving[index, 0], vy - moving[index, 1]
        bounds[index] = strength(ax, ay, bx, by)
    for index in range(len(points)):
        if bounds[index] > most:
            nearest, most = index, bounds[index]
    ax, ay, bx, by = x - points[nearest, 0], y - points[nearest, 1], vx - moving[nearest, 0], vy - moving[nearest, 1]
    size = social_force(ax, ay, bx, by)[2]
    least = math.log(size) if size > 0 else -np.inf
    for index in range(len(points)):
        if bounds[index] < least:
            continue
        ax, ay, bx, by = x - points[index, 0], y - points[index, 1], vx - moving[index, 0], vy - moving[index, 1]
        fx, fy, size = social_force(ax, ay, bx, by)
        if size > strongest:
            rx, ry, strongest = fx, fy, size
    afraid = 2 * (1 - of[CURIOSITY])
    fx, fy = (wx - vx) / RELAXATION_S + rx * afraid, (wy - vy) / RELAXATION_S + ry * afraid
    there_x, there_y = walking(who, of, vx + fx * CONTROL_STEP_S, vy + fy * CONTROL_STEP_S, discs, radius_m)
    going = math.sqrt(wx * wx + wy * wy) > 0.1
    heading = math.atan2(wy, wx) if going else math.atan2(tool_y, tool_x)
    return there_x, there_y, turned(yaw, who[5], heading)
