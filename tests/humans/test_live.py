"""Motion `live`: poses from UDP, Lab Streaming Layer, a callable or the program; walked to within the speed limit."""

from __future__ import annotations

import socket
import sys
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from hrl_comfort import humans, streams
from hrl_comfort.config import CONTROL_STEP_S, ConfigError
from hrl_comfort.humans import body
from hrl_comfort.humans.motions.live import HELD, CheckedPoses, pose_source
from hrl_comfort.streams import UdpStream
from tests.humans.around import around
from tests.humans.paper import HUMAN, no_discs

LIVE = replace(HUMAN, motion="live", speed_m_s=1.6)
ARRIVING: list[object] = []


def arriving() -> object:
    """Return the newest of ARRIVING, as a source named in `human.file` does."""
    return ARRIVING[-1] if ARRIVING else None


@pytest.fixture(autouse=True)
def nobody_holds() -> None:
    HELD.pose = HELD.hands = None
    ARRIVING.clear()
    pose_source.cache_clear()


def walked(config, steps: int) -> list[humans.Walk]:
    walks = [humans.begin(config, np.array([[0.5, -0.5], [-0.4, 0.6]]))]
    for _ in range(steps):
        walks.append(
            humans.advance(config, walks[-1], np.zeros((2, humans.NOISE)), around(np.zeros((2, 2)), no_discs(2)))
        )
    return walks


def test_nobody_moves_until_a_pose_is_there() -> None:
    first, *_, last = walked(LIVE, 5)
    assert (first.position == last.position).all() and (first.yaw == last.yaw).all()


def test_the_person_walks_to_the_pose_no_faster_than_the_limit_and_stops_there() -> None:
    HELD.pose = (0.5, 0.5, None)
    walks = walked(LIVE, 60)
    speeds = [np.linalg.norm(b.position - a.position, axis=-1) / CONTROL_STEP_S for a, b in pairwise(walks)]
    assert np.max(speeds) == pytest.approx(1.6) and np.allclose(walks[-1].position, [0.5, 0.5])
    assert walks[1].yaw[0] == pytest.approx(np.pi / 2) and walks[-1].yaw[0] == pytest.approx(np.pi / 2)


def test_a_given_yaw_is_taken_and_neither_bound_nor_keep_out_apply() -> None:
    HELD.pose = (0.0, 0.0, 0.3)
    last = walked(replace(LIVE, bound_m=0.01, keep_out_m=0.5), 60)[-1]
    assert np.allclose(last.position, 0.0) and np.allclose(last.yaw, 0.3)


def test_poses_come_from_a_callable_and_bad_ones_are_left_out_with_one_warning() -> None:
    source = pose_source(f"{__name__}:arriving")
    assert source() is None
    ARRIVING.append((0.1, 0.2))
    assert source() == (0.1, 0.2, None)
    for bad in ((0.1,), (0.1, float("nan")), "x y", (1e9, 0.0)):
        ARRIVING.append(bad)
        if bad == (0.1,):
            with pytest.warns(UserWarning, match="is not x, y"):
                assert source() == (0.1, 0.2, None)
        else:
            assert source() == (0.1, 0.2, None)
    ARRIVING.append((0.3, 0.4, 0.5))
    assert source() == (0.3, 0.4, 0.5)


def test_poses_come_by_udp() -> None:
    stream = UdpStream("127.0.0.1", 0, "human.file")
    poses = CheckedPoses("udp", stream.read_stamped)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for text in (b"0.1 0.2 0.3", b"0.4, -0.6"):
            sender.sendto(text, ("127.0.0.1", stream.port))
        assert poses() == (0.4, -0.6, None)


def test_poses_come_by_udp_of_ipv6() -> None:
    source = pose_source("udp://[::1]:0")
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"0.1 0.2 0.3", ("::1", source._read.__self__.port))
        assert source() == (0.1, 0.2, 0.3)


class Waiting:
    """A socket in which datagrams lie, with the system's notes on when they arrived."""

    def __init__(self, *arrived_s: float | None) -> None:
        kind = (socket.SOL_SOCKET, streams.SO_TIMESTAMPNS)
        self.notes = [
            [] if at is None else [(*kind, streams.TIMESPEC.pack(int(at), round(at % 1 * 1e9)))] for at in arrived_s
        ]

    def recvmsg(self, *_: int) -> tuple:
        if not self.notes:
            raise BlockingIOError
        return b"0.1 0.2", self.notes.pop(0), 0, None


def test_a_pose_is_as_old_as_its_datagram_however_late_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(time=lambda: 1000.5, monotonic=lambda: 50.0)
    monkeypatch.setattr(streams, "time", clock)
    stream = UdpStream("127.0.0.1", 0, "human.file")
    if sys.platform == "linux":
        assert stream._socket.getsockopt(socket.SOL_SOCKET, streams.SO_TIMESTAMPNS)
    poses = CheckedPoses("udp", stream.read_stamped)
    # The third is said to arrive a second from now, as after the wall clock was set back; the last has no note.
    for arrived_s, expected in ((1000.2, 49.7), (940.25, -10.25), (1001.5, 50.0), (None, 50.0)):
        stream._socket = Waiting(arrived_s)
        poses()
        assert poses.arrived_s == pytest.approx(expected, abs=1e-6)
    stream._socket = Waiting(1000.1, 1000.3)
    poses()
    assert poses.arrived_s == pytest.approx(49.8, abs=1e-6)


@pytest.mark.parametrize(
    ("file", "what"),
    [
        ("poses.csv", r"not a source of live poses; give udp://HOST:PORT"),
        ("no_such_module:poses", r"cannot be imported"),
        ("udp://256.0.0.1:80", r"cannot be opened"),
        ("udp://127.0.0.1:70000", r"cannot be opened"),
        ("lsl:nobody sends this", r"such Lab Streaming Layer stream|needs pylsl"),
    ],
)
def test_a_source_that_cannot_be_opened_is_refused_before_the_first_step(
    file: str, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(pose_source.__wrapped__.__globals__, "APPEAR_S", 0.1)
    with pytest.raises(ConfigError, match=what):
        walked(replace(LIVE, file=file), 0)


def test_held_hands_move_within_the_speed_limit_and_hang_again() -> None:
    HELD.hands = np.array([[0.4, 0.2, 1.2], [0.3, -0.2, 1.1]])
    walks = walked(LIVE, 60)
    hands = [np.where(np.isnan(walk.limbs[:, 4:]), body.HANGING, body.hands(walk.limbs)) for walk in walks]
    speeds = [np.linalg.norm(b - a, axis=-1).max() / CONTROL_STEP_S for a, b in pairwise(hands)]
    assert max(speeds) <= 1.6 + 1e-9 and np.allclose(hands[-1], HELD.hands)
    HELD.hands = None
    for _ in range(60):
        walks.append(
            humans.advance(LIVE, walks[-1], np.zeros((2, humans.NOISE)), around(np.zeros((2, 2)), no_discs(2)))
        )
    assert np.isnan(walks[-1].limbs).all()


def test_hands_use_what_the_walk_leaves_of_the_speed() -> None:
    HELD.pose, HELD.hands = (2.0, -0.5, None), np.array([[0.4, 0.2, 1.2], [0.3, -0.2, 1.1]])
    walks = walked(LIVE, 5)
    assert np.allclose(body.hands(walks[-1].limbs)[0], body.HANGING)
