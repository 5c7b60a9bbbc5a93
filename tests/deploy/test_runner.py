"""A plan runs on an arm in real time as in simulation, and every stop leaves a record and lets the next run start."""

from __future__ import annotations

import gc
import io
import multiprocessing
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, DeployConfig, EvaluateConfig
from hrl_comfort.deploy import runner
from hrl_comfort.deploy.arms import SimulatedArm
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.runner import LOG, deploy
from hrl_comfort.deploy.stops import StoppedError
from hrl_comfort.deploy.streamer import COLUMNS
from hrl_comfort.evaluation.rollout import STALE, rollout
from hrl_comfort.files.run_config import save_config
from hrl_comfort.files.tables import read_table
from hrl_comfort.scene.workcell import build_scene
from tests.deploy.faulty_arm import FaultyArm, refused

REFERENCE = Path(__file__).resolve().parents[2] / "runs" / "reference"
PICK = [f"policy={REFERENCE / 'pick'}", "human=still", "confirm=yes"]
CHAIN = {f"policies.{name}": str(REFERENCE / name) for name in ("pick", "place", "return")}
CYCLE = {"task": "cycle", "meta_controller": "nearest", "human": "still", **CHAIN}


def config(output: Path, *more: str) -> DeployConfig:
    found = compose("deploy", [*PICK, f"output={output}", *more])
    assert isinstance(found, DeployConfig)
    return found


def under_way(output: Path) -> bool:
    """Return whether an arm has followed set-points for about a second."""
    log = output / "setpoints.bin"
    return log.exists() and log.stat().st_size > 500 * 17 * 8


def test_a_cycle_in_real_time_is_recorded_as_an_evaluation_is(tmp_path: Path) -> None:
    output = tmp_path / "out"
    chain = [f"{key}={value}" for key, value in CYCLE.items()]
    assert main(["deploy", *chain, "confirm=yes", f"output={output}", "episodes=1"]) == 0
    episodes, paths = read_table(output / "episodes.csv"), read_table(output / "paths.csv")
    assert episodes is not None and paths is not None
    assert episodes["success"].all() and list(episodes["split"]) == ["live"]
    choices = {"split": "validation", "episodes": 1, "safety": "ssm", "safety.delay_s": 0.1}
    simulated = compose(
        "evaluate", [f"{k}={v}" for k, v in {**CYCLE, **choices}.items()] + ["robot.rating=collaborative"]
    )
    assert isinstance(simulated, EvaluateConfig)
    assert int(episodes["steps"][0]) == pytest.approx(rollout(simulated).episodes[0].steps, abs=20)
    log = pd.read_parquet(output / LOG)
    assert len(log) >= 10 * int(episodes["steps"][0])
    moving = log[log["planned"] == 1]
    lag = np.abs(moving.filter(regex=r"sent\d").to_numpy() - moving.filter(regex=r"q\d").to_numpy())
    assert np.degrees(lag.max()) < 5.0
    assert main(["report", f"run={output}", "video=false"]) == 0


@pytest.mark.parametrize("fault", ["connection", "slow"])
def test_a_fault_of_the_arm_ends_the_run_with_its_record_and_the_next_run_starts(fault: str, tmp_path: Path) -> None:
    asked = config(tmp_path / "out")
    scene = build_scene(asked.robot, asked.cell, 10)
    said = {"connection": "lost connection: no answer", "slow": "late cycle"}[fault]
    with pytest.raises(StoppedError, match=said):
        deploy(asked, partial(FaultyArm, scene.model, scene.home, fault, 200))
    log = pd.read_parquet(tmp_path / "out" / LOG)
    assert log["planned"].iloc[-1] == -2
    last = log.filter(regex=r"sent\d").to_numpy()[-2:]
    assert (last[0] == last[1]).all()
    episodes = read_table(tmp_path / "out" / "episodes.csv")
    assert episodes is not None and list(episodes["truncated"]) == [True]
    assert deploy(asked) == tmp_path / "out"


def test_a_person_who_could_reach_a_fast_arm_stops_it(tmp_path: Path) -> None:
    with pytest.raises(StoppedError, match="shield at zero"):
        deploy(config(tmp_path / "out", "human=random_walk", "episodes=4"))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.mark.parametrize("people", [1, 2])
def test_a_person_who_is_no_longer_seen_stops_the_arm(people: int, tmp_path: Path) -> None:
    """Of two people, the first is still seen, whoever it is."""
    ports = [free_port() for _ in range(people)]
    over = threading.Event()

    def tell() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not over.is_set():
                for index, port in enumerate(ports):
                    if index < people - 1 or not under_way(tmp_path / "out"):
                        sender.sendto(b"0.5 0.6 0" if index == 0 else b"-0.9 0.6 0", ("127.0.0.1", port))
                time.sleep(0.02)

    first, *others = (f"udp://127.0.0.1:{port}" for port in ports)
    more = [f"+human.others.second={{file: '{file}'}}" for file in others]
    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        with pytest.raises(StoppedError, match=r"stale person: position \d+\.\d+ s old"):
            deploy(config(tmp_path / "out", "human=live", f"human.file='{first}'", *more, "episodes=2"))
    finally:
        over.set()
        thread.join()


def test_a_level_that_no_longer_comes_stops_the_arm(tmp_path: Path) -> None:
    """At a port of its own, which the dry run has freed."""
    more = ["comfort=conditioned", "comfort.source=udp", "comfort.stream.stall_s=0.5"]
    with pytest.raises(StoppedError, match=r"stale level: no good value for 0.5 s"):
        deploy(config(tmp_path / "out", *more, f"comfort.stream.port={free_port()}"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_and_a_killed_runner_leave_the_arm_at_rest(number: int, tmp_path: Path) -> None:
    output = tmp_path / "out"
    command = [sys.executable, "-m", "hrl_comfort", "deploy", *PICK, f"output={output}", "episodes=2"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        while running.poll() is None and not under_way(output):
            time.sleep(0.05)
        running.send_signal(number)
        assert running.stderr is not None
        said = running.stderr.read()
    if number == signal.SIGINT:
        assert (running.returncode, said.splitlines()[-1]) == (130, "hrl-comfort: stopped: interrupted")
        return
    rows = np.fromfile(output / "setpoints.bin").reshape(-1, len(COLUMNS) + 12)  # said was over with the streamer's end
    assert rows[-1, COLUMNS.index("planned")] == -2 and (rows[-1, 5:11] == rows[-2, 5:11]).all()


def test_the_word_has_to_be_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    with pytest.raises(ConfigError, match="'move' was not typed; nothing was moved"):
        deploy(replace(config(tmp_path / "out"), confirm="ask"))
    assert not (tmp_path / "out").exists()


def test_an_interrupt_at_the_prompt_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Keyboard:
        def readline(self) -> str:
            signal.raise_signal(signal.SIGINT)
            return "move"

    monkeypatch.setattr(runner, "rehearse", lambda *args: None)
    monkeypatch.setattr("sys.stdin", Keyboard())
    before = set(multiprocessing.active_children())
    assert main(["deploy", *PICK, "confirm=ask", f"output={tmp_path / 'out'}"]) == 130
    assert capsys.readouterr().err == "hrl-comfort: interrupted\n"
    assert not (tmp_path / "out").exists() and not (set(multiprocessing.active_children()) - before)


def fails(*args: object) -> NoReturn:
    raise ConfigError("no such policy")


def test_a_start_that_fails_leaves_earlier_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "rehearse", lambda *args: None)
    monkeypatch.setattr(runner, "Paced", Lockstep)
    monkeypatch.setattr(runner, "Run", fails)
    asked = config(tmp_path)
    save_config(asked, tmp_path / "config.yaml")
    earlier = {each: each.read_bytes() for each in tmp_path.iterdir()}
    for name in (*STALE, "episodes.csv"):
        earlier[tmp_path / name] = b"earlier"
        (tmp_path / name).write_bytes(b"earlier")
    with pytest.raises(ConfigError, match="no such policy"):
        deploy(replace(asked, episodes=2))
    assert {each: each.read_bytes() for each in tmp_path.iterdir()} == earlier


@pytest.mark.parametrize("at", ["no such arm", "no such policy"])
def test_a_start_that_fails_leaves_no_process(at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = config(tmp_path / "out")
    scene = build_scene(asked.robot, asked.cell, 10)
    monkeypatch.setattr(runner, "rehearse", lambda *args: None)
    monkeypatch.setattr(runner, "Run", fails)
    arm = refused if at == "no such arm" else partial(SimulatedArm, scene.model, scene.home)
    before = set(multiprocessing.active_children())
    with pytest.raises(ConfigError, match=at):
        deploy(asked, arm)
    assert not (set(multiprocessing.active_children()) - before) and gc.isenabled()


START = """
import signal
from hrl_comfort.deploy.links import Paced
from tests.deploy.faulty_arm import Interrupted, refused
try:
    Paced(Interrupted(refused), None, None)
except Exception as error:
    print(error, signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


def test_a_streamer_that_is_interrupted_as_it_starts_goes_on() -> None:
    """Even as the first child of its process."""
    done = subprocess.run([sys.executable, "-c", START], capture_output=True, text=True, check=True)
    assert done.stdout == "connection: no such arm set()\n"


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("robot.rating=paper", "robot.rating=paper has no limits"),
        ("safety=none", "leaves the arm without its shield"),
        ("connection=ur", "confirm=yes is for connection=simulated"),
        ("levels=[1]", "levels=.* is for hrl-comfort evaluate"),
    ],
)
def test_what_does_not_go_with_an_arm_is_refused(override: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=said):
        config(tmp_path, override)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["task=shift"], "task.name=shift goes on after failures"),
        (["split=test"], "split=test is for hrl-comfort evaluate"),
        (["connection=ur", "confirm=ask", "human=live", "robot=jaco"], "robot.name=jaco is no arm of connection=ur"),
        (["connection=ur", "confirm=ask", "human=live"], "human.file=null tells nobody's place"),
    ],
)
def test_what_an_arm_is_not_run_with_is_refused(overrides: list[str], said: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=said):
        deploy(config(tmp_path, *overrides))


def test_nobody_walks_beside_a_real_arm_but_people_who_are_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"human.motion=still is nobody beside a real arm; choose one of live"):
        config(tmp_path, "connection=ur", "confirm=ask")
