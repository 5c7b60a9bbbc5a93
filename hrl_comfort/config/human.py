"""Configuration of the human: motion, spawn points and observation."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from hrl_comfort.config.checks import XY, ConfigError, between, choice, first_error, within

MOST_PEOPLE = 3
"""Largest number of people in a cell."""
COMMON = ("others", "clipping", "partitioned")
"""Keys that are the same for all people of a cell."""


@dataclass(frozen=True)
class HumanConfig:
    """The people beside the robot; metres, cell frame. The keys are those of the first, and of `others` by default."""

    motion: str
    """A built-in motion, a motion that an installed package offers as an entry point (both by name), or
    `package.module:name`."""
    spawns_m: Annotated[list[XY], Field(min_length=1)]
    """Spawn points (x, y), m: where people start. Those within `keep_out_m` of a goal or the base are moved out. The
    default is the 19 points of the paper authors' scene; counted from 0, points 3 and 10 are the same."""
    held_out: list[int]
    """Indices into `spawns_m`, from 0, at which no training episode starts: the unseen spawn points of the evaluation
    set."""
    spawn: Annotated[str, choice("points", "anywhere", "mixed")]
    """Start of the person in training. `points`: at a point that is not held out. `anywhere`: around the robot.
    `mixed`: half of the episodes each."""
    spawn_jitter_m: Annotated[float, within(0.0, 0.5)]
    """`spawn=points`, `mixed`: the start is drawn uniformly from a disc around a spawn point; this is the disc's
    radius, m."""
    spawn_radius_m: XY
    """`spawn=anywhere`, `mixed`: smallest and largest distance of a start from the robot's base, m."""
    spawn_margin_m: Annotated[float, within(0.0, 0.5)]
    """Smallest distance of training starts from held-out points, m."""
    keep_out_m: Annotated[float, within(0.0, 1.0)]
    """The person's axis stays out of discs around all goals and the robot's base; this is their radius, m. `adversary`,
    `recorded` and `live` ignore the discs."""
    bound_m: Annotated[float, within(0.0, 10.0)]
    """`random_walk`, `arc`, `approach`, and `patrol` with `acceleration_m_s2=null`: largest distance from the spawn
    point, m."""
    jitter_m: Annotated[float, within(0.0, 0.1)]
    """`random_walk`, `arc`: largest random displacement in one control step, along x and along y, m."""
    forward_m: Annotated[float, within(0.0, 0.1)]
    """`random_walk`, `arc`: length of a step towards the robot, m."""
    forward_probability: Annotated[float, within(0.0, 1.0)]
    """`random_walk`, `arc`: probability that the person moves `forward_m` towards the robot in a control step."""
    arc_deg: Annotated[float, within(0.0, 360.0)]
    """`arc`: angle of the arc, degrees."""
    arc_steps: Annotated[int, within(1, 100_000)]
    """`arc`: control steps for the arc in one direction."""
    speed_m_s: Annotated[float, within(0.0, 3.0)]
    """`approach`: walking speed, m/s. `live`, `patrol`, `worker`, `reactive`, `fetcher`, `adversary`: largest speed,
    m/s."""
    acceleration_m_s2: Annotated[float, within(0.1, 20.0)] | None
    """`patrol`, `worker`, `reactive`, `fetcher`, `adversary`: largest acceleration, m/s². null, for `patrol` only,
    lets it change its speed at once."""
    curiosity: Annotated[float, within(0.0, 1.0)]
    """`reactive`: at 0 the person is afraid of the moving arm, at 0.5 they make way for it as for another person, at 1
    they come to look at the tool."""
    mixture: dict[str, dict[str, Any]]
    """`mixture`: the motions, each with the `human` values to change for it, such as `{patrol: {speed_m_s: 1.2}}`; each
    episode draws one of these motions."""
    others: dict[str, dict[str, Any]]
    """Further people, by a name that says who they are, each with the `human` values to change for them, such as
    `{colleague: {motion: patrol}}`; there are at most three people in all. `clipping` and `partitioned` are the same
    for all of them, and only the first can be moved by hand."""
    partitioned: bool
    """Whether `train`, `validation` and `test` each have their own traits of people, recordings and arm starts. If so,
    training sees those of `train` alone."""
    file: str | None
    """`recorded`: a CSV of t (s), x (m), y (m) and yaw (rad), a BVH file, or a folder of such files. `live`:
    udp://HOST:PORT, lsl:NAME or package.module:callable; null is the person that viewers of `hrl-comfort studio`
    move."""
    clipping: Annotated[str, choice("off", "full", "partial")]
    """Position of the person that policies observe. `off`: the true one. `full`: the spawn point nearest to the person.
    `partial`: whichever of these two is nearer to the robot."""
    stations_m: Annotated[list[XY], Field(min_length=1)] | None
    """Stations (x, y), m: `worker` uses the one nearest to its spawn point, others use all. null:
    those of the cell."""
    stay_s: Annotated[float, within(0.1, 3600.0)]
    """`patrol`, `reactive`, `fetcher`: mean time at a station, s."""

    def __post_init__(self) -> None:
        for index in self.held_out:
            between("human.held_out", index, 0, len(self.spawns_m) - 1)
        if len(set(self.held_out)) >= len(self.spawns_m):
            raise ConfigError(f"human.held_out={list(self.held_out)!r} leaves no spawn for training")
        between("human.spawn_radius_m[0]", self.spawn_radius_m[0], 0.0, self.spawn_radius_m[1])
        if self.motion == "patrol" and self.speed_m_s == 0.0:
            raise ConfigError("human.speed_m_s=0: motion=patrol walks; choose a speed above 0")
        if self.motion in ("worker", "reactive", "fetcher", "adversary") and self.acceleration_m_s2 is None:
            raise ConfigError(f"human.acceleration_m_s2=null: motion={self.motion} needs a largest acceleration")
        if self.motion == "recorded" and self.file is None:
            raise ConfigError("human.file=null: motion=recorded needs a CSV of t,x,y,yaw, a BVH file or a folder")
        if (self.motion == "mixture") != bool(self.mixture):
            raise ConfigError(f"human.mixture={list(self.mixture)}: motion=mixture draws from it, and no other motion")
        if "mixture" in self.mixture:
            raise ConfigError("human.mixture.mixture: a mixture cannot hold another")
        if "none" in self.mixture:
            raise ConfigError("human.mixture.none: nobody has no distance; leave it out, or choose human=none")
        if self.mixture:
            assert self.people
        if self.others:
            self._check_others()

    def _check_others(self) -> None:
        if len(self.others) >= MOST_PEOPLE:
            raise ConfigError(
                f"human.others={list(self.others)} are {1 + len(self.others)} people with the first; a cell has "
                f"{MOST_PEOPLE} at most"
            )
        if self.motion == "none":
            raise ConfigError(f"human.others={list(self.others)}: motion=none is nobody; choose a motion for the first")
        for name, each in zip(self.others, self.everyone[1:], strict=True):
            if each.motion == "none":
                raise ConfigError(f"human.others.{name}.motion=none is nobody; leave them out")
            if each.motion == "live" and each.file is None:
                raise ConfigError(f"human.others.{name}.file=null: only the first can be moved by hand; give a source")

    @cached_property
    def people(self) -> list[HumanConfig]:
        """The configuration of each motion of the mixture.

        Raises:
          ConfigError: a value of one is not allowed.
        """
        fixed = ("motion", "mixture", "others")
        return [
            self._changed(f"human.mixture.{name}", changes, fixed, motion=name, mixture={})
            for name, changes in self.mixture.items()
        ]

    @cached_property
    def everyone(self) -> list[HumanConfig]:
        """The configuration of each person, the first before the others, who have none themselves.

        Raises:
          ConfigError: a value of one is not allowed.
        """
        found = [replace(self, others={})]
        for name, changes in self.others.items():
            plain = changes.get("motion", "mixture") != "mixture"  # one of a motion has no mixture
            given = {"mixture": {}, **changes} if plain else changes
            found.append(self._changed(f"human.others.{name}", given, COMMON))
        return found

    @property
    def motions(self) -> str:
        """The motions of all people, as tables have them: `worker+patrol`."""
        return "+".join(each.motion for each in self.everyone)

    def _changed(self, key: str, changes: dict[str, Any], fixed: tuple[str, ...], **implied: Any) -> HumanConfig:
        """Return this configuration of one person with `changes`, which `key` names, of none of the keys `fixed`.

        Raises:
          ConfigError: a key cannot be changed, or a value is not allowed.
        """
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        among = "for a motion of a mixture" if implied else "for one of several people"
        for name in changes:
            if name not in own or name in fixed:
                raise ConfigError(f"{key}.{name} cannot be changed {among}")
        text = json.dumps({**own, "others": {}, **changes, **implied})
        try:
            return TypeAdapter(HumanConfig).validate_json(text, strict=True)
        except ValidationError as error:
            raise ConfigError(f"{key}: {first_error(error)}") from None
