"""Random draws of an episode: objects, walk, spawn, start and points, from (seed, row, episode)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.comfort.adapt import longest_max_episode_steps
from hrl_comfort.comfort.fitted import PERSONS
from hrl_comfort.comfort.sources import DRAWS
from hrl_comfort.config import PREGRASP, RANDOM, ConfigError, EnvConfig
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.starts import PARTS, WITH_HUMAN, at_rest, recorded_starts, unseen_left_out
from hrl_comfort.sim.variation.layouts import Layout, Layouts
from hrl_comfort.sim.variation.random_streams import random_stream
from hrl_comfort.sim.variation.randomisation import draws, object_factors
from hrl_comfort.sim.variation.slots import Slots
from hrl_comfort.tasks import Start, Subtask

Array = NDArray[np.float64]

POINT_RADIUS_M, POINT_HEIGHT_M = (0.30, 0.55), (0.15, 0.55)
"""Annulus round the base in which random points of `reach` lie."""
TABLE_CLEARANCE_M = 0.25
ATTEMPTS = 200
LONGEST_STEPS = 1_000_000
"""Longest episode, control steps: the random numbers of its walk are drawn when it begins."""
LEVEL_STREAM, LATER_STREAM, OBJECT_STREAM, DISTURBANCE_STREAM, TRAIT_STREAM, RANDOMISE_STREAM = 1, 2, 3, 4, 5, 6
KEY_STREAM = 7
OTHERS_STREAM = 16
"""First of the streams of further people, two for each: where and who they are, and how they walk."""
LAYOUT_STREAM, TURN_STREAM, PERSON_STREAM, SLOT_STREAM, FACTOR_STREAM = 40, 41, 42, 43, 44
"""Streams of random numbers for levels, walks beyond `task.max_episode_steps`, objects, disturbances, traits, domain
randomisation, layouts, turns, who rates, slots and factors of objects: with or without any of them, the rest of an
episode is the same."""


@dataclass(frozen=True)
class Draw:
    """One start of an episode, or one of each of N cells (N, ...).

    Later attempts at the same episode draw only spawn, start, its level and points anew.
    """

    places: Array
    """(M, 7) m and quaternion, poses of the middle of the tops of the cell's places."""
    obstacles: Array
    """(O, 7) m and quaternion, poses of the cell's obstacles."""
    tops: Array
    """(F, 6), tops of places and obstacles, as `State.tops`."""
    goals: Array
    """(M, 3) m, goal of the tool at each place."""
    stations: Array
    """(S, 2) m, where people work."""
    home: Array
    """(J,) rad."""
    tcp_home: Array
    """(3,) m, tool centre point with every joint at home."""
    layout_id: Array
    """(1,) number of the layout; NaN of a cell that does not vary."""
    kind_places: Array
    """(kinds, 3) m, where the centre of an object of each kind belongs."""
    slots: Array
    """(B, kinds, 3) m, where that of each object belongs if it is of a kind; the slots differ with a gripper alone."""
    arrivals: Array
    """(B, kinds, 3) m, centre of each object where it arrives if it is of a kind."""
    kinds: NDArray[np.int64]
    """(B,) kind of each object, its index in `cell.objects`."""
    turns: Array
    """(B,) rad, turn of each object about the vertical as it arrives; zero without a gripper."""
    arriving: NDArray[np.int64]
    """(slots.ARRIVALS,) kinds of objects that arrive later, by control step modulo their number."""
    due: Array
    """(slots.ARRIVALS, B) s from the opening of each order until it is due, as `arriving`."""
    noise: Array
    """(horizon, P, NOISE) in [0, 1), for the walks at each control step."""
    traits: Array
    """(P, humans.TRAITS) in [0, 1), of the people."""
    level: Array
    """(comfort.sources.DRAWS,) in [0, 1), for the source of comfort levels."""
    motion_id: NDArray[np.int64]
    """() of the evaluation set; -1 in training."""
    spawn_id: NDArray[np.int64]
    """() index of the first person's spawn point; -1 where they begin anywhere."""
    spawn: Array
    """(P, 2) m."""
    start: Array
    """(3 J,) angles, velocities and servo targets of the joints (`sim.starts`)."""
    before: Array
    """(J,) rad, posture in front of the first object; NaN where that lies where it arrives."""
    hand: Array
    """With a gripper the recorded bodies (nq + nv,) and set-point of the fingers, NaN where none are; else (0,)."""
    points: Array
    """(2, 3) m, of `reach` and `point_to_point`; elsewhere in no use."""
    world: Array
    readings: Array
    frames: Array
    """Of how the cell differs from the model: see `sim.variation.randomisation`."""
    factors: Array
    """(3, kinds) of mass, friction and size of objects: see `randomisation.object_factors`."""
    key: NDArray[np.int64]
    """() of what policies and options draw: see `State.key`."""
    person: NDArray[np.int64]
    """() who rates the robot (`comfort.fitted`)."""

    def layout(self, rows: Any = slice(None)) -> Array:
        """Return the poses (r, F, 7) of places and obstacles, as `Scene.layout`, of `rows` of N cells."""
        return np.concatenate([self.places[rows], self.obstacles[rows]], axis=1)

    def objects(self, rows: Any = slice(None)) -> Array:
        """Return the centres (r, B, 3) m of the objects of `rows` of N cells where they arrive."""
        return np.take_along_axis(self.arrivals[rows], self.kinds[rows][..., None, None], axis=2)[:, :, 0]


class EpisodeSampler:
    """Sampler of episode starts; with an `evaluation` set, row r gets entry r (modulo its length)."""

    def __init__(
        self, scene: Scene, config: EnvConfig, task: Subtask, seed: int, evaluation: EvaluationSet | None
    ) -> None:
        self._slots = Slots(scene, config, task)
        self.seed = seed
        self._drawn = evaluation is None or evaluation.drawn
        self._scene, self._config, self._task, self._evaluation = scene, config, task, evaluation
        self._layouts = Layouts(scene, config)
        given = self._layouts.given
        self.spawns = [humans.moved_spawns(each, given.goals[:, :2]) for each in config.human.everyone]
        """(s, 2) m of each person, spawn points moved out of the keep-out discs."""
        self._plain_horizon = config.task.max_episode_steps + config.task.action_repeat
        longest = config.task.max_episode_steps
        longest = longest if task.repeats else longest_max_episode_steps(longest, config.comfort)
        if longest > LONGEST_STEPS:
            raise ConfigError(
                f"task.max_episode_steps={config.task.max_episode_steps} is {longest} control steps at level 1 of "
                f"comfort.levels={config.comfort.levels}; at most {LONGEST_STEPS} are allowed"
            )
        self.horizon = longest + config.task.action_repeat
        self._joints = len(scene.joints)
        self._arm = PARTS * self._joints
        hand = 0 if scene.gripper is None else scene.model.nq + scene.model.nv + 1
        sizes = len(config.cell.kinds) if config.randomise.resized else 0
        self._bodies = self._arm + hand
        self._own = self._bodies + sizes
        self._half_heights = np.array([each.half_height_m for each in config.cell.objects.values()])
        self._grasps = scene.gripper is not None and task.start == Start.HOME and task.stages[0].grasps
        self._points = np.array([config.task.point_m, config.task.second_point_m])
        needed = task.points or self._grasps
        self._points_drawn = "never" if config.task.point != RANDOM else "now" if needed else "later"
        self.reach = 0.0 if config.task.start == PREGRASP else np.inf
        """Of tasks that begin with a grasp: see `CurriculumConfig.reach`; infinite at home."""
        self._recorded = recorded_starts(config, task.start, self._joints, hand + sizes)
        if self._recorded is not None and self._drawn:
            self._recorded = [unseen_left_out(bank, self._own, config, self.spawns[0]) for bank in self._recorded]

    def blank(self, rows: int) -> Draw:
        """Return the draws of `rows` cells, to be filled in; raise ConfigError if none can be made."""
        one = vars(next(self.attempts(0, 0)))
        return Draw(**{name: np.zeros((rows, *value.shape), value.dtype) for name, value in one.items()})

    def attempts(self, row: int, episode: int) -> Iterator[Draw]:
        """Yield draws for an episode until the caller accepts one.

        In training a recorded start brings its human and its level, if it has them, except with probability
        `task.resample_start_probability`; then a cell that varies has a layout and an inverse-kinematics start of its
        own. The second half of the attempts uses inverse-kinematics starts, and layouts drawn anew.
        """
        rng = self.generator(row, episode)
        names = self._config.cell.kinds
        drawn = int(rng.integers(len(names)))
        kind = drawn if self._config.task.object == RANDOM else names.index(self._config.task.object)
        if self._evaluation is None:
            motion_id, noise = -1, rng.random((self._plain_horizon, humans.NOISE))
            if self.horizon > self._plain_horizon:
                later = self.generator(row, episode, LATER_STREAM)
                noise = np.concatenate([noise, later.random((self.horizon - self._plain_horizon, humans.NOISE))])
        else:
            motion_id = int(self._evaluation.motion_id.take(row, mode="wrap"))
            noise = random_stream(motion_id, humans.MOTION_STREAM).random((self.horizon, humans.NOISE))
        others = [self.generator(row, episode, stream) for stream in self._streams]
        noise = np.stack([noise, *self._walks(row, episode, motion_id)], axis=1)
        levels = self.generator(row, episode, LEVEL_STREAM)
        level, kept = levels.random(DRAWS), levels.random() >= self._config.task.resample_start_probability
        split = None if self._evaluation is None else str(self._evaluation.split.take(row, mode="wrap"))
        low, high = humans.share_of(split, self._config.human.partitioned)
        own = self.generator(row, episode, TRAIT_STREAM)
        traits = np.stack([each.random(humans.TRAITS) for each in (own, *others)])
        traits[:, 1:] = low + (high - low) * traits[:, 1:]
        slots = self._slots.drawn(self.generator(row, episode, SLOT_STREAM)) if self._slots.own else {}
        arriving = self._slots.objects(kind, slots, self.generator(row, episode, OBJECT_STREAM))
        turns = np.zeros(self._config.task.objects)
        if self._scene.gripper is not None:
            turns = self.generator(row, episode, TURN_STREAM).uniform(-np.pi, np.pi, len(turns))
        other = draws(self._config.randomise, self._joints, self.generator(row, episode, RANDOMISE_STREAM))
        drawn_factors = object_factors(self._config.randomise, len(names), self.generator(row, episode, FACTOR_STREAM))
        own_layout = self._layout(row, self.generator(row, episode, LAYOUT_STREAM))
        key = np.array(self.generator(row, episode, KEY_STREAM).integers(2**63))
        persons = (np.array(humans.persons_of(split)) * PERSONS).round().astype(int)
        rater = np.array(self.generator(row, episode, PERSON_STREAM).integers(*persons))
        for attempt in range(ATTEMPTS):
            layout = own_layout if attempt < ATTEMPTS // 2 else self._layout(row, rng)
            bank = self._bank(kind, layout, row, attempt < ATTEMPTS // 2 and (kept or not self._layouts.varies))
            if len(bank) >= 5:  # one for each of three splits, as their shares are fifths
                bank = bank[int(low * len(bank)) : int(high * len(bank))]
            start = bank[rng.integers(len(bank))]
            if len(start) > self._own + WITH_HUMAN:
                layout = self._layouts.numbered("train", int(start[-1]))
            spawn_id, spawn, discs = self._spawn(row, rng, layout)
            points, near = self._points, spawn
            if self._points_drawn == "now":
                points = self._random_points(near, layout.goals, rng)
                discs = self.keep_out(points[None], layout.goals[None])
            told = level.copy()
            person = start[None, self._own : self._own + 2]
            given = kept and len(start) > self._own and self._drawn and np.isfinite(person).all()
            if given:
                spawn_id, spawn = -1, humans.outside(person, discs)[0]
                own_level = start[self._own + WITH_HUMAN - 1]
                if not np.isnan(own_level):  # the draw that gives this level
                    told[0] = (own_level - 0.5) / self._config.comfort.levels
            spawns = humans.spawns_apart(self._config.human.everyone, self.spawns, discs, others, spawn)
            ids = np.array(motion_id), np.array(spawn_id)
            factors = drawn_factors.copy()
            if len(start) >= self._own > self._bodies:
                factors[2] = start[self._bodies : self._own]
            rise = (factors[2] - 1) * self._half_heights
            standing = (
                layout.places, layout.obstacles, layout.tops, layout.goals, layout.stations, layout.home,
                layout.tcp_home, np.array([layout.number]), raised(layout.belongs, rise),
                raised(self._slots.belonging(layout, slots), rise),
                raised(self._slots.arrivals(layout, arriving[0]), rise), arriving[1], turns, *arriving[2:],
            )  # fmt: skip
            body = self._body(start, layout, rng)
            yield Draw(*standing, noise, traits, told, *ids, spawns, *body, points, *other, factors, key, rater)
            if self._points_drawn == "later":  # the next attempt goes on in their stream, though they are in no use
                self._random_points(near, layout.goals, rng)

    @property
    def _streams(self) -> range:
        """The streams of where and who further people are."""
        return range(OTHERS_STREAM, OTHERS_STREAM + 2 * len(self._config.human.everyone) - 2, 2)

    def _walks(self, row: int, episode: int, motion_id: int) -> Iterator[Array]:
        """Yield the noise (horizon, NOISE) of each further person; `motion_id` is -1 in training."""
        for index, stream in enumerate(self._streams, start=1):
            rng = self.generator(row, episode, stream + 1)
            if motion_id >= 0:
                rng = random_stream(motion_id, humans.MOTION_STREAM + index)
            yield rng.random((self.horizon, humans.NOISE))

    def _layout(self, row: int, rng: np.random.Generator) -> Layout:
        """Return the layout of an episode of `row`."""
        if not self._layouts.varies:
            return self._layouts.given
        return self._layouts.numbered(self._split(row), int(rng.integers(self._config.cell.vary.layouts)))

    def _split(self, row: int) -> str:
        """Return the split of the layouts of the episodes of `row`; `paper` has those of `validation`."""
        if self._evaluation is None:
            return "train"
        return "test" if self._evaluation.split.take(row, mode="wrap") == "test" else "validation"

    def _bank(self, kind: int, layout: Layout, row: int, recorded: bool) -> Array:
        """Return the starts (M, 3 J or more) of an episode: recorded ones where they may be, or of the layout."""
        start = self._task.start
        if self._recorded is not None and recorded and (not self._layouts.varies or self._split(row) == "train"):
            return self._recorded[kind]
        if self._grasps and np.isfinite(self.reach):
            start = Start.BEFORE_OBJECT
        if start == Start.HOME:
            return at_rest(layout.home[None])
        return at_rest(self._layouts.postures(layout, start, kind))

    def _body(self, start: Array, layout: Layout, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Return `start`, `before` and `hand` of a Draw whose start (3 J or more,) of its bank is given."""
        arm, hand = start[: self._arm], start[self._arm : self._bodies]
        before = np.full(self._joints, np.nan)
        if len(hand) < self._bodies - self._arm:
            hand = np.full(self._bodies - self._arm, np.nan)
        if self._grasps and np.isfinite(self.reach):
            way = min(1.0, self.reach * rng.random())
            before = before if way == 1.0 else arm[: self._joints]
            arm = at_rest(arm[None, : self._joints] + way * (layout.home - arm[: self._joints]))[0]
        return arm, before, hand

    def keep_out(self, points: Array, goals: Array) -> humans.KeepOut:
        """Return the discs that people keep out of: round the base, and points (n, 2, 3) m or goals (n, M, 3) m."""
        given = points[:, : self._task.points] if self._task.points else goals
        centres = np.concatenate([given[..., :2], np.zeros((len(given), 1, 2))], axis=1)
        return humans.KeepOut(centres, self._config.human.keep_out_m)

    def generator(self, row: int, episode: int, stream: int = 0) -> np.random.Generator:
        """Return the generator of one stream of an episode's random numbers."""
        first = (self.seed << 32) + row
        if self._evaluation is not None:
            first = int(self._evaluation.episode_seed.take(row, mode="wrap")) << 32
        return random_stream(first, (stream << 48) + episode)

    def _spawn(self, row: int, rng: np.random.Generator, layout: Layout) -> tuple[int, Array, humans.KeepOut]:
        """Return the first person's spawn point, where (2,) m they begin, and the discs that they keep out of."""
        human = self._config.human
        if self._config.task.point == RANDOM and self._task.points:  # random points keep clear of the human themselves
            discs = humans.around(np.empty((0, 2)), human.keep_out_m, 1)
        else:
            discs = self.keep_out(self._points[None], layout.goals[None])
        if self._evaluation is not None and not self._drawn:
            entry = row % len(self._evaluation.episode)
            spawn_id, spawn = int(self._evaluation.spawn_id[entry]), self._evaluation.position[entry]
        else:
            spawn_id, spawn = humans.training_spawn(human, self.spawns[0], discs, rng)
        return spawn_id, humans.outside(spawn[None], discs)[0], discs

    def _random_points(self, spawn: Array, goals: Array, rng: np.random.Generator) -> Array:
        """Return two points (2, 3) m, clear of `goals` (M, 3) m, of each other and of a human at spawn (2,)."""
        for _ in range(ATTEMPTS):
            radius, height = rng.uniform(*POINT_RADIUS_M, 2), rng.uniform(*POINT_HEIGHT_M, 2)
            bearing = rng.uniform(-np.pi, np.pi, 2)
            points = np.stack([radius * np.cos(bearing), radius * np.sin(bearing), height], axis=-1)
            from_tables = np.linalg.norm(points[:, None] - goals, axis=-1).min()
            apart = np.linalg.norm(points[0] - points[1])
            from_human = np.linalg.norm(points[:, :2] - spawn, axis=-1).min()
            if min(from_tables, apart) > TABLE_CLEARANCE_M and from_human >= self._config.human.keep_out_m:
                return points
        raise ConfigError(f"no free points found near a human at {spawn.round(2).tolist()}")


def raised(centres: Array, rise: Array) -> Array:
    """Return the `centres` (..., kinds, 3) m of objects higher by the `rise` (kinds,) m of each kind."""
    higher = centres.copy()
    higher[..., 2] += rise
    return higher
