"""`hrl-comfort deploy`: a dry run in simulation, a typed word, then the same plan on an arm, in real time."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType

import numpy as np
import torch
from pandas import DataFrame
from rich.console import Console

from hrl_comfort.analysis.summary import with_totals
from hrl_comfort.analysis.tables import of_groups
from hrl_comfort.config import ConfigError, DeployConfig
from hrl_comfort.deploy.arms import Arm, Equipped, Fingers, SimulatedArm, SimulatedHand
from hrl_comfort.deploy.frame import Frame
from hrl_comfort.deploy.hands.robotiq import RobotiqHand
from hrl_comfort.deploy.links import Link, Lockstep, Paced
from hrl_comfort.deploy.robot import RobotEngine, sources_of
from hrl_comfort.deploy.stops import INTERRUPTED, GripLostError, StoppedError
from hrl_comfort.deploy.streamer import COLUMNS, HAND_COLUMNS, Limits
from hrl_comfort.deploy.ur import UrArm
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.evaluation.rollout import STALE, EpisodeRecorder, Result
from hrl_comfort.files.output import output_folder
from hrl_comfort.files.run_config import environment, save_config
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import ExecutedStep, execute
from hrl_comfort.progress import progress, success_of
from hrl_comfort.safety.drive import rating_of
from hrl_comfort.scene.workcell import Scene, scene_of

LOG = "setpoints.parquet"
"""Set-points that were sent, and the measured angles, in the output folder."""
WORD = "move"
"""Word that lets the arm move when typed."""
SPLIT = "live"
"""Value of the column `split` of an episode."""
OpenArm = Callable[[], Arm]


def deploy(config: DeployConfig, open_arm: OpenArm | None = None) -> Path:
    """Run the episodes of `config` on an arm, by default that of `connection`; return the folder of the tables.

    The folder holds what `hrl-comfort evaluate record=true` writes, and LOG.

    Raises:
      ConfigError: a policy does not fit, the dry run touches something, the word is not typed, no connection.
      StoppedError: the arm was brought to rest before the last episode was over; everything has been written.
    """
    refuse(config)
    config = settled(config)
    torch.set_num_threads(1)
    output = Path(config.output)
    with output_folder(output, DeployConfig, "config.yaml"):
        scene = scene_of(config)
        limits = Limits.of(config, scene)
        with interruption() as interrupted:
            rehearse(config, Lockstep(simulated(scene), limits, Path(os.devnull)), interrupted)
        confirm(config)
        opened = open_arm or arm_of(config, scene)
        log = output / "setpoints.bin"
        with interruption() as interrupted, closing(Paced(opened, limits, log)) as link:
            try:
                run = Run(config, link, interrupted)
            except ConfigError:
                log.unlink(missing_ok=True)  # nothing has moved: the folder stays as it was
                raise
            with closing(run):
                for name in (*STALE, "episodes.csv"):
                    (output / name).unlink(missing_ok=True)
                save_config(config, output / "config.yaml")
                try:
                    run.all()
                finally:
                    run.write(output)
    print(output)
    return output


def refuse(config: DeployConfig) -> None:
    """Raise ConfigError for what an arm is not run with."""
    robot, human, name = config.robot.name, config.human, config.connection.name
    if config.task.name in ("shift", "kitting"):
        repeated = config.task.name
        raise ConfigError(f"task.name={repeated} goes on after failures, which deploy does not; choose task=cycle")
    if config.robot.gripper.holds and config.task.name in ("place", "place_fine"):
        begins = config.task.name
        raise ConfigError(
            f"task.name={begins} begins with an object in the hand, which deploy does not; choose task=cycle"
        )
    if config.robot.gripper.holds and config.task.objects > 1:
        raise ConfigError(
            f"task.objects={config.task.objects}: deploy follows one object of a gripper; choose task=cycle"
        )
    if config.robot.gripper.holds and name == "ur" and config.episodes > 1:
        raise ConfigError(
            f"episodes={config.episodes} would need somebody who lays the objects for each one; choose episodes=1"
        )
    if config.split == "test":
        raise ConfigError("split=test is for hrl-comfort evaluate, which keeps its ledger; choose split=validation")
    if name == "ur" and not robot.startswith("ur"):
        raise ConfigError(f"robot.name={robot} is no arm of connection=ur; choose robot=ur3e, ur5e or ur10e")
    if name == "ur" and human.motion == "live" and human.file is None:
        raise ConfigError("human.file=null tells nobody's place beside a real arm; give human.file=udp://… or lsl:…")


def settled(config: DeployConfig) -> DeployConfig:
    """Return `config` with places in the frame of the robot's base, and make live positions of people come in it."""
    frame = Frame.taught(config.connection.frame_m) if config.connection.frame_m is not None else None
    for source in sources_of(config.human):
        source.moved = (lambda pose: pose) if frame is None else frame.pose
    return config if frame is None else frame.places(config)


def arm_of(config: DeployConfig, scene: Scene) -> OpenArm:
    """Return what opens the connection of `config`."""
    host, braking = config.connection.host, float(rating_of(config.robot).acceleration_rad_s2.min())
    if config.connection.name == "simulated":
        return simulated(scene)
    if config.connection.gripper == "robotiq":
        return partial(ur_with_robotiq, host, braking, config.robot.gripper.force_n)
    return partial(UrArm, host, braking, config.connection.gripper == "tool_output")


def simulated(scene: Scene) -> OpenArm:
    """Return what opens the arm of a scene in MuJoCo."""
    if scene.gripper is not None:
        return partial(SimulatedHand, scene)
    return partial(SimulatedArm, scene.model, scene.home)


def ur_with_robotiq(host: str, acceleration_rad_s2: float, force_n: float) -> Arm:
    """Connect to an arm and its hand; the hand first, since the arm's script stops without set-points."""
    hand = RobotiqHand(host, force_n)
    try:
        return Equipped(UrArm(host, acceleration_rad_s2), hand)
    except BaseException:
        hand.close()
        raise


class Run:
    """Episodes of a configuration on the arm of a link.

    Args:
      config: of the episodes.
      link: to the arm.
      interrupted: returns whether somebody wants the arm to stop.
      endure: see `RobotEngine`.

    Raises:
      ConfigError: a policy does not fit, or the hand holds something, which would fall on the way to the start.
    """

    def __init__(self, config: DeployConfig, link: Link, interrupted: Callable[[], bool], endure: bool = False) -> None:
        self.result = Result([], [], [])
        hand = link.report.reading.hand
        if hand is not None and hand.fingers == Fingers.GRIP:
            raise ConfigError("the hand holds something: take it out and open the fingers before the arm moves")
        self._config, self._link, self._entries = config, link, open_split(config).entries
        self._engine = RobotEngine(environment(config), link, self._entries, interrupted, endure)
        self._executor, self._top = make_executor(config, None, self._engine, config.first_seed)

    def lying(self) -> list[str]:
        """See `RobotEngine`; of the last episode that began."""
        return self._engine.lying()

    def close(self) -> None:
        """Stop listening to live levels; the link is its owner's."""
        self._engine.close()

    def all(self) -> None:
        """Run every episode; bring the arm to rest at the end, and where one is stopped.

        Raises:
          StoppedError: an episode was stopped; unless it was over, its row says that it was cut short.
        """
        try:
            what = f"{self._config.connection.name} {self._config.task.name}"
            with progress(what, self._config.episodes, thread=not self._link.paced) as show:
                for index in range(self._config.episodes):
                    self._episode(index)
                    show(index + 1, success_of([episode.success for episode in self.result.episodes]))
        except (StoppedError, ConnectionError) as error:
            stopped = error if isinstance(error, StoppedError) else StoppedError(f"lost connection: {error}")
            raise stopped from None
        finally:
            self._link.close()

    def _episode(self, index: int) -> None:
        entries, executor = self._entries.part(index, index + 1), self._executor.anew()
        recorder = EpisodeRecorder(self._config, None, self._engine, entries, self.result)
        taken: list[ExecutedStep] = []
        try:
            recorder.begin(self._engine.start(index))
            for executed in execute(self._engine, executor, self._top):
                taken.append(executed)  # told afterwards: the next plan has no time for tables
            self._link.rest()
            if self._link.report.stopped:
                raise StoppedError(self._link.report.stopped)
        except (StoppedError, ConnectionError) as error:
            if isinstance(error, StoppedError):
                self._link.stop(str(error))
            self._tell(recorder, taken, cut=True)
            if isinstance(error, GripLostError) and taken:
                lost = self.result.episodes[-1]
                self.result.episodes[-1] = replace(lost, drops=(lost.drops or 0) + 1)
            raise
        self._tell(recorder, taken, cut=False)
        gc.collect()  # not while the arm moves

    def _tell(self, recorder: EpisodeRecorder, taken: list[ExecutedStep], cut: bool) -> None:
        """Add an episode's decisions to the tables; `cut` says that the arm was stopped, before its end or after."""
        for each in taken:
            recorder.add(each.result, each.active, each.ended, each.runs)
        if cut and taken and not bool(taken[-1].ended.all()):
            recorder.cut(taken[-1].result)
        if taken:
            recorder.finish()

    def write(self, output: Path) -> None:
        """Write the tables of the episodes that began and the set-points."""
        summary = None
        if self.result.episodes:
            self.result.episodes[:] = [replace(row, split=SPLIT, slip_mm=None) for row in self.result.episodes]
            summary = self.result.write(output, self._config)
        log = output / "setpoints.bin"
        joints = len(self._engine.scene.home)
        names = [*COLUMNS, *(f"sent{k}" for k in range(joints)), *(f"q{k}" for k in range(joints))]
        if self._engine.scene.gripper is not None:
            names += HAND_COLUMNS
        rows = np.fromfile(log).reshape(-1, len(names))
        DataFrame(rows, columns=names).to_parquet(output / LOG, index=False)
        log.unlink()
        if summary is not None:
            Console().print(of_groups(with_totals(summary["groups"], self.result.table)))


def rehearse(config: DeployConfig, link: Link, interrupted: Callable[[], bool]) -> None:
    """Run the plan in simulation and tell what came out.

    Raises:
      ConfigError: the arm touches a table or itself, or its set-points break a limit.
    """
    with closing(Run(config, link, interrupted, endure=True)) as run:
        try:
            run.all()
        except StoppedError as error:
            if error.code == INTERRUPTED:
                raise
            raise ConfigError(f"dry run: {error}") from None
    episodes = run.result.episodes
    touched = [each.episode for each in episodes if each.other_collision != "none"]
    if touched:
        raise ConfigError(f"dry run: the arm touches a table or itself in episode {touched[0]}; nothing was moved")
    done = sum(each.success for each in episodes)
    touches = sum(each.contact for each in episodes)
    print(f"dry run: {done} of {len(episodes)} episodes succeed, {touches} touch the person")
    if config.robot.gripper.holds and config.connection.name != "simulated":
        print(f"lay, in the frame of the robot's base: {'; '.join(run.lying())}")


def confirm(config: DeployConfig) -> None:
    """Let somebody type WORD, unless `confirm=yes`; raise ConfigError where they do not."""
    if config.confirm == "yes":
        return
    connection = config.connection
    where = connection.host if connection.name == "ur" else "in simulation"
    print(f"type {WORD} and Enter to move {config.robot.name} {where}: ", end="", flush=True)
    if sys.stdin.readline().strip() != WORD:
        raise ConfigError(f"{WORD!r} was not typed; nothing was moved")


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Catch the first SIGINT; yield a function that tells whether it has come. The next one has its usual effect."""
    asked, before = False, signal.getsignal(signal.SIGINT)

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)
