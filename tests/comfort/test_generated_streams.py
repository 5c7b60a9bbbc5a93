"""Any motion file, recording, stream or schedule gives one-line errors or values in range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hrl_comfort import humans
from hrl_comfort.comfort.sources import make_source
from hrl_comfort.comfort.streams import Signal
from hrl_comfort.config import ComfortConfig
from tests.generating import COMFORT, TRAINED, inputs, tried
from tests.humans.around import around

CELLS = st.one_of(
    st.floats().map(str),
    st.floats(-10, 10).map(str),
    st.integers(0, 5).map(str),
    st.sampled_from(["", " ", "nan", "inf", "1e308", "-1e308", "x", "1_0", "٣", '"', "'", "1,5", "\x00", "\ufeff"]),
)


NUMBERS = st.one_of(st.floats(-9, 9), st.floats(-9, 9), st.floats(-9, 9), st.floats()).map(str)


def tables(header: str) -> st.SearchStrategy[bytes]:
    """Return good and bad CSV files for this header."""
    width = header.count(",") + 1
    rising = (
        st.integers(1, 6)
        .flatmap(
            lambda rows: st.lists(
                st.lists(NUMBERS, min_size=width - 1, max_size=width - 1),
                min_size=rows,
                max_size=rows,
            )
        )
        .map(lambda rows: [[str(0.5 * k), *row] for k, row in enumerate(rows)])
    )
    any_rows = st.lists(st.lists(CELLS, max_size=width + 1), max_size=5)
    heads = st.sampled_from([*[header] * 12, header.upper(), header[:-2], f"{header},z", "", "0,1"])
    return st.builds(
        lambda start, head, rows, comma, end: (
            start + end.join([head, *(comma.join(row) for row in rows)]).encode("utf-8")
        ),
        st.sampled_from([*[b""] * 6, b"\xef\xbb\xbf", b"\xff", b"\n"]),
        heads,
        st.one_of(rising, any_rows),
        st.sampled_from([*[","] * 12, ";", "\t", ", "]),
        st.sampled_from(["\n", "\n", "\r\n", "\r", "\n\n"]),
    )


def stroll(file: Path) -> list[np.ndarray]:
    """Return the positions of a human with this motion file in the first steps."""
    config = replace(HUMAN, motion="recorded", file=str(file))
    walk, places = humans.begin(config, np.zeros((2, 2))), []
    discs = humans.around(np.zeros((1, 2)), 0.1, 2)
    for _ in range(3):
        walk = humans.advance(config, walk, np.full((2, humans.NOISE), 0.5), around(np.zeros((2, 2)), discs))
        places += [walk.position, walk.yaw, walk.speed_m_s, walk.walked_m]
    return places


HUMAN = TRAINED.human


@inputs(0.15)
@given(content=st.one_of(tables("t,x,y,yaw"), tables("t,x,y,yaw"), st.binary(max_size=40)))
def test_no_motion_file_crashes_and_people_are_at_finite_places(content: bytes, fresh: Callable[[bytes], Path]) -> None:
    file = fresh(content)
    for numbers_ in tried(lambda: stroll(file)) or []:
        assert np.isfinite(numbers_).all()


STREAMS = st.builds(
    lambda low, high, tolerance, smoothing_s, stall_s: (
        {"low": low, "high": high, "tolerance": tolerance, "smoothing_s": smoothing_s, "stall_s": stall_s}
    ),
    st.floats(-1e9, 1e9),
    st.floats(-1e9, 1e9),
    st.floats(0, 10),
    st.floats(0, 3600),
    st.floats(0, 3600),
)
TIMES = np.array([0.0, 0.1, 1.0, 1e3, 1e12])


def heard(changes: dict[str, float], **others: Any) -> ComfortConfig:
    return replace(COMFORT, stream=replace(COMFORT.stream, **changes), **others)


def of_range(levels: np.ndarray) -> None:
    assert np.isfinite(levels).all() and (levels >= 1).all() and (levels <= COMFORT.levels).all()


@inputs(0.12)
@given(content=st.one_of(tables("t,value"), tables("t,value"), st.binary(max_size=40)), stream=STREAMS)
def test_no_recording_crashes_and_its_levels_are_of_the_range(
    content: bytes, stream: dict[str, float], fresh: Callable[[bytes], Path]
) -> None:
    file = fresh(content)
    levels = tried(lambda: make_source(heard(stream, source="file", file=str(file)), 1).levels(TIMES, TIMES))
    if levels is not None:
        of_range(levels)


ARRIVED = st.lists(
    st.tuples(
        st.one_of(st.floats(0, 5000), st.just(0.0)),
        st.lists(st.one_of(CELLS, st.floats(), st.integers(), st.none()), max_size=3),
    ),
    max_size=8,
)


@inputs(0.1)
@given(arrived=ARRIVED, stream=STREAMS)
def test_no_live_stream_crashes_and_its_levels_are_of_the_range(
    arrived: list[tuple[float, list[Any]]], stream: dict[str, float]
) -> None:
    def levels() -> list[int]:
        now, found = 0.0, []
        signal = Signal(heard(stream), "test", clock=lambda: now)
        for passed, values in arrived:
            now += passed
            found.append(signal.level(values))
        return found

    of_range(np.array(tried(levels) or [1]))


@inputs(0.05)
@given(
    times=st.one_of(
        st.lists(st.floats(), max_size=4),
        st.lists(st.floats(0.1, 1e9), max_size=4, unique=True).map(lambda each: [0.0, *sorted(each)]),
    ),
    levels=st.lists(st.one_of(st.integers(), st.integers(1, 10)), max_size=5),
)
def test_no_schedule_crashes_and_its_levels_are_of_the_range(times: list[float], levels: list[int]) -> None:
    found = tried(
        lambda: make_source(
            replace(COMFORT, source="schedule", schedule_s=times, schedule_levels=levels), len(TIMES)
        ).levels(TIMES, TIMES)
    )
    if found is not None:
        of_range(found)
