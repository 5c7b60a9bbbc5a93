"""A streamer in simulated time with faults of every kind, and the person and the level beside it."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from hrl_comfort.comfort.sources import Live
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, DeployConfig
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.runner import Run
from hrl_comfort.deploy.streamer import TICKS, Limits, Report
from hrl_comfort.scene.workcell import Scene, build_scene
from hrl_comfort.streams import UdpStream
from tests.deploy.faulty_arm import FaultyArm

Array = NDArray[np.float64]
REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference" / "shielded" / "seed2"
BEHIND = [
    "task.observation=sight",
    "safety.clearance_m=0.01",
    "task.arrival_speed_rad_s=0.5",
    "task.terminate_on=unsafe_contact",
]
LEVELS = ["comfort=conditioned", "comfort.source=udp", "comfort.stream.port=0", "comfort.stream.stall_s=0.1"]
FAST_M_S = 0.4
"""Speed of the arm from which a person who comes near makes the shield brake."""
AWAY, NEAR_M, JUMP_M = (1.5, 0.5), 0.5, 0.1
"""Place of the person, their distance from the tool when they come near, and their jumps in a control step then."""


class Clock:
    """Simulated time, and what happens in it."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        self.now = 1000.0
        self.place: tuple[float, float] | None = AWAY
        self.slept: Callable[[], None] = lambda: None

    def monotonic(self) -> float:
        return self.now

    def sleep(self, time_s: float) -> None:
        self.now += time_s
        self.slept()


CLOCK = Clock()


def place() -> tuple[float, float] | None:
    """Return where the person is now; None without a new position."""
    return CLOCK.place


TIMED = [
    f"hrl_comfort.{name}.time" for name in ("deploy.links", "deploy.streamer", "deploy.robot", "humans.motions.live")
]
"""Modules that read the clock."""


@contextmanager
def simulated_time() -> Iterator[Clock]:
    CLOCK.begin()
    with ExitStack() as stack:
        for name in TIMED:
            stack.enter_context(patch(name, CLOCK))
        yield CLOCK


@cache
def config(kind: str) -> DeployConfig:
    more = LEVELS if kind == "stale level" else []
    fixed = ["task=pick", f"policy={REFERENCE / 'pick'}", "human=live", "confirm=yes", "output=none"]
    found = compose("deploy", [*fixed, "human.file=tests.deploy.faulty_link:place", *BEHIND, *more])
    assert isinstance(found, DeployConfig)
    return found


@cache
def cell() -> tuple[Scene, Limits]:
    asked = config("limit")
    scene = build_scene(asked.robot, asked.cell, 10)
    return scene, Limits.of(asked, scene)


class FaultyLink(Lockstep):
    """A streamer in simulated time; from the control step `at` on there is a fault of the `kind`."""

    def __init__(self, kind: str, at: int, start: Array, log: Path) -> None:
        scene, limits = cell()
        fault = {"lost connection": "connection"}.get(kind, kind)
        tick = TICKS * at + int(np.random.default_rng(at).integers(TICKS))
        super().__init__(partial(FaultyArm, scene.model, start, fault, tick), limits, log)
        self.run: Run | None = None
        self._kind, self._left, self._fault = kind, at, False

    def step(self, target: Array) -> Report:
        CLOCK.now += CONTROL_STEP_S
        self._left -= 1
        arm = cell()[1].arm
        fast = arm.speeds(arm.pose(self.report.point[None]), self.report.velocity[None]).max() > FAST_M_S
        self._fault |= self._left <= 0 and bool(fast or self._kind != "shield at zero")
        if self._kind.endswith("stale level") and not self._fault:
            self.tell_level()
        if self._fault and self._kind == "shield at zero":
            x, y, _ = arm.tool(self.report.point[None])[0]
            outward = 1 + (NEAR_M + JUMP_M * (self._left % 2)) / float(np.hypot(x, y))
            CLOCK.place = float(x) * outward, float(y) * outward
        if self._fault and self._kind == "stale person":
            CLOCK.place = None
        if self._fault and self._kind == "late cycle":
            for _ in range(2):
                self._late()
            return self.report
        return super().step(target + 9.0 if self._fault and self._kind == "limit" else target)

    def interrupted(self) -> bool:
        return self._fault and self._kind == "interrupted"

    def _late(self) -> None:
        self._streamer.begin_step(None, late=True)
        self.report = self._streamer.report()
        for number in range(TICKS):
            self._streamer.tick(number)

    def tell_level(self) -> None:
        """Send a level to the source of the run, which reads the simulated clock."""
        assert self.run is not None
        levels = self.run._engine.episodes.source.levels
        assert isinstance(levels, Live) and isinstance(levels.stream, UdpStream)
        levels._signal._clock = CLOCK.monotonic
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"0.5", ("127.0.0.1", levels.stream.port))
