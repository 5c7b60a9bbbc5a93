"""Plans with a hand run on an arm: an object is gripped, placed and lost, in simulated time and over sockets."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, DeployConfig
from hrl_comfort.deploy.arms import PERIOD_S, Arm, Equipped, Fingers, HandReading, Reading, SimulatedHand
from hrl_comfort.deploy.hands.robotiq import RobotiqHand
from hrl_comfort.deploy.hands.tool_output import SHUT, ToolHand
from hrl_comfort.deploy.held import Objects
from hrl_comfort.deploy.links import Lockstep
from hrl_comfort.deploy.runner import LOG, Run, deploy, ur_with_robotiq
from hrl_comfort.deploy.stops import GripLostError, StoppedError
from hrl_comfort.deploy.streamer import Limits
from hrl_comfort.scene.workcell import Scene, scene_of
from tests.deploy.fake_robotiq import FakeRobotiq, Loopback, RobotiqWorld
from tests.deploy.hand_campaign import cycle
from tests.deploy.test_robotiq_client import host

GRASP = ["cell=grasp", "policy=expert", "human=none", "confirm=yes", "output=none"]
WAY_OFF_M, HELD_TICKS, NOTICED_TICKS = 0.5, 200, 150
"""Way of an object that is torn away, set-points for which it was held before, and after which the loss is noticed."""


def config(*more: str) -> DeployConfig:
    found = compose("deploy", [*GRASP, *more])
    assert isinstance(found, DeployConfig)
    return found


class World(SimulatedHand):
    """See `SimulatedHand`; what the fingers hold is torn away after HELD_TICKS, if they `lose` it."""

    def __init__(self, scene: Scene, lose: bool) -> None:
        super().__init__(scene)
        self._left, self.ticks, self.lost_at = HELD_TICKS if lose else -1, 0, 0

    def send(self, angles: NDArray[np.float64]) -> None:
        super().send(angles)
        self.ticks += 1
        hand = self.read().hand
        if hand is not None and hand.fingers == Fingers.GRIP and self._left > 0:
            self._left -= 1
            if not self._left:
                self.lost_at = self.ticks
                self.lay(self.objects + np.eye(7)[0] * WAY_OFF_M)


def run_in(asked: DeployConfig, arm: Arm, folder: Path) -> tuple[Run, pd.DataFrame, str]:
    """Run the episodes of `asked` on an arm in simulated time; return the run, its log, and why it was stopped."""
    why, link = "", Lockstep(lambda: arm, Limits.of(asked, scene_of(asked)), folder / "setpoints.bin")
    run = Run(asked, link, lambda: False)
    try:
        run.all()
    except StoppedError as error:
        why = f"{type(error).__name__}: {error}"
    run.write(folder)
    return run, pd.read_parquet(folder / LOG), why


def on_robotiq(world: World, monkeypatch: pytest.MonkeyPatch) -> tuple[Arm, FakeRobotiq]:
    """Return the arm of a world with its hand at the other end of Robotiq's server, which answers at once."""
    arm = RobotiqWorld(world)

    def connect(*args: Any) -> Loopback:
        return Loopback(arm.server)

    monkeypatch.setattr(socket, "create_connection", connect)
    return Equipped(arm, RobotiqHand("anywhere", 40.0)), arm.server


def test_a_cycle_picks_places_and_returns_and_the_object_lies_where_it_belongs(tmp_path: Path) -> None:
    asked = config("task=cycle")
    world = World(scene_of(asked), lose=False)
    run, log, why = run_in(asked, world, tmp_path)
    episode = run.result.episodes[0]
    assert (why, episode.success, episode.drops) == ("", True, 0)
    assert np.abs(world.objects[0, :3] - asked.cell.centre("ball", "right")).max() < 0.02
    gripped = log[log["fingers"] == Fingers.GRIP]
    assert gripped["hand"].between(0.3, 0.5).all() and log["hand"].iloc[-1] < 0.01


def test_a_grip_that_is_lost_over_the_server_of_the_hand_stops_the_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = config("task=pick", "gripper=robotiq_2f85")
    world = World(scene_of(asked), lose=True)
    arm, server = on_robotiq(world, monkeypatch)
    run, log, why = run_in(asked, arm, tmp_path)
    assert why.startswith("GripLostError: grip lost: the fingers gripped at ")
    stopped = int((log["planned"] == -2).to_numpy().argmax())
    assert 0 < world.lost_at < stopped <= world.lost_at + NOTICED_TICKS
    assert Fingers.GRIP in set(log["fingers"]) and "SET POS 255" in server.lines
    episode = run.result.episodes[0]
    assert (episode.success, episode.truncated, episode.drops) == (False, True, 1)


def test_an_object_rides_until_the_fingers_open_though_their_answer_comes_late() -> None:
    scene = scene_of(config("task=pick"))
    objects, data = Objects(scene), mujoco.MjData(scene.model)
    data.qpos[scene.moving[:6] - 1] = scene.home
    mujoco.mj_kinematics(scene.model, data)
    middle = data.site("robot/tcp").xpos
    data.qpos[scene.model.joint("object_1_ball").qposadr[0] :][:3] = middle
    objects.begin(data.qpos)
    for told in (0.9, 0.3, 0.0, 0.0):
        objects.follow(HandReading(0.4, Fingers.GRIP), told, scene.home)
    assert objects.poses[0, :3] == pytest.approx(middle, abs=1e-3)
    objects.follow(HandReading(0.0, Fingers.THERE), 0.0, scene.home)
    assert objects.poses[0, :3] == pytest.approx([*middle[:2], scene.floor_z + 0.03], abs=1e-3)
    objects.begin(data.qpos)
    objects.follow(HandReading(0.4, Fingers.GRIP), 0.9, scene.home)
    with pytest.raises(GripLostError, match=r"gripped at 40 % of their way, and are at 55 % \(MOVE\)"):
        objects.follow(HandReading(0.55, Fingers.MOVE), 0.9, scene.home)
    objects.begin(data.qpos)
    objects.follow(HandReading(0.4, Fingers.GRIP), 0.9, scene.home)
    objects.follow(HandReading(0.35, Fingers.GRIP), 0.9, scene.home)
    with pytest.raises(GripLostError, match="are at 28 %"):  # it is torn out and forces them open
        objects.follow(HandReading(0.28, Fingers.GRIP), 0.9, scene.home)


def test_a_fault_of_the_hand_stops_the_arm_and_fingers_keep_their_set_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = config("task=pick", "gripper=robotiq_2f85")
    arm, server = on_robotiq(World(scene_of(asked), lose=False), monkeypatch)
    stream = Lockstep(lambda: arm, Limits.of(asked, scene_of(asked)), tmp_path / "log.bin")
    target = np.append(stream.report.point, 0.2)
    for _ in range(2):
        stream.step(target)
    server.values["FLT"] = 14
    for _ in range(2):
        report = stream.step(target + np.eye(7)[6])
    assert report.stopped == "the gripper has fault 14 (overcurrent)"
    server.lines.clear()
    stream.stop("again")
    assert not any(line.startswith("SET") for line in server.lines)


def test_an_arm_and_its_hand_on_one_controller_grip_what_lies_between_the_fingers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next run is refused, so that what they hold is not carried through the cell."""
    pytest.importorskip("rtde_receive")
    from hrl_comfort.deploy import ur
    from hrl_comfort.deploy.hands import robotiq
    from tests.deploy.fake_ur import fake_ur

    for module in (robotiq, ur):  # on a busy machine nothing is lost
        monkeypatch.setattr(module, "STALE_S", 60.0)
    asked = config("gripper=robotiq_2f85")
    scene = scene_of(asked)
    scene.model.opt.gravity[:] = 0.0
    world = SimulatedHand(scene)
    objects = world.objects
    objects[0, :3] = world._data.site("robot/tcp").xpos
    with fake_ur(host(10), scene, scene.home, objects=objects):
        arm = ur_with_robotiq(host(10), 5.0, 40.0)
        steady = 0
        while steady < 100:  # the fingers settle on the object
            hand = arm.read().hand
            steady = steady + 1 if hand is not None and hand.fingers == Fingers.GRIP else 0
            arm.send(np.append(scene.home, 1.0))
            time.sleep(PERIOD_S)
        assert hand is not None and 0.3 < hand.closed < 0.9 and hand.trouble == ""
        link = Lockstep(lambda: arm, Limits.of(asked, scene), tmp_path / "log.bin")
        with pytest.raises(ConfigError, match="the hand holds something: take it out and open the fingers"):
            Run(asked, link, lambda: False)
        link.close()


class OnToolOutput:
    """See `World`; its fingers follow an output, and of what they do an input tells a grip alone."""

    def __init__(self, world: World) -> None:
        self._world, self._clock = RobotiqWorld(world), world
        self._hand = ToolHand(0.0, 0)

    def read(self) -> Reading:
        at_s = PERIOD_S * self._clock.ticks
        return replace(self._world.read(), hand=self._hand.follow(at_s, *self._world.bits()))

    def send(self, angles: NDArray[np.float64]) -> None:
        self._world.server.position = 255 * bool(angles[6] > SHUT)
        self._world.send(angles[:6])

    def lay(self, objects: NDArray[np.float64]) -> None:
        self._world.lay(objects)

    def close(self) -> None:
        self._world.close()


@pytest.mark.parametrize("lose", [False, True])
def test_a_hand_of_two_states_does_a_cycle_and_a_grip_that_is_lost_stops_the_arm(lose: bool, tmp_path: Path) -> None:
    asked = config("task=cycle")
    world = World(scene_of(asked), lose)
    run, log, why = run_in(asked, OnToolOutput(world), tmp_path)
    assert run.result.episodes[0].success is not lose
    if lose:
        stopped = int((log["planned"] == -2).to_numpy().argmax())
        assert "grip lost" in why and 0 < world.lost_at < stopped <= world.lost_at + NOTICED_TICKS
    else:
        assert why == "" and np.abs(world.objects[0, :3] - asked.cell.centre("ball", "right")).max() < 0.02


def test_fingers_of_two_states_are_reckoned_until_they_grip_or_are_there() -> None:
    shut = grips = 1 << 16
    hand = ToolHand(10.0, 0)
    assert hand.follow(10.0, 0, 0) == HandReading(0.0, Fingers.THERE)
    assert hand.follow(10.0, shut, 0) == HandReading(0.0, Fingers.MOVE)
    assert hand.follow(10.2, shut, 0) == HandReading(pytest.approx(0.4), Fingers.MOVE)
    assert hand.follow(10.3, shut, grips) == HandReading(pytest.approx(0.4), Fingers.GRIP)
    assert hand.follow(12.0, shut, grips) == HandReading(pytest.approx(0.4), Fingers.GRIP)
    assert hand.follow(12.002, shut, 0).fingers == Fingers.THERE
    assert hand.follow(13.0, shut, 0) == HandReading(1.0, Fingers.THERE)
    assert hand.follow(13.1, 0, grips) == HandReading(pytest.approx(0.8), Fingers.MOVE)
    assert hand.follow(13.6, 0, 0) == HandReading(0.0, Fingers.THERE)


def test_an_arm_switches_its_tool_output_and_hears_of_a_grip(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rtde_receive")
    from hrl_comfort.deploy import ur
    from tests.deploy.fake_ur import fake_ur

    monkeypatch.setattr(ur, "STALE_S", 60.0)
    scene = scene_of(config("gripper=two_finger"))
    scene.model.opt.gravity[:] = 0.0
    world = SimulatedHand(scene)
    objects = world.objects
    objects[0, :3] = world._data.site("robot/tcp").xpos
    with fake_ur(host(11), scene, scene.home, objects=objects):
        arm = ur.UrArm(host(11), 5.0, hand=True)
        assert arm.read().hand == HandReading(0.0, Fingers.THERE)
        for closed, wanted in ((1.0, Fingers.GRIP), (0.0, Fingers.THERE)):
            while (hand := arm.read().hand) is None or hand.fingers != wanted or (hand.closed > 0) != (closed > 0):
                arm.send(np.append(scene.home, closed))
                time.sleep(PERIOD_S)
        arm.close()


def test_a_late_cycle_is_done_and_a_late_grip_that_is_lost_by_force_is_noticed() -> None:
    assert cycle(0)["success"]
    assert cycle(0, pull_after=100)["noticed"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["connection.gripper=robotiq"], "connection.gripper=robotiq does not go with connection=simulated"),
        (["connection=ur", "confirm=ask"], "connection.gripper=none does not go with connection=ur"),
        (["connection=ur", "confirm=ask", "connection.gripper=robotiq"], "robot.gripper.name=two_finger; choose"),
        (["connection.gripper=tool_output"], "does not go with connection=simulated and robot.gripper.name=two_finger"),
        (["task=place"], "task.name=place begins with an object in the hand"),
        (["task=sort"], "task.objects=4: deploy follows one object"),
        (["connection=ur", "confirm=ask", "connection.gripper=robotiq", "gripper=robotiq_2f85", "episodes=2"],
         "episodes=2 would need somebody who lays the objects"),
    ],
)  # fmt: skip
def test_what_a_hand_is_not_run_with_is_refused(words: Sequence[str], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        deploy(config(*words))
