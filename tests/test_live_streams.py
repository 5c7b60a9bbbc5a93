"""Live streams are lost, found again, flooded and of wrong kinds; the robot goes on."""

from __future__ import annotations

import socket
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from hrl_comfort.cli.first_checks import check
from hrl_comfort.comfort.sources import make_source
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EvaluateConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.streams import MOST_DATAGRAMS, LslStream, UdpStream
from tests.comfort.test_comfort_sources import comfort, until

PATIENCE_S = 180.0


def outlet(name: str, channels: int = 1, kind: str = "float32") -> Any:
    import pylsl

    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "HR", channels, 0.0, kind, name))


def wait(there: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not there():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_lab_streaming_layer_outlet_sets_the_level() -> None:
    name = f"hrl-comfort-{time.time_ns()}"
    heart = outlet(name)
    config = comfort("comfort.source=lsl", f"comfort.stream.name={name}", "comfort.stream.high=9",
                     "comfort.stream.smoothing_s=0", "comfort.stream.stall_s=10")  # fmt: skip
    source = make_source(config, 2)
    heart.push_sample([4.0])
    assert (until(source, 5) == 5).all()
    heart.push_sample([float("nan")])
    heart.push_sample([8.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert (until(source, 9) == 9).all()


def test_a_lost_outlet_is_read_again_when_one_of_its_kind_is_back() -> None:
    name = f"hrl-comfort-{time.time_ns()}"
    here: Any = outlet(name)
    stream = LslStream(name, (1,), PATIENCE_S, "key")
    here.push_sample([1.0])
    wait(lambda: stream.read() == [[1.0]])
    del here
    with pytest.warns(UserWarning, match="key: the stream is lost"):
        wait(lambda: stream._inlet is None or stream.read())
    here = outlet(name, 2)
    with pytest.warns(UserWarning, match=r"one has 2 channel\(s\) of numbers, not 1 of numbers: not used"):
        wait(lambda: stream.read() or stream._unfit)
    del here
    here = outlet(name)
    wait(lambda: stream.read() or stream._inlet is not None)
    here.push_sample([2.0])
    wait(lambda: stream.read() == [[2.0]])


@pytest.mark.parametrize(("channels", "kind", "what"), [(1, "string", "text"), (4, "float32", "numbers")])
def test_a_stream_of_a_wrong_kind_is_refused(channels: int, kind: str, what: str) -> None:
    name = f"hrl-comfort-{time.time_ns()}"
    here = outlet(name, channels, kind)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ConfigError, match=rf"one has {channels} channel\(s\) of {what}, not 2 or 3 of numbers"):
            LslStream(name, (2, 3), 2.0, "key")
    del here


def test_a_flood_of_datagrams_does_not_hold_up_a_reading() -> None:
    stream, stop = UdpStream("127.0.0.1", 0, "key"), threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not stop.is_set():
                sender.sendto(b"1" * 1000, ("127.0.0.1", stream.port))

    flood = [threading.Thread(target=send) for _ in range(3)]
    for each in flood:
        each.start()
    try:
        wait(stream.read)
        for _ in range(20):
            assert len(stream.read()) <= MOST_DATAGRAMS
    finally:
        stop.set()
        for each in flood:
            each.join()


def test_realtime_episodes_take_their_time_by_the_wall_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr("hrl_comfort.evaluation.rollout.time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
    words = ["task=reach", "policy=random", "episodes=2", "task.max_episode_steps=40", "realtime=true"]
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    rollout(replace(config, realtime=False))
    assert now == 0.0
    steps = max(episode.steps for episode in rollout(config).episodes)
    assert now == pytest.approx(steps * CONTROL_STEP_S)


def test_live_values_without_realtime_are_warned_of() -> None:
    words = ["policy=random", "comfort=conditioned", "comfort.source=udp"]
    with pytest.warns(UserWarning, match="add realtime=true"):
        check(compose("evaluate", words))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(compose("evaluate", [*words, "realtime=true"]))
