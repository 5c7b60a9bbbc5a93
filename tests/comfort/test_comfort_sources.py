"""Sources give their levels, and no bad stream raises an error."""

from __future__ import annotations

import socket
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hrl_comfort.comfort.frightened import level_rate, mean_level
from hrl_comfort.comfort.sources import DRAWS, SourceInput, make_source
from hrl_comfort.comfort.streams import Signal, read_recording, udp
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ComfortConfig, ConfigError, TrainConfig


def comfort(*overrides: str) -> ComfortConfig:
    config = compose("train", ["comfort=conditioned", *overrides])
    assert isinstance(config, TrainConfig)
    return config.comfort


def at(seconds: float, rows: int, distance_m: float = 1.0, speed_m_s: float = 0.0) -> SourceInput:
    whole = np.ones(rows)
    return SourceInput(seconds * whole, 0.1 * whole, distance_m * whole, speed_m_s * whole, distance_m * whole)


def begun(config: ComfortConfig, rows: int, seed: int = 0):
    source = make_source(config, rows)
    source.draws[:] = np.random.default_rng(seed).random((rows, DRAWS))
    source.begin(np.arange(rows))
    return source


def test_random_levels_are_uniform_and_constant_in_an_episode() -> None:
    source = begun(comfort(), 20_000)
    counts = np.bincount(source.level.astype(int))[1:]
    assert len(counts) == 10 and counts.min() > 1800
    before = source.level.copy()
    assert (source.advance(at(5.0, 20_000)) == before).all()


def test_changing_levels_change_at_their_rate_and_within_range() -> None:
    source = begun(comfort("comfort.source=changing", "comfort.change_s=2"), 2000)
    changes, before = 0, source.level.copy()
    for step in range(1, 101):
        now = source.advance(at(0.1 * step, 2000))
        changes += int((now != before).sum())
        before = now
    assert now.min() >= 1 and now.max() <= 10
    assert changes / 2000 == pytest.approx(5 * 0.9, rel=0.05)  # one in ten draws repeats the level


def test_changing_levels_keep_changing_in_long_episodes() -> None:
    source = begun(comfort("comfort.source=changing", "comfort.change_s=0.1"), 500)
    seen = np.array([source.advance(at(0.01 * step, 500)) for step in range(1, 1001)])
    changes = seen[1:] != seen[:-1]
    assert changes.sum() / 500 == pytest.approx(100 * 0.9, rel=0.1)
    assert changes[-200:].any(axis=0).all(), "a row keeps its level for the last two seconds"


def test_changing_levels_follow_their_draws_in_order() -> None:
    source = begun(comfort("comfort.source=changing", "comfort.change_s=1"), 1)
    levels, lasting = 1 + np.floor(10 * source.draws[0, :16]), -np.log1p(-source.draws[0, 16:])
    middles = np.cumsum(lasting) - lasting / 2
    assert [source.advance(at(t, 1)).item() for t in middles] == levels.tolist()


def test_scheduled_levels_are_in_force_from_their_times_on() -> None:
    source = begun(comfort("comfort.source=schedule", "comfort.schedule_s=[0,2]", "comfort.schedule_levels=[10,1]"), 1)
    assert source.level.item() == 10
    assert source.advance(at(1.9, 1)).item() == 10
    assert source.advance(at(2.0, 1)).item() == 1


def test_begin_changes_the_given_rows_only() -> None:
    source = begun(comfort(), 4)
    before = source.level.copy()
    source.draws[1, 0] = 0.999
    source.begin(np.array([1]))
    assert source.level[1] == 10 and (np.delete(source.level, 1) == np.delete(before, 1)).all()


def test_simulated_level_falls_near_a_fast_robot_and_recovers() -> None:
    source = begun(comfort("comfort.source=simulated"), 1)
    assert source.level.item() == 10
    for _ in range(20):
        source.advance(at(0.0, 1, distance_m=0.2, speed_m_s=1.0))
    assert source.level.item() <= 3
    for _ in range(300):
        source.advance(at(0.0, 1, distance_m=2.0))
    assert source.level.item() == 10


def test_a_near_arm_frightens_when_it_moves_and_not_at_rest() -> None:
    source = begun(comfort("comfort.source=frightened"), 1)
    for _ in range(50):
        source.advance(at(0.0, 1, distance_m=0.1, speed_m_s=0.0))
    assert source.level.item() == 10
    for _ in range(20):
        source.advance(at(0.0, 1, distance_m=0.1, speed_m_s=1.0))
    assert source.level.item() <= 4
    for _ in range(300):
        source.advance(at(0.0, 1, distance_m=0.9, speed_m_s=2.0))
    assert source.level.item() == 10


def test_the_mean_level_of_a_path_is_that_of_the_source_along_it() -> None:
    config, rng = comfort("comfort.source=frightened"), np.random.default_rng(0)
    tool = np.cumsum(rng.normal(0, 0.01, (400, 3)), axis=0)
    arm = rng.uniform(0.0, 1.0, 400)
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=-1) / 0.02
    level, levels = np.full(1, 10.0), []
    for distance, moving in zip(arm[1:], speed, strict=True):
        rate = level_rate(level, np.array([distance]), np.array([moving]), config)
        level = np.clip(level + 0.02 * rate, 1.0, 10.0)
        levels.append(level.item())
    assert mean_level(arm, tool, config) == pytest.approx(np.mean(levels))


def test_a_source_continues_from_its_state() -> None:
    for name in ("random", "changing", "simulated", "frightened"):
        first = begun(comfort(f"comfort.source={name}"), 8)
        first.advance(at(0.5, 8, 0.3, 1.0))
        second = make_source(first.config, 8)
        second.load_state_dict(first.state_dict())
        assert (first.advance(at(3.0, 8, 0.5, 0.2)) == second.advance(at(3.0, 8, 0.5, 0.2))).all()


# ---- signals -------------------------------------------------------------------------------------------


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def signal(clock: Clock, *overrides: str) -> Signal:
    return Signal(comfort("comfort.stream.smoothing_s=0", *overrides), "test", clock)


def test_values_map_to_levels_over_their_range_also_a_falling_one() -> None:
    up = signal(Clock(), "comfort.stream.low=0", "comfort.stream.high=9")
    assert [up.level([value]) for value in (0, 4, 9)] == [1, 5, 10]
    heart = signal(Clock(), "comfort.stream.low=120", "comfort.stream.high=60")
    assert [heart.level([value]) for value in ("120", "60")] == [1, 10]


def test_smoothing_follows_with_its_time_constant() -> None:
    clock = Clock()
    smooth = signal(clock, "comfort.stream.smoothing_s=1", "comfort.stream.high=9")
    assert smooth.level([9]) == 10
    clock.now = 1.0
    assert smooth.level([0]) == round(1 + 9 * np.exp(-1))


def test_of_simultaneous_values_the_newest_counts() -> None:
    clock = Clock()
    smooth = signal(clock, "comfort.stream.smoothing_s=1", "comfort.stream.high=9")
    assert smooth.level([0, 9]) == 10
    clock.now = 1.0
    assert smooth.level([9, 5, 0]) == round(1 + 9 * np.exp(-1))


@pytest.mark.parametrize("bad", ["abc", "", "nan", "inf", "1e9", "-50", "1_0", "\x00\ufffd"])
def test_a_bad_value_keeps_the_last_good_level_and_warns_once(bad: str) -> None:
    stream = signal(Clock(), "comfort.stream.high=9")
    assert stream.level([7]) == 8
    with pytest.warns(UserWarning, match="not used"):
        assert stream.level([bad]) == 8
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert stream.level([bad]) == 8


def test_a_stalled_stream_means_the_most_cautious_level_until_it_is_back() -> None:
    clock = Clock()
    stream = signal(clock, "comfort.stream.high=9", "comfort.stream.stall_s=3")
    assert stream.level([9]) == 10
    clock.now = 2.9
    assert stream.level([]) == 10
    clock.now = 3.1
    with pytest.warns(UserWarning, match="no good value for 3 s"):
        assert stream.level([]) == 1
    assert stream.level([9]) == 10


def test_a_stream_that_has_not_begun_is_not_called_stalled() -> None:
    stream = signal(Clock(), "comfort.stream.high=9")
    with pytest.warns(UserWarning, match="no good value has come yet: level 1"):
        assert stream.level([]) == 1


def test_a_little_beyond_the_range_counts_as_its_end() -> None:
    stream = signal(Clock(), "comfort.stream.high=9", "comfort.stream.tolerance=0.25")
    assert stream.level([10]) == 10 and stream.level([-2]) == 1


# ---- udp -----------------------------------------------------------------------------------------------


def test_datagrams_on_loopback_set_the_level() -> None:
    config = comfort("comfort.source=udp", "comfort.stream.port=0", "comfort.stream.high=9",
                     "comfort.stream.smoothing_s=0")  # fmt: skip
    source = make_source(config, 3)
    with pytest.warns(UserWarning, match="no good value"):
        source.begin(np.arange(3))
    assert (source.level == 1).all()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for text in (b"3", b"6\n", b"rubbish", bytes(range(200, 256))):
            sender.sendto(text, ("127.0.0.1", source.levels.stream.port))
    with pytest.warns(UserWarning, match="not a number"):
        assert (until(source, 7) == 7).all()


def until(source, level: float):
    """Read until the level arrives."""
    for _ in range(2000):
        now = source.advance(at(0.0, len(source.level)))
        if (now == level).all():
            break
        time.sleep(0.01)
    return now


def test_a_port_that_is_taken_is_refused_in_one_line() -> None:
    first = udp(comfort("comfort.source=udp", "comfort.stream.port=0"))
    with pytest.raises(ConfigError, match=rf"comfort\.stream\.port={first.port}"):
        udp(replace_port(first.port))


def replace_port(port: int) -> ComfortConfig:
    config = comfort("comfort.source=udp")
    return replace(config, stream=replace(config.stream, port=port))


# ---- recordings ----------------------------------------------------------------------------------------


def recorded(tmp_path: Path, text: str, *overrides: str) -> ComfortConfig:
    path = tmp_path / "levels.csv"
    path.write_text(text, encoding="utf-8")
    return comfort("comfort.source=file", f"comfort.file='{path}'", "comfort.stream.high=9",
                   "comfort.stream.smoothing_s=0", *overrides)  # fmt: skip


def test_a_recording_is_replayed_in_every_episode_with_its_gaps(tmp_path: Path) -> None:
    source = begun(recorded(tmp_path, "t,value\n0,9\n1,4\n10,8\n"), 2)
    levels = [source.advance(at(t, 2))[0] for t in (0.0, 0.99, 1.0, 3.9, 4.1, 10.0, 12.9, 13.1)]
    assert levels == [10, 10, 5, 5, 1, 9, 9, 1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "t,value\n",
        "t,value\n\n\n",
        "time,level\n0,1\n",
        "t,value\n1,2\n1,3\n",
        "t,value\nx,2\n",
        "t,value\n-1,2\n0,3\n",
        "t,value\n0,1,2\n",
        "t,value\n0,1\n\n1,2\n",
        't,value\n0,1\n1,"2\n2,3\n',
        "t,value\n0,1\n1," + 140_000 * "2",
        "t,value\n" + 100_000 * "x",
    ],
)
def test_a_bad_recording_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r"comfort\.file=") as error:
        read_recording(recorded(tmp_path, text))
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_a_byte_order_mark_and_blank_lines_at_the_end_are_accepted(tmp_path: Path) -> None:
    plain, marked = (
        read_recording(recorded(tmp_path, text))
        for text in ("t,value\n0,9\n1,4\n", "\ufefft,value\n0,9\n1,4\n\n \n,\n")
    )
    assert (plain.time_s == marked.time_s).all() and (plain.levels == marked.levels).all()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["comfort.source=fixed"], "comfort.level=null"),
        (["comfort.level=3"], "comfort.level=3 goes with comfort.source=fixed"),
        (["comfort.source=fixed", "comfort.level=11"], "comfort.level=11"),
        (["comfort.source=schedule"], r"comfort.schedule_s=\[\]"),
        (["comfort.schedule_s=[1]", "comfort.schedule_levels=[5]"], "must start at 0"),
        (["comfort.schedule_s=[0,nan]", "comfort.schedule_levels=[5,6]"], r"comfort.schedule_s.1=nan is outside"),
        (["comfort.schedule_s=[0,inf]", "comfort.schedule_levels=[5,6]"], r"comfort.schedule_s.1=inf is outside"),
        (["comfort.source=file"], "comfort.file=null"),
        (["comfort.form=round"], "comfort.form='round'.*target_distance"),
        (["comfort.min_m=2"], "comfort.min_m=2"),
        (["comfort.stream.low=1"], "must differ"),
    ],
)  # fmt: skip
def test_a_bad_choice_is_refused_in_one_line(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        comfort(*overrides)
