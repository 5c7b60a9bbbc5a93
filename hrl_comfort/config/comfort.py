"""How the comfort of the person counts, and where their level comes from."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from hrl_comfort.config.checks import ConfigError, between, one_of, point

SOURCES = ("none", "fixed", "random", "changing", "schedule", "file", "udp", "lsl", "simulated")
FORMS = ("paper", "reference", "linear", "logarithmic", "target_distance", "target_distance_one_sided")
THRESHOLDS = ("range", "reference", "levels")
DISTANCES = ("tool", "arm")
LATEST_S = 1e9
SPEED_FORMS = ("paper", "hinge")


@dataclass(frozen=True)
class StreamConfig:
    """A live stream of numbers (heart rate, say) that stand for comfort: `source=udp`, `lsl` or `file`."""

    low: float
    """Value that means level 1, the least comfortable."""
    high: float
    """Value that means level N_c. It may be below `low`, as with a heart rate."""
    tolerance: float
    """Share of the range by which a value may lie beyond it; farther out it is rubbish and not used."""
    smoothing_s: float
    """Time constant of the exponential smoothing; 0 takes each value as it comes."""
    stall_s: float
    """The last good value holds for so long; then the most cautious level, 1, is in force."""
    host: str
    port: int
    """`udp`: where to listen for datagrams, each one number in ASCII; port 0 takes a free one."""
    name: str
    """`lsl`: name of the stream, of which the first channel is read."""

    def __post_init__(self) -> None:
        between("comfort.stream.low", self.low, -1e9, 1e9)
        between("comfort.stream.high", self.high, -1e9, 1e9)
        if self.low == self.high:
            raise ConfigError(f"comfort.stream.high={self.high!r} must differ from comfort.stream.low")
        between("comfort.stream.tolerance", self.tolerance, 0.0, 10.0)
        between("comfort.stream.smoothing_s", self.smoothing_s, 0.0, 3600.0)
        between("comfort.stream.stall_s", self.stall_s, 0.0, 3600.0)
        between("comfort.stream.port", self.port, 0, 65535)


@dataclass(frozen=True)
class PersonConfig:
    """`source=simulated`: somebody whose level falls with the robot's closeness and speed and recovers."""

    near_m: float
    """Horizontal distance to the tool within which its closeness tells."""
    fast_m_s: float
    """Speed of the tool that tells in full."""
    stress_s: float
    """Time in which a fast tool at arm's length takes the level from highest to lowest."""
    recovery_s: float
    """Time constant in which the level recovers."""

    def __post_init__(self) -> None:
        between("comfort.person.near_m", self.near_m, 0.01, 10.0)
        between("comfort.person.fast_m_s", self.fast_m_s, 0.01, 10.0)
        between("comfort.person.stress_s", self.stress_s, 0.01, 3600.0)
        between("comfort.person.recovery_s", self.recovery_s, 0.01, 3600.0)


@dataclass(frozen=True)
class ComfortConfig:
    """What is paid for the person's comfort (docs/comfort.md), and the source of their level."""

    levels: int
    """N_c. Level 1 is the least comfortable, the robot most cautious; N_c the most."""
    source: str
    """`none`: comfort is measured, but neither observed nor rewarded. Else, where the level comes from."""
    level: int | None
    """`source=fixed`: the level."""
    change_s: float
    """`source=changing`: mean time between two changes within an episode."""
    schedule_s: list[float]
    """`source=schedule`: times from the episode's start, the first 0, at which levels come into force."""
    schedule_levels: list[int]
    file: str | None
    """`source=file`: a recorded CSV with columns t (s) and value, mapped as `stream` says."""
    form: str
    threshold: str
    distance: str
    """`tool`: horizontal, tool to the human's axis. `arm`: smallest between any link and any body part."""
    min_m: float
    max_m: float
    """Range of distances, d_min and d_max of the threshold."""
    power: float
    """`form=target_distance`: 1 weighs every centimetre from the preferred distance alike, 2 the far ones more."""
    time_penalty: float
    """`form=target_distance`: what a control step costs beside somebody wholly at ease, before alpha and scale."""
    alpha: float
    """Weight of the distance term, F_conf1."""
    beta: float
    """Weight of the speed term, F_conf2."""
    speed_form: str
    scale: float
    """F_comfort is added to the reward of every control step, times this; negative subtracts (Eq. 1)."""
    stream: StreamConfig
    person: PersonConfig

    def __post_init__(self) -> None:
        between("comfort.levels", self.levels, 2, 1000)
        one_of("comfort.source", self.source, SOURCES)
        if self.source == "fixed" and self.level is None:
            raise ConfigError(f"comfort.level=null: comfort.source=fixed needs one of 1 to {self.levels}")
        if self.level is not None:
            between("comfort.level", self.level, 1, self.levels)
            if self.source != "fixed":
                raise ConfigError(f"comfort.level={self.level} goes with comfort.source=fixed, not {self.source}")
        between("comfort.change_s", self.change_s, 0.1, 3600.0)
        self._check_schedule()
        if self.source == "file" and self.file is None:
            raise ConfigError("comfort.file=null: comfort.source=file needs a CSV of t,value")
        one_of("comfort.form", self.form, FORMS)
        one_of("comfort.threshold", self.threshold, THRESHOLDS)
        one_of("comfort.distance", self.distance, DISTANCES)
        between("comfort.max_m", self.max_m, 0.01, 10.0)
        between("comfort.min_m", self.min_m, 0.0, self.max_m - 0.001)
        between("comfort.power", self.power, 0.5, 8.0)
        between("comfort.time_penalty", self.time_penalty, 0.0, 10.0)
        between("comfort.alpha", self.alpha, 0.0, 1.0)
        between("comfort.beta", self.beta, 0.0, 1.0)
        one_of("comfort.speed_form", self.speed_form, SPEED_FORMS)
        between("comfort.scale", self.scale, -100.0, 100.0)
        if self.source == "none" and self.scale != 0:
            raise ConfigError(f"comfort.scale={self.scale} pays by the level: choose a comfort.source")

    def _check_schedule(self) -> None:
        times, levels = list(self.schedule_s), list(self.schedule_levels)
        if self.source == "schedule" and not times:
            raise ConfigError("comfort.schedule_s=[] must hold times, the first 0, such as [0,2]")
        if len(times) != len(levels):
            raise ConfigError(f"comfort.schedule_levels={levels} must be as many as comfort.schedule_s={times}")
        point("comfort.schedule_s", times, len(times), LATEST_S)
        if times and (times[0] != 0 or any(after <= before for before, after in pairwise(times))):
            raise ConfigError(f"comfort.schedule_s={times} must start at 0 and rise")
        for level in levels:
            between("comfort.schedule_levels", level, 1, self.levels)
