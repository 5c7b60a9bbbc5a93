"""Who walks beside the robot."""

from __future__ import annotations

from dataclasses import dataclass

from hrl_comfort.config.checks import ConfigError, between, one_of, point

CLIPPINGS = ("off", "full", "partial")
SPAWNS = ("points", "anywhere", "mixed")


@dataclass(frozen=True)
class HumanConfig:
    """Who walks beside the robot, how, and what the policy is told of it."""

    motion: str
    """A key of `people.motions.MOTIONS`, which checks it."""
    spawns_m: list[list[float]]
    """Spawn points (x, y), metres. Points nearer to a goal than `keep_out_m` are moved out to it."""
    held_out: list[int]
    """Indices into `spawns_m` that training never uses; the evaluation set uses them as unseen."""
    spawn: str
    """In training: `points` draws a spawn point that is not held out, `anywhere` a place round the robot,
    `mixed` either, half the time each."""
    spawn_jitter_m: float
    """At points, a spawn is drawn uniformly from a disc of this radius round its point."""
    spawn_radius_m: list[float]
    """Anywhere: nearest and farthest distance from the robot's base."""
    spawn_margin_m: float
    """In training, least distance from every held-out point, so that these stay unseen."""
    keep_out_m: float
    """Least distance between the human's axis and any goal or the robot's base."""
    bound_m: float
    """Farthest the human strays from its spawn point."""
    jitter_m: float
    """`random_walk`, `arc`: largest random horizontal displacement a control step, each axis."""
    forward_m: float
    """`random_walk`: displacement of an occasional step forward, towards the robot."""
    forward_probability: float
    arc_deg: float
    arc_steps: int
    speed_m_s: float
    """`approach`, `work`, `patrol`: walking speed."""
    file: str | None
    """`playback`: CSV of t, x, y, yaw in s, m, m, rad, cell frame."""
    clipping: str
    masked: bool
    """True hides the human from the policy: it sees one standing far away."""
    stations_m: list[list[float]]
    """`work`: places (x, y) of which the one nearest to the spawn point is where the person works, metres;
    `patrol`: all of which they work at."""
    stay_s: float
    """`patrol`: mean time at a place, s."""

    def __post_init__(self) -> None:
        one_of("human.clipping", self.clipping, CLIPPINGS)
        if not self.spawns_m:
            raise ConfigError("human.spawns_m=[] must hold at least one point")
        for i, spawn in enumerate(self.spawns_m):
            point(f"human.spawns_m[{i}]", spawn, 2)
        for i in self.held_out:
            between("human.held_out", i, 0, len(self.spawns_m) - 1)
        if len(set(self.held_out)) >= len(self.spawns_m):
            raise ConfigError(f"human.held_out={list(self.held_out)!r} leaves no spawn for training")
        one_of("human.spawn", self.spawn, SPAWNS)
        point("human.spawn_radius_m", self.spawn_radius_m, 2)
        between("human.spawn_radius_m[0]", self.spawn_radius_m[0], 0.0, self.spawn_radius_m[1])
        between("human.spawn_margin_m", self.spawn_margin_m, 0.0, 0.5)
        between("human.spawn_jitter_m", self.spawn_jitter_m, 0.0, 0.5)
        between("human.keep_out_m", self.keep_out_m, 0.0, 1.0)
        between("human.bound_m", self.bound_m, 0.0, 10.0)
        between("human.jitter_m", self.jitter_m, 0.0, 0.1)
        between("human.forward_m", self.forward_m, 0.0, 0.1)
        between("human.forward_probability", self.forward_probability, 0.0, 1.0)
        between("human.arc_deg", self.arc_deg, 0.0, 360.0)
        between("human.arc_steps", self.arc_steps, 1, 100_000)
        between("human.speed_m_s", self.speed_m_s, 0.0, 3.0)
        for i, station in enumerate(self.stations_m):
            point(f"human.stations_m[{i}]", station, 2)
        between("human.stay_s", self.stay_s, 0.1, 3600.0)
        if self.motion in ("work", "patrol") and not self.stations_m:
            raise ConfigError(f"human.stations_m=[]: motion={self.motion} needs at least one place")
        if self.motion == "patrol" and self.speed_m_s == 0.0:
            raise ConfigError("human.speed_m_s=0: motion=patrol walks; choose a speed above 0")
        if self.motion == "playback" and self.file is None:
            raise ConfigError("human.file=null: motion=playback needs a CSV of t,x,y,yaw")
