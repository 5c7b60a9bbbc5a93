"""Configuration of comfort: source of the level and terms of the reward."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from hrl_comfort.config.checks import ConfigError, between, choice, named, within

SOURCES = (
    "none", "fixed", "random", "changing", "schedule", "file", "udp", "lsl", "simulated", "frightened", "fitted",
)  # fmt: skip
FORMS = (
    "paper",
    "reference",
    "linear",
    "logarithmic",
    "target_distance",
    "target_distance_one_sided",
    "minimum_distance",
)
THRESHOLDS = ("range", "reference", "levels")
DISTANCES = ("tool", "arm", "avoidable")
SPEED_FORMS = ("paper", "hinge")


@dataclass(frozen=True)
class StreamConfig:
    """Conversion of a signal (heart rate, for example) to levels, for `source=udp`, `lsl` and `file`."""

    low: Annotated[float, within(-1e9, 1e9)]
    """Value of level 1, in the unit of the signal."""
    high: Annotated[float, within(-1e9, 1e9)]
    """Value of level N_c, in the unit of the signal; it may be below `low`."""
    tolerance: Annotated[float, within(0.0, 10.0)]
    """Share of the range by which a value may lie outside of [low, high]; values farther out are ignored."""
    smoothing_s: Annotated[float, within(0.0, 3600.0)]
    """Time constant of the exponential smoothing, s; 0 is none."""
    stall_s: Annotated[float, within(0.0, 3600.0)]
    """Time without a good value, s, after which the level is 1; until then the last good value holds."""
    host: str
    """`udp`: host to listen on."""
    port: Annotated[int, within(0, 65535)]
    """`udp`: port to listen on, for datagrams of one ASCII number each; 0 is a free port."""
    name: str
    """`lsl`: name of the stream, which must have one channel, of numbers."""

    def __post_init__(self) -> None:
        if self.low == self.high:
            raise ConfigError(f"comfort.stream.high={self.high!r} must differ from comfort.stream.low")


@dataclass(frozen=True)
class PersonConfig:
    """The simulated human of `source=simulated` and `frightened`."""

    near_m: Annotated[float, within(0.01, 10.0)]
    """Distance below which the robot causes stress, m. `simulated`: horizontal, of the tool. `frightened`: of the
    nearest link."""
    fast_m_s: Annotated[float, within(0.01, 10.0)]
    """Tool speed above which more speed adds no stress, m/s."""
    stress_s: Annotated[float, within(0.01, 3600.0)]
    """Time T, s. Under full stress and without recovery the level falls from N_c to 1 in T (`frightened`) or in T/2
    (`simulated`)."""
    recovery_s: Annotated[float, within(0.01, 3600.0)]
    """Time constant with which the level returns to N_c, s."""


@dataclass(frozen=True)
class ComfortConfig:
    """Source of the comfort level and F_comfort, its reward term (docs/comfort.md)."""

    levels: Annotated[int, within(2, 1000)]
    """N_c, the number of levels. At level 1 the robot is most cautious, at N_c least."""
    source: Annotated[str, choice(*SOURCES)]
    """Source of the level; with `none`, comfort is measured but neither observed nor rewarded."""
    level: int | None
    """`source=fixed`: the level."""
    change_s: Annotated[float, within(0.1, 3600.0)]
    """`source=changing`: mean time between two changes, s."""
    schedule_s: list[Annotated[float, within(0.0, 1e9)]]
    """`source=schedule`: rising start times of the levels, s from the start of the episode; the first is 0."""
    schedule_levels: list[int]
    """`source=schedule`: the levels."""
    file: str | None
    """`source=file`: CSV with columns t (s) and value."""
    form: Annotated[str, named("comfort.form", *FORMS)]
    """Form of the distance term, F_conf1."""
    threshold: Annotated[str, named("comfort.threshold", *THRESHOLDS)]
    """Distance threshold theta as a function of the level."""
    distance: Annotated[str, choice(*DISTANCES)]
    """Distance in the term. `tool`: horizontal, from the tool to the person's axis. `arm`: the smallest between any
    link and any body part. `avoidable`: as `arm`, but what an arm at home would lose costs nothing."""
    min_m: float
    """d_min of the threshold, m; below `max_m`."""
    max_m: Annotated[float, within(0.01, 10.0)]
    """d_max of the threshold, m."""
    power: Annotated[float, within(0.5, 8.0)]
    """`target_distance` forms and `minimum_distance`: exponent of the normalised error of distance."""
    time_penalty: Annotated[float, within(0.0, 10.0)]
    """`target_distance` forms and `minimum_distance`: amount subtracted from F_conf1 in every control step at level
    N_c; the amount decreases linearly with the level, to 0 at level 1."""
    alpha: Annotated[float, within(0.0, 1.0)]
    """Weight of the distance term, F_conf1 (Eq. 4 of the paper)."""
    beta: Annotated[float, within(0.0, 1.0)]
    """Weight of the speed term, F_conf2 (Eq. 4 of the paper)."""
    speed_form: Annotated[str, named("comfort.speed_form", *SPEED_FORMS)]
    """Form of the speed term, F_conf2."""
    scale: Annotated[float, within(-100.0, 100.0)]
    """Weight of F_comfort (alpha F_conf1 + beta F_conf2) in the reward of every control step. If it is negative,
    F_comfort is subtracted, as in Eq. 1 of the paper."""
    stream: StreamConfig
    person: PersonConfig

    def __post_init__(self) -> None:
        if self.source == "fixed" and self.level is None:
            raise ConfigError(f"comfort.level=null: comfort.source=fixed needs one of 1 to {self.levels}")
        if self.level is not None:
            between("comfort.level", self.level, 1, self.levels)
            if self.source != "fixed":
                raise ConfigError(f"comfort.level={self.level} goes with comfort.source=fixed, not {self.source}")
        if self.source == "file" and self.file is None:
            raise ConfigError("comfort.file=null: comfort.source=file needs a CSV of t,value")
        between("comfort.min_m", self.min_m, 0.0, self.max_m - 0.001)
        if self.source == "none" and self.scale != 0:
            raise ConfigError(f"comfort.scale={self.scale} needs a level: choose a comfort.source, or comfort.scale=0")
        self._check_schedule()

    def _check_schedule(self) -> None:
        times, levels = list(self.schedule_s), list(self.schedule_levels)
        if self.source == "schedule" and not times:
            raise ConfigError("comfort.schedule_s=[] must hold times, the first 0, such as [0,2]")
        if len(times) != len(levels):
            raise ConfigError(f"comfort.schedule_levels={levels} must have the length of comfort.schedule_s={times}")
        if times and (times[0] != 0 or any(after <= before for before, after in pairwise(times))):
            raise ConfigError(f"comfort.schedule_s={times} must start at 0 and rise")
        for level in levels:
            between("comfort.schedule_levels", level, 1, self.levels)
