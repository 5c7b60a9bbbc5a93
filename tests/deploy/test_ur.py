"""A fake controller of Universal Robots: plans over RTDE, faults of the network and of the robot, dead runners."""

from __future__ import annotations

import io
import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import DeployConfig
from hrl_comfort.deploy.runner import LOG, deploy
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.files.tables import read_table
from tests.deploy.fake_ur import EMERGENCY, PROTECTIVE, FakeUr, Faults, fake_ur
from tests.deploy.test_runner import REFERENCE, under_way
from tests.deploy.test_streamer import scene

pytest.importorskip("rtde_receive")
from hrl_comfort.deploy import ur
from hrl_comfort.deploy.ur import UrArm

BRAKE = 5.0


def host(number: int) -> str:
    """Return a loopback address of this process."""
    return f"127.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250}.{number}"


def config(output: Path, address: str) -> DeployConfig:
    where = ["connection=ur", f"connection.host={address}", "human=none", f"output={output}"]
    found = compose("deploy", [f"policy={REFERENCE / 'pick'}", *where])
    assert isinstance(found, DeployConfig)
    return found


def undisturbed(output: Path, run: Callable[[], object]) -> None:
    """Run until the machine lets the set-points keep their clock; a stop while they do is an error."""
    for left in reversed(range(5)):
        try:
            run()
        except StoppedError:
            late_s = pd.read_parquet(output / LOG)["late_s"].max()
            if late_s < ur.STALE_S / 2 or not left:
                raise
        else:
            return


def test_a_plan_runs_over_a_slow_network_that_loses_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("move\n" * 5))
    with fake_ur(host(1), scene().model, scene().home, Faults(0.02, 0.002, 0.01, 0.02)):
        undisturbed(tmp_path / "out", lambda: deploy(config(tmp_path / "out", host(1))))
    episodes = read_table(tmp_path / "out" / "episodes.csv")
    assert episodes is not None and list(episodes["success"]) == [True]
    log = pd.read_parquet(tmp_path / "out" / LOG)
    lag = np.abs(log.filter(regex=r"sent\d").to_numpy() - log.filter(regex=r"q\d").to_numpy())
    assert 2.0 < np.degrees(lag.max()) < 20.0


def test_a_protective_stop_of_the_robot_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("move\n"))

    def trip(robot: FakeUr) -> None:
        while not under_way(tmp_path / "out"):
            time.sleep(0.02)
        robot.state(PROTECTIVE)

    with fake_ur(host(2), scene().model, scene().home) as robot:
        thread = threading.Thread(target=trip, args=(robot,))
        thread.start()
        with pytest.raises(StoppedError, match="protective stop"):
            deploy(config(tmp_path / "out", host(2)))
        thread.join()


def test_a_dead_runner_stops_the_arm_within_a_tenth_of_a_second() -> None:
    with fake_ur(host(3), scene().model, scene().home) as robot:
        arm = UrArm(host(3), BRAKE)
        angles, fast = scene().home.copy(), 0.0
        for _ in range(100):
            angles[0] += 0.001
            arm.send(angles)
            time.sleep(0.002)
            fast = max(fast, np.abs(robot.state()[1]).max())  # of 0.5; a busy machine may stop the arm in the loop
        time.sleep(0.1 + fast / BRAKE + 0.1)  # the script's patience, its brake, the servo's lag
        first = robot.state()[0]
        time.sleep(0.1)
        assert fast > 0.05 and np.abs(robot.state()[0] - first).max() < 1e-3
        assert arm.read().trouble == "the program on the robot has ended"
        arm.close()


def test_the_script_follows_nothing_but_the_set_points_of_its_own_program() -> None:
    with fake_ur(host(6), scene().model, scene().home, Faults(latency_s=0.02, loss=0.01)) as robot:
        for _ in range(2):  # registers are 0 at first, and those of the first program then
            arm, fastest = UrArm(host(6), BRAKE), 0.0
            for _ in range(50):
                arm.send(scene().home)
                fastest = max(fastest, np.abs(robot.state()[1]).max())
                time.sleep(0.002)
            assert fastest < 0.02 and np.abs(robot.state()[0] - scene().home).max() < 2e-3
            arm.close()
            time.sleep(0.1)


def test_an_arm_that_is_left_stands_and_can_be_taken_again() -> None:
    with fake_ur(host(4), scene().model, scene().home) as robot:
        for _ in range(2):
            arm = UrArm(host(4), BRAKE)
            assert np.abs(arm.read().angles - scene().home).max() < 1e-2
            arm.close()
            time.sleep(0.1)
        for mode, said in ((PROTECTIVE, "protective stop"), (EMERGENCY, "emergency stop")):
            robot.state(mode)
            with pytest.raises(ConnectionError, match=f"is not ready: {said}"):
                UrArm(host(4), BRAKE)


@pytest.mark.parametrize(
    ("said", "what"),
    [(b"", "has not answered by RTDE for 0.2 s"), (b"HTTP/1.1 400 Bad Request", "has not answered by RTDE"),
     (b"\0\3x" * 9, "has not answered by RTDE"), (b"\0\4V\0", "does not know version 2")],
)  # fmt: skip
def test_a_port_that_accepts_and_answers_nothing_of_use_is_one_line(
    said: bytes, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur, "ANSWER_S", 0.2)

    def answer() -> None:
        connection = server.accept()[0]
        connection.sendall(said)
        held.append(connection)

    held: list[socket.socket] = []
    with socket.create_server((host(7), ur.RTDE_PORT)) as server:
        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(ConnectionError, match=what):
            UrArm(host(7), BRAKE)
        thread.join()
        held[0].close()


def test_no_controller_is_one_line() -> None:
    with pytest.raises(ConnectionError, match=r"30004 does not answer \(Connection refused\)"):
        UrArm(host(5), BRAKE)
