"""Configuration of the human: motion, spawn points and observation."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from hrl_comfort.config.checks import XY, ConfigError, between, choice, first_error, within


@dataclass(frozen=True)
class HumanConfig:
    """The human beside the robot; metres, cell frame."""

    motion: str
    """A key of `humans.MOTIONS`, an entry point or `package.module:name`; it is checked when it is looked up."""
    spawns_m: Annotated[list[XY], Field(min_length=1)]
    """Spawn points (x, y), m; those within `keep_out_m` of a goal are moved out. By default those of the authors'
    scene, where points 3 and 10 are the same."""
    held_out: list[int]
    """Indices into `spawns_m` that training never uses; they are the unseen spawns of the evaluation set."""
    spawn: Annotated[str, choice("points", "anywhere", "mixed")]
    """Training spawns: a point that is not held out, a random position around the robot, or either at 50 %."""
    spawn_jitter_m: Annotated[float, within(0.0, 0.5)]
    """`spawn=points`: the spawn is uniform in a disc of this radius around the point, m."""
    spawn_radius_m: XY
    """`spawn=anywhere`: smallest and largest distance from the robot's base, m."""
    spawn_margin_m: Annotated[float, within(0.0, 0.5)]
    """Smallest distance of training spawns from held-out points, m."""
    keep_out_m: Annotated[float, within(0.0, 1.0)]
    """Smallest distance of the human's axis from any goal and the robot's base, m."""
    bound_m: Annotated[float, within(0.0, 10.0)]
    """Largest distance from the spawn point, m."""
    jitter_m: Annotated[float, within(0.0, 0.1)]
    """`random_walk`, `arc`: largest random displacement a control step along x and along y, m."""
    forward_m: Annotated[float, within(0.0, 0.1)]
    """`random_walk`, `arc`: length of a step towards the robot, m."""
    forward_probability: Annotated[float, within(0.0, 1.0)]
    """`random_walk`, `arc`: probability that a control step is such a step."""
    arc_deg: Annotated[float, within(0.0, 360.0)]
    """`arc`: angle of the arc, degrees."""
    arc_steps: Annotated[int, within(1, 100_000)]
    """`arc`: control steps for the arc in one direction."""
    speed_m_s: Annotated[float, within(0.0, 3.0)]
    """`approach`: walking speed, m/s. `live`, `patrol`, `worker`, `reactive`, `adversary`: its limit."""
    acceleration_m_s2: Annotated[float, within(0.1, 20.0)] | None
    """`patrol`, `worker`, `reactive`, `adversary`: largest acceleration, m/s². null: `patrol` jumps to its speed."""
    curiosity: Annotated[float, within(0.0, 1.0)]
    """`reactive`: 0 is afraid of the moving arm, 0.5 yields to it as to a person, 1 goes to look at the tool."""
    mixture: dict[str, dict[str, Any]]
    """`mixture`: motions, one of which is drawn for each episode, and the values of this section that each changes."""
    partitioned: bool
    """Each split (`train`, `validation`, `test`) has its own sectors around the robot, traits of people, recordings and
    arm starts; training sees only those of `train`."""
    file: str | None
    """`recorded`: CSV of t, x, y, yaw in s, m, m, rad, BVH file, or folder of such files. `live`: udp://HOST:PORT,
    lsl:NAME or package.module:callable; null is the person of `hrl-comfort studio`."""
    clipping: Annotated[str, choice("off", "full", "partial")]
    """Policies observe the spawn point nearest to the human instead: never, always, or if it is nearer to the robot."""
    masked: bool
    """Hide the human from the policy, which then observes one far away."""
    stations_m: list[XY]
    """Stations (x, y), m: `worker` uses the one nearest to the spawn, `patrol` and `reactive` all."""
    stay_s: Annotated[float, within(0.1, 3600.0)]
    """`patrol`, `reactive`: mean time at a station, s."""

    def __post_init__(self) -> None:
        for index in self.held_out:
            between("human.held_out", index, 0, len(self.spawns_m) - 1)
        if len(set(self.held_out)) >= len(self.spawns_m):
            raise ConfigError(f"human.held_out={list(self.held_out)!r} leaves no spawn for training")
        between("human.spawn_radius_m[0]", self.spawn_radius_m[0], 0.0, self.spawn_radius_m[1])
        if self.motion in ("worker", "patrol", "reactive") and not self.stations_m:
            raise ConfigError(f"human.stations_m=[]: motion={self.motion} needs at least one place")
        if self.motion == "patrol" and self.speed_m_s == 0.0:
            raise ConfigError("human.speed_m_s=0: motion=patrol walks; choose a speed above 0")
        if self.motion in ("worker", "reactive", "adversary") and self.acceleration_m_s2 is None:
            raise ConfigError(f"human.acceleration_m_s2=null: motion={self.motion} needs a largest acceleration")
        if self.motion == "recorded" and self.file is None:
            raise ConfigError("human.file=null: motion=recorded needs a CSV of t,x,y,yaw, a BVH file or a folder")
        if (self.motion == "mixture") != bool(self.mixture):
            raise ConfigError(f"human.mixture={list(self.mixture)}: motion=mixture draws from it, and no other motion")
        if "mixture" in self.mixture:
            raise ConfigError("human.mixture.mixture: a mixture cannot hold another")
        if self.mixture:
            assert self.people

    @cached_property
    def people(self) -> list[HumanConfig]:
        """The configuration of each motion of the mixture.

        Raises:
          ConfigError: a value of one is not allowed.
        """
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        found = []
        for name, changes in self.mixture.items():
            for key in changes:
                if key not in own or key in ("motion", "mixture"):
                    raise ConfigError(f"human.mixture.{name}.{key} cannot be changed for a motion of a mixture")
            text = json.dumps({**own, **changes, "motion": name, "mixture": {}})
            try:
                found.append(TypeAdapter(HumanConfig).validate_json(text, strict=True))
            except ValidationError as error:
                raise ConfigError(f"human.mixture.{name}: {first_error(error)}") from None
        return found
