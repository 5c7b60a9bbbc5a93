"""A Robotiq hand is moved and read over its socket server, and what is wrong with it is told in one line."""

from __future__ import annotations

import os
import socket
from typing import Any

import pytest

from hrl_comfort.deploy.arms import Fingers, HandReading
from hrl_comfort.deploy.hands import robotiq
from hrl_comfort.deploy.hands.robotiq import ROUND, RobotiqHand
from tests.deploy.fake_robotiq import FakeRobotiq, Loopback, served, still


def host(number: int) -> str:
    """Return a loopback address of this process."""
    return f"127.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250}.{100 + number}"


def connected(server: FakeRobotiq, monkeypatch: pytest.MonkeyPatch, force_n: float = 40.0) -> RobotiqHand:
    """Return a hand whose server answers at once."""

    def connect(*args: Any) -> Loopback:
        return Loopback(server)

    monkeypatch.setattr(socket, "create_connection", connect)
    return RobotiqHand("anywhere", force_n)


def settled(hand: RobotiqHand) -> HandReading:
    """Return the state once everything has been asked for again."""
    for _ in range(2 * len(ROUND)):
        hand.read()
    return hand.read()


def test_the_fingers_follow_a_set_point_over_a_socket_and_a_grip_is_told() -> None:
    state = HandReading(0.2, Fingers.THERE)
    server = FakeRobotiq(lambda: state)
    with served(host(1), server):
        hand = RobotiqHand(host(1), 40.0)
        assert "SET POS 51" in server.lines and server.lines.index("SET POS 51") < server.lines.index("SET GTO 1")
        hand.send(1.0)
        while server.position != 255:
            hand.read()
        state = HandReading(0.6, Fingers.GRIP)
        while hand.read() != HandReading(153 / 255, Fingers.GRIP):
            pass
        hand.close()
    assert server.values["SPE"] == 255 and server.values["FOR"] == round(255 * 20 / 215)


@pytest.mark.parametrize("reads", range(len(ROUND)))
def test_a_grip_is_told_with_the_position_where_the_fingers_hold(reads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    state = HandReading(46 / 255, Fingers.MOVE)
    hand = connected(FakeRobotiq(lambda: state), monkeypatch)
    assert settled(hand) == state
    for _ in range(reads):
        hand.read()
    state = HandReading(105 / 255, Fingers.GRIP)
    told = [hand.read() for _ in range(2 * len(ROUND))]
    assert state in told
    assert all(reading == state for reading in told if reading.fingers == Fingers.GRIP)


def test_set_points_in_a_row_leave_room_for_questions(monkeypatch: pytest.MonkeyPatch) -> None:
    server = FakeRobotiq(still)
    hand = connected(server, monkeypatch)
    server.lines.clear()
    for step in range(1, 33):
        hand.send(step / 100)
        hand.read()
    assert [line.split()[0] for line in server.lines] == ["SET", "GET"] * 16
    asked = [line.split()[1] for line in server.lines[1::2]]
    assert {name: asked.count(name) for name in set(ROUND)} == {"OBJ": 8, "POS": 4, "FLT": 2, "STA": 2}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"STA": 0}, r"the gripper is not activated \(STA 0, not 3\)"),
        ({"FLT": 14}, r"the gripper has fault 14 \(overcurrent\)"),
        ({"STA": "?"}, "answers '\\?' to 'GET STA': is the robot in an emergency stop"),
    ],
)
def test_a_hand_that_is_not_ready_is_refused_and_stops_the_arm(
    values: dict[str, int | str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = FakeRobotiq(still)
    hand = connected(server, monkeypatch)
    assert settled(hand).trouble == ""
    server.values |= values
    with pytest.raises(ConnectionError, match=said):
        raise ConnectionError(settled(hand).trouble)  # what no number can be made of is raised at once
    with pytest.raises(ConnectionError, match=said):
        connected(server, monkeypatch)


def test_a_server_that_is_silent_goes_or_answers_nonsense_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConnectionError, match=r"63352 does not answer \(Connection refused\): is its URCap installed"):
        RobotiqHand(host(2), 40.0)
    monkeypatch.setattr(robotiq, "ANSWER_S", 0.05)
    server = FakeRobotiq(still)
    server.silent = "GET FLT"
    with served(host(2), server), pytest.raises(ConnectionError, match=r"has not answered 'GET FLT' for 0\.05 s"):
        RobotiqHand(host(2), 40.0)
    server.silent = "never"
    hand = connected(server, monkeypatch)
    server.values["FLT"] = server.values["STA"] = ""
    while server.lines[-1] != "GET FLT":
        hand.read()
    monkeypatch.setattr(robotiq, "STALE_S", -1.0)
    with pytest.raises(ConnectionError, match="the gripper has not answered 'GET FLT' for"):
        hand.read()
    monkeypatch.setattr(server, "answer", lambda line: b"HTTP/1.1 400 Bad Request")
    with pytest.raises(ConnectionError, match=r"the gripper answers 'HTTP/1.. 400 Bad Request' to 'GET"):
        connected(server, monkeypatch)
