"""Motions as functions of numpy arrays: what the compiled ones of `humans.motions.kernels` are held to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hrl_comfort.config import CONTROL_STEP_S, HumanConfig
from hrl_comfort.humans import body, free
from hrl_comfort.humans.arms import FASTEST_M_S, PASSES, SPAN_M, TOLERANCE_M
from hrl_comfort.humans.body import FOREARM_M, UPPER_ARM_M
from hrl_comfort.humans.kernels import CLEARANCE_M, LEAVE_S, TURN_RAD_S, TURN_RAD_S2, WAIT_STEPS
from hrl_comfort.humans.motions.kernels import (
    ASIDE_M,
    ASTRAY,
    FACTOR_M_S2,
    HIGHEST_M,
    IMPORTANCE,
    LONGEST,
    LOOKING_M,
    LOWEST_M,
    NEAR_GOAL_M,
    NEAR_STATION_M,
    NEAR_TABLE_M,
    PAUSE_S,
    RANGE,
    REACH_S,
    RELAXATION_S,
    SHARP,
    SHARPER,
    SHORTEST,
    STAY_S,
)
from hrl_comfort.humans.motions.moves import APART_M, INTO_M, STRAIGHT_M
from hrl_comfort.humans.retreat import retreat_limits
from hrl_comfort.humans.steering import CARRYING, SLOWEST
from hrl_comfort.humans.walk import SPEED_SMOOTHING, Array, KeepOut, Stride, Surroundings, Walk, facing_base, length

FULL_TURN_RAD = 2 * np.pi
EPSILON_RAD = EPSILON_M = 1e-9


def towards(offset: Array, speed_m_s: Array | float, acceleration_m_s2: float) -> Array:
    """Return the velocity (n, 2) m/s along `offset` (n, 2) m from which braking ends at its end."""
    distance = length(offset)
    brake = acceleration_m_s2 * CONTROL_STEP_S
    arriving = np.sqrt(brake * brake + 2 * acceleration_m_s2 * distance) - brake
    return offset * (np.minimum(speed_m_s, arriving) / np.maximum(distance, 1e-9))[:, None]


def pace(config: HumanConfig, walk: Walk) -> Array:
    """Return the walking speed (n,) m/s of people whose `traits` differ: 60 to 100 % of `speed_m_s`."""
    return config.speed_m_s * (SLOWEST + (1 - SLOWEST) * walk.traits[:, 1])


def round_robot(position: Array, goal: Array, speed_m_s: Array, acceleration_m_s2: float) -> Array:
    """Return the velocity (n, 2) m/s of the shorter way round the robot from position to goal (n, 2) m."""
    bearing = bearing_of(position)
    left = (bearing_of(goal) - bearing + np.pi) % (2 * np.pi) - np.pi
    radius = length(position)
    arc = np.stack([length(goal) - radius, radius * left], axis=-1)  # outwards, anticlockwise
    cos, sin = np.cos(bearing), np.sin(bearing)
    path = np.stack([cos * arc[:, 0] - sin * arc[:, 1], sin * arc[:, 0] + cos * arc[:, 1]], axis=-1)
    straight = goal - position
    return towards(np.where(length(straight)[:, None] < STRAIGHT_M, straight, path), speed_m_s, acceleration_m_s2)


def step(walk: Walk, wanted: Array, config: HumanConfig, around: Surroundings) -> Array:
    wanted = beside(walk.position, wanted, around.keep_out, config.acceleration_m_s2 / 4)
    wanted = wanted * np.minimum(1.0, config.speed_m_s / np.maximum(length(wanted), 1e-9))[:, None]
    return walk.position + accelerated(walk.velocity[:, :2], wanted, config.acceleration_m_s2) * CONTROL_STEP_S


def accelerated(before: Array, wanted: Array, acceleration_m_s2: float) -> Array:
    """Return the velocity (n, 2) m/s nearest to `wanted` (n, 2) that a control step from `before` (n, 2) allows."""
    change = wanted - before
    share = np.minimum(1.0, acceleration_m_s2 * CONTROL_STEP_S / np.maximum(length(change), 1e-9))
    return np.asarray(before + change * share[:, None])


def beside(position: Array, wanted: Array, keep_out: KeepOut, acceleration_m_s2: float) -> Array:
    """Return `wanted` (n, 2) m/s turned along the discs that braking would not keep clear of."""
    offset = position[:, None] - keep_out.centres
    distance = np.maximum(length(offset), 1e-9)
    out = offset / distance[..., None]
    gap = distance - keep_out.radius_m - CLEARANCE_M
    allowed = np.sqrt(2 * acceleration_m_s2 * np.maximum(gap, 0.0)) + np.minimum(gap, 0.0) / LEAVE_S
    inwards = -(wanted[:, None] * out).sum(axis=-1)
    (turned,) = (inwards > allowed).any(axis=1).nonzero()
    if not len(turned):
        return wanted
    wanted = wanted.copy()
    wanted[turned] = _turned(wanted[turned], out[turned], allowed[turned])
    return wanted


def _turned(wanted: Array, out: Array, allowed: Array) -> Array:
    """Return `wanted` (n, 2) m/s turned along discs (n, g); `out` (n, g, 2) leads away from them."""
    for disc in range(out.shape[1]):
        away = out[:, disc]
        inwards = -(wanted * away).sum(axis=1)
        excess = np.maximum(inwards - allowed[:, disc], 0.0)
        along = np.stack([-away[:, 1], away[:, 0]], axis=-1)
        way = np.where((wanted * along).sum(axis=1) < 0, -1.0, 1.0)
        aside = np.where(inwards > 0, excess, 0.0) * way
        wanted = wanted + excess[:, None] * away + aside[:, None] * along
    return wanted


def turn(walk: Walk, wanted: Array) -> Array:
    left = (wanted - walk.yaw + np.pi) % (2 * np.pi) - np.pi
    brake = TURN_RAD_S2 * CONTROL_STEP_S
    rate = np.sign(left) * np.minimum(TURN_RAD_S, np.sqrt(brake * brake + 2 * TURN_RAD_S2 * np.abs(left)) - brake)
    before = walk.velocity[:, 2]
    return walk.yaw + (before + np.clip(rate - before, -brake, brake)) * CONTROL_STEP_S


def bearing_of(vectors: Array) -> Array:
    """Return the direction (n,) rad of vectors (n, 2)."""
    return np.arctan2(vectors[:, 1], vectors[:, 0])


def random_walk(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Move up to `jitter_m` along x and y or, with `forward_probability`, `forward_m` towards the base."""
    jitter = (2 * noise[:, :2] - 1) * config.jitter_m
    yaw = facing_base(walk.position)
    forward = config.forward_m * np.array([np.cos(yaw), np.sin(yaw)]).T
    move = np.where(noise[:, 2:] < config.forward_probability, forward, jitter)
    position = walk.position + move
    return position, facing_base(position)


def arc(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Move the bearing by `arc_deg` over `arc_steps` and back; take the radius from `random_walk`."""
    wandered, _ = random_walk(config, walk, noise, around)
    radius = np.linalg.norm(wandered, axis=-1)
    turns = (walk.step + 1) / config.arc_steps
    share = 1.0 - np.abs(1.0 - turns % 2.0)
    bearing = np.arctan2(walk.spawn[:, 1], walk.spawn[:, 0]) + np.radians(config.arc_deg) * share
    position = radius[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    return position, facing_base(position)


def approach(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> tuple[Array, Array]:
    """Walk at `speed_m_s` towards the tool centre point and face it."""
    offset = around.tcp - walk.position
    distance = length(offset)[:, None]
    stride = np.minimum(config.speed_m_s * CONTROL_STEP_S, distance)
    position = walk.position + offset / np.maximum(distance, 1e-9) * stride
    return position, np.arctan2(offset[:, 1], offset[:, 0])


def patrol(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk around the robot to the next of the stations, stay there for `stay_s` on average, and repeat.

    The stay has an exponential distribution; away from a station the human leaves at once. The direction is
    drawn on leaving. A working human faces the robot, a walking one the direction. With `acceleration_m_s2` the
    human turns before walking off, starts and stops gradually, and carries the arms before the body; without it
    they change direction and speed at once. Memory: way (1 anticlockwise, -1 clockwise, 0 staying), goal.
    """
    smooth = config.acceleration_m_s2 is not None
    stations, rows = around.stations, np.arange(len(walk.position))
    gaps = length(walk.position[:, None] - stations)
    away = gaps.min(axis=1) > (5 * NEAR_STATION_M if smooth else EPSILON_M)
    bearing = np.arctan2(walk.position[:, 1], walk.position[:, 0])
    way, goal = walk.memory[:, 0], walk.memory[:, 1].astype(np.int64)
    leaving = (way == 0) & (away | (noise[:, 2] * config.stay_s < CONTROL_STEP_S))
    way = np.where(leaving, np.where(noise[:, 0] < 0.5, 1.0, -1.0), way)

    ahead = (np.arctan2(stations[..., 1], stations[..., 0]) - bearing[:, None]) * way[:, None] % FULL_TURN_RAD
    here = (ahead < EPSILON_RAD) | (smooth & (gaps < 5 * NEAR_STATION_M))
    goal = np.where(leaving, np.where(here, ahead + FULL_TURN_RAD, ahead).argmin(axis=1), goal)
    left = ahead[rows, goal]

    radius = length(walk.position)
    outwards = length(stations)[rows, goal] - radius
    span = np.hypot(radius * left, outwards)
    share = np.minimum(1.0, config.speed_m_s * CONTROL_STEP_S / np.maximum(span, EPSILON_M))
    turned, reached = bearing + way * left * share, radius + outwards * share
    there = reached[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=-1)

    walking, memory = way != 0, walk.memory.copy()
    arrived = span < NEAR_STATION_M if smooth else share == 1.0
    memory[:, 0], memory[:, 1] = np.where(arrived, 0.0, way), goal
    if config.acceleration_m_s2 is not None:
        wanted = _wanted(walk, walking & ~arrived, there, span, stations[rows, gaps.argmin(axis=1)], config)
        position = step(walk, wanted, config, around)
        heading = bearing_of(there - walk.position)
        yaw = turn(walk, np.where(walking & ~arrived, heading, facing_base(walk.position)))
        return Stride(position, yaw, memory=memory)
    there = np.where(arrived[:, None], stations[rows, goal], there)
    position = np.where(walking[:, None], there, walk.position)
    facing = facing_base(position)
    return Stride(position, np.where(walking & ~arrived, facing - way * np.pi / 2, facing), memory=memory)


def _wanted(walk: Walk, walking: Array, there: Array, span: Array, station: Array, config: HumanConfig) -> Array:
    """Return the wanted velocity (n, 2) m/s: along the path, once the human faces it, or back to the station."""
    assert config.acceleration_m_s2 is not None
    path = there - walk.position
    path = path / np.maximum(length(path), EPSILON_M)[:, None]
    facing = (path * np.stack([np.cos(walk.yaw), np.sin(walk.yaw)], axis=-1)).sum(axis=1)
    speed = pace(config, walk)
    # Half of the acceleration is left for the bend of the path.
    ahead = towards(path * span[:, None], speed, config.acceleration_m_s2 / 2)
    staying = towards(station - walk.position, speed, config.acceleration_m_s2 / 2)
    return np.where(walking[:, None], ahead * np.maximum(facing, 0.0)[:, None], staying)


def worker(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk to the station nearest to the spawn point, and there reach again and again to the place of the objects.

    Memory: time in the cycle of reaching (s), and the hands' height and offset to the side (m) of this reach.
    """
    assert config.acceleration_m_s2 is not None
    nearest = length(walk.spawn[:, None] - around.stations).argmin(axis=1)
    station = around.stations[np.arange(len(nearest)), nearest]
    offset = station - walk.position
    there = length(offset) < NEAR_TABLE_M
    speed = pace(config, walk)
    wanted = towards(offset, speed, config.acceleration_m_s2 / 2)
    position = step(walk, wanted, config, around)
    table = station * (1 - INTO_M / np.maximum(length(station), INTO_M))[:, None]
    yaw = turn(walk, np.where(there, bearing_of(table - position), bearing_of(offset)))

    memory = walk.memory.copy()
    clock = np.where(there | (memory[:, 0] > 0), memory[:, 0] + CONTROL_STEP_S, 0.0)
    begins = (clock > 2 * REACH_S + STAY_S + PAUSE_S) | (walk.memory[:, 0] == 0)
    memory[:, 0] = np.where(clock > 2 * REACH_S + STAY_S + PAUSE_S, CONTROL_STEP_S, clock)
    drawn = np.stack([LOWEST_M + (HIGHEST_M - LOWEST_M) * noise[:, 0], ASIDE_M * (2 * noise[:, 1] - 1)], axis=-1)
    memory[:, 1:3] = np.where(begins[:, None], drawn, memory[:, 1:3])
    share = _reached(memory[:, 0], REACH_S + STAY_S)
    hands = _hands(walk, share, memory[:, 1], memory[:, 2], table - walk.position)
    return Stride(position, yaw, body.reaching(hands), memory)


def fetcher(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Go from station to station by habit, and reach into the place before each for about `stay_s`.

    Each goes round the robot in a direction of their own, and turns back with the probability ASTRAY. Memory: number
    of the station from 1 on, time at it (s; 0 on the way), and how long this stay lasts (s).
    """
    assert config.acceleration_m_s2 is not None
    stations, count, before = around.stations, around.stations.shape[1], walk.memory
    nearest = length(stations - walk.position[:, None]).argmin(axis=1)
    number = np.where(before[:, 0] == 0, nearest, before[:, 0] - 1).astype(np.int64)
    leaving = (before[:, 1] > 0) & (before[:, 1] >= before[:, 2])
    way = np.where((walk.traits[:, 2] < 0.5) == (noise[:, 0] >= ASTRAY), 1, -1)
    number = np.where(leaving, (number + way) % count, number)
    station = stations[np.arange(len(number)), number]
    there = length(station - walk.position) < NEAR_TABLE_M
    clock = np.where(leaving, 0.0, before[:, 1])
    drawn = config.stay_s * (SHORTEST + (LONGEST - SHORTEST) * noise[:, 1])
    stay = np.where(there & (clock == 0), drawn, before[:, 2])
    clock = np.where(there | (clock > 0), clock + CONTROL_STEP_S, 0.0)
    wanted = round_robot(walk.position, station, pace(config, walk), config.acceleration_m_s2 / 2)
    position = step(walk, wanted, config, around)
    table = station * (1 - INTO_M / np.maximum(length(station), INTO_M))[:, None]
    yaw = turn(walk, bearing_of(np.where(there[:, None], table - position, wanted)))
    share = np.where(clock > 0, np.maximum(_reached(clock, stay - REACH_S), 0.0), 0.0)
    hands = _hands(walk, share, np.full(len(share), LOWEST_M), np.zeros(len(share)), table - walk.position)
    return Stride(position, yaw, body.reaching(hands), np.stack([number + 1.0, clock, stay], axis=-1))


def _reached(clock: Array, back_s: Array | float) -> Array:
    """Return the share (n,) of a reach that began `clock` (n,) s ago, and is taken back from `back_s` on."""
    out, back = (np.clip(each / REACH_S, 0.0, 1.0) for each in (clock, clock - back_s))
    return _minimum_jerk(out) - _minimum_jerk(back)


def _hands(walk: Walk, share: Array, height: Array, across: Array, table: Array) -> Array:
    """Return the hands (n, 2, 3) m in the person's frame; `table` (n, 2) m is where its middle is from the person."""
    cos, sin = np.cos(walk.yaw), np.sin(walk.yaw)
    ahead, aside = cos * table[:, 0] + sin * table[:, 1], cos * table[:, 1] - sin * table[:, 0]
    target = np.empty((len(table), 2, 3))
    target[..., 0] = ahead[:, None]
    target[..., 1] = (aside + across)[:, None] + APART_M * body.SIDES
    target[..., 2] = height[:, None]
    return np.asarray(CARRYING + share[:, None, None] * (target - CARRYING))


def _minimum_jerk(share: Array) -> Array:
    return np.asarray(share**3 * (10 - 15 * share + 6 * share**2))


def reactive(config: HumanConfig, walk: Walk, noise: Array, around: Surroundings) -> Stride:
    """Walk between the stations under social forces, one of which is the moving arm's.

    `curiosity` 0 is afraid: the nearest moving link repels twice as another person would. At 0.5 it repels as one. 1
    is curious: nothing repels, and the human goes to look at the tool. Memory: goal (station number), remaining stay
    (s).
    """
    assert config.acceleration_m_s2 is not None
    stations, rows = around.stations, np.arange(len(walk.position))
    count = stations.shape[1]
    memory = walk.memory.copy()
    at_start = walk.step == 0
    goal = np.where(at_start, np.floor(noise[:, 0] * count), memory[:, 0]).astype(np.int64)
    there = length(stations[rows, goal] - walk.position) < NEAR_GOAL_M
    leaving = there & (noise[:, 2] * config.stay_s < CONTROL_STEP_S)
    goal = np.where(leaving, (goal + 1 + np.floor(noise[:, 0] * (count - 1))) % count, goal)
    goal = goal.astype(np.int64)
    memory[:, 0] = goal

    speed = pace(config, walk)
    desired = round_robot(walk.position, stations[rows, goal], speed, config.acceleration_m_s2 / 2)
    to_tool = around.tcp - walk.position
    looking = to_tool * (1 - LOOKING_M / np.maximum(length(to_tool), LOOKING_M))[:, None]
    look = towards(looking, speed, config.acceleration_m_s2 / 2)
    desired = desired + max(2 * config.curiosity - 1, 0.0) * (look - desired)

    points, moving = around.arm()
    velocity = walk.velocity[:, :2]
    repulsion = social_force(walk.position[:, None] - points[..., :2], velocity[:, None] - moving[..., :2])
    strongest = length(repulsion).argmax(axis=1)
    repulsion = repulsion[np.arange(len(strongest)), strongest] * 2 * (1 - config.curiosity)
    force = (desired - velocity) / RELAXATION_S + repulsion
    position = step(walk, velocity + force * CONTROL_STEP_S, config, around)
    going = length(desired) > 0.1
    yaw = turn(walk, bearing_of(np.where(going[:, None], desired, to_tool)))
    return Stride(position, yaw, memory=memory)


def social_force(apart: Array, approach: Array) -> Array:
    """Return the acceleration (..., 2) m/s² by which a person avoids something.

    `apart` (..., 2) m leads from it to the person, `approach` (..., 2) m/s is the person's velocity less its own
    (Moussaïd et al. 2009, equations 3 to 6).
    """
    distance = np.maximum(length(apart), 1e-9)
    away = apart / distance[..., None]
    interaction = away - IMPORTANCE * approach
    size = np.maximum(length(interaction), 1e-9)
    along = interaction / size[..., None]
    turned = np.arctan2(along[..., 1], along[..., 0]) - np.arctan2(away[..., 1], away[..., 0])
    theta = (turned + np.pi) % (2 * np.pi) - np.pi
    reach = RANGE * size
    braking = np.exp(-distance / reach - (SHARPER * reach * theta) ** 2)
    evading = -np.sign(theta) * np.exp(-distance / reach - (SHARP * reach * theta) ** 2)
    left = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    return np.asarray(FACTOR_M_S2 * (braking[..., None] * along + evading[..., None] * left))


def retreat(config: HumanConfig, walk: Walk, stride: Stride, around: Surroundings) -> Stride:
    """Return `stride` with the proposals of those who retreat replaced: away from the nearest point of the arm.

    They keep to the bounds of their motion on speed and acceleration, and to the keep-out discs. Their hands stay as
    they are: one that went on would press against the arm, and who presses is held and cannot step back.
    """
    (rows,) = walk.retreat.nonzero()
    if not len(rows) or not retreat_limits(config)[0]:
        return stride
    speed, acceleration = retreat_limits(config)
    going = walk.rows(rows)
    discs = KeepOut(around.keep_out.centres[rows], around.keep_out.radius_m)
    offset = going.position[:, None] - around.arm()[0][rows, :, :2]
    nearest = offset[np.arange(len(rows)), length(offset).argmin(axis=1)]
    away = nearest / np.maximum(length(nearest), 1e-9)[:, None]
    wanted = away * (speed * (going.retreat > WAIT_STEPS))[:, None]
    wanted = beside(going.position, wanted, discs, acceleration / 4)
    velocity = accelerated(going.velocity[:, :2], wanted, acceleration)
    position, yaw = stride.position.copy(), stride.yaw.copy()
    position[rows] = going.position + velocity * CONTROL_STEP_S
    yaw[rows] = turn(going, going.yaw)
    kept = {name: getattr(stride, name) for name in ("limbs", "memory")}
    for name, value in kept.items():
        if value is not None:
            kept[name] = value.copy()
            kept[name][rows] = getattr(going, name)
    return replace(stride, position=position, yaw=yaw, **kept)


def _held(position: Array, walk: Walk, keep_out: KeepOut, bound_m: float) -> Array:
    """Return the proposed `position` (n, 2) m as `advance` bounds it."""
    offset = position - walk.spawn
    shrink = np.minimum(1.0, bound_m / np.maximum(length(offset), 1e-9))
    position = walk.spawn + offset * shrink[:, None]
    (blocked,) = keep_out.entered(position).nonzero()
    if len(blocked):
        discs = KeepOut(keep_out.centres.take(blocked, axis=0), keep_out.radius_m)
        slid = discs.rim(position.take(blocked, axis=0))
        too_far = length(slid - walk.spawn.take(blocked, axis=0)) > bound_m + 1e-9
        stays = discs.entered(slid) | too_far
        position[blocked] = np.where(stays[:, None], walk.position.take(blocked, axis=0), slid)
    return position


def _gone(position: Array, yaw: Array, walk: Walk) -> tuple[Array, Array, Array]:
    """Return velocity (n, 3), distance walked (n,) m and smoothed speed (n,) m/s of people who are now at `position`.

    (n, 2) m, `yaw` (n,) rad.
    """
    moved = position - walk.position
    way = length(moved)
    speed = walk.speed_m_s + SPEED_SMOOTHING * (way / CONTROL_STEP_S - walk.speed_m_s)
    turned = (yaw - walk.yaw + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([moved, turned[:, None]], axis=1) / CONTROL_STEP_S, walk.walked_m + way, speed


def limited_arms(config: HumanConfig, walk: Walk, limbs: Array, velocity: Array) -> Array:
    """Return the limbs (n, 6, 3) that people have instead of `limbs`, who move at `velocity` (n, 3); see `arms`."""
    if not retreat_limits(config)[0]:
        return limbs
    most = np.maximum(FASTEST_M_S - length(velocity[:, :2]) - SPAN_M * abs(velocity[:, 2]), 0.0) * CONTROL_STEP_S
    bent = limbs.copy()
    for side in (2, 3):
        arm = [side, side + 2]
        for _ in range(PASSES):
            way = _arm_way(bent, walk.limbs, side)
            rows = np.flatnonzero(way > most + TOLERANCE_M)
            before = walk.limbs[np.ix_(rows, arm)]
            between = before + (most / way)[rows, None, None] * (bent[np.ix_(rows, arm)] - before)
            bent[np.ix_(rows, arm)] = between / np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-9)
    return bent


def _arm_way(bent: Array, limbs: Array, side: int) -> Array:
    """Return how far (n,) m elbow or hand go from `limbs` to `bent` (n, 6, 3)."""
    change = bent - limbs
    elbow = UPPER_ARM_M * change[:, side]
    return np.maximum(*(np.linalg.norm(each, axis=-1) for each in (elbow, elbow + FOREARM_M * change[:, side + 2])))


def advance(config: HumanConfig, walk: Walk, noise: Array, seen: Surroundings) -> Walk:
    """Return what `humans.advance` does of people of one of `FUNCTIONS`."""
    proposed = FUNCTIONS[config.motion](config, walk, noise, seen)
    stride = proposed if isinstance(proposed, Stride) else Stride(*proposed)
    stride = retreat(config, walk, stride, seen)
    position = stride.position if free(config) else _held(stride.position, walk, seen.keep_out, config.bound_m)
    velocity, walked, speed = _gone(position, stride.yaw, walk)
    limbs = walk.limbs if stride.limbs is None else limited_arms(config, walk, stride.limbs, velocity)
    memory = walk.memory if stride.memory is None else stride.memory
    left = np.maximum(walk.retreat - 1, 0)
    return Walk(
        position, stride.yaw, walk.spawn, walked, speed, walk.step + 1, velocity, limbs, memory, walk.traits, left
    )


FUNCTIONS = {each.__name__: each for each in (random_walk, arc, approach, patrol, worker, reactive, fetcher)}
