"""A recording is an ordinary evaluation: the rows of an evaluation, a report, a motion file, a replay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, ReportConfig, StudioConfig
from hrl_comfort.files.run_config import load_config
from hrl_comfort.files.run_folder import read_run
from hrl_comfort.humans.motions.live import HELD
from hrl_comfort.humans.recordings import read_recordings
from hrl_comfort.report.report import report
from hrl_comfort.studio.person import Person, motion_config
from hrl_comfort.studio.recorder import Recorder
from hrl_comfort.studio.server import LiveStudio
from hrl_comfort.studio.session import Session
from tests.studio.browser import until
from tests.studio.test_session import sorting_config


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("studio")
    config = compose("studio", ["task=pick", "policy=potential_field", "human=still", f"output={output}"])
    assert isinstance(config, StudioConfig)
    HELD.pose = None
    session = Session(config)
    recorder = Recorder(session, output)
    while not session.over:  # as it comes
        recorder.add(session.step())
    session.reset()
    recorder.begin()
    person = Person([session], motion_config("live"), config.human)
    person.drag(1.5, -1.5)
    for decision in range(4):  # by hand, at two levels, cut short
        session.set_level(3 if decision < 2 else 8)
        recorder.add(session.step())
    folder = recorder.stop()
    session.close()
    return folder


def test_a_recording_has_the_rows_of_an_evaluation(recorded: Path) -> None:
    assert recorded.name == "recording_1" and isinstance(load_config(recorded), StudioConfig)
    run = read_run(recorded)
    episodes = run.episodes
    assert list(episodes["human"]) == ["still", "live"] and set(episodes["split"]) == {"live"}
    assert episodes["comfort_level"].isna().tolist() == [False, True] and episodes["truncated"].tolist() == [
        False,
        True,
    ]
    assert episodes["episode_seed"].isna().all()
    assert episodes["steps"].tolist()[1] == 20 and episodes["policy_steps"].tolist()[1] == 4
    paths = pd.read_csv(recorded / "paths.csv")
    assert (paths.groupby("episode").size() == episodes.set_index("episode")["steps"] + 1).all()
    assert set(paths[paths["episode"] == 1]["level"]) == {3, 5, 8} - ({5} if paths.iloc[-1]["level"] == 5 else set())


def test_an_option_that_is_left_for_a_forced_one_is_among_the_recorded_runs(tmp_path: Path) -> None:
    session = Session(sorting_config())
    recorder, first = Recorder(session, tmp_path), session.option
    session.force("wait")  # the first has not run yet
    recorder.add(session.step())
    session.force("wait")  # it goes on
    recorder.add(session.step())
    session.force(first)
    recorder.add(session.step())
    options = read_run(recorder.stop()).options
    session.close()
    assert options is not None
    found = options[["option", "start_step", "end_step", "cause"]]
    assert found.to_numpy().tolist() == [["wait", 0, 10, "interrupted"]]


def test_a_recorded_person_is_a_motion_file(recorded: Path) -> None:
    (motion,) = read_recordings(str(recorded / "human_1.csv"))
    path = pd.read_csv(recorded / "paths.csv").query("episode == 1")
    assert len(motion.yaw) == 21 and np.allclose(motion.position[:, 0], path["human_x"])
    assert np.hypot(*(motion.position[-1] - motion.position[0])) == pytest.approx(0.64, abs=0.01)


def test_a_recording_has_a_report(recorded: Path) -> None:
    page = report(ReportConfig(run=str(recorded), output=None, video=False))
    assert "potential_field" in page.read_text(encoding="utf-8")


def test_nothing_is_written_where_nothing_was_recorded(tmp_path: Path, recorded: Path) -> None:
    config = load_config(recorded)
    assert isinstance(config, StudioConfig)
    session = Session(replace(config, output=str(tmp_path)))
    with pytest.raises(ConfigError, match="nothing was recorded"):
        Recorder(session, tmp_path).stop()
    session.close()
    assert not list(tmp_path.iterdir())


def test_a_recording_under_way_is_written_when_the_studio_ends(tmp_path: Path) -> None:
    words = ["task=pick", "policy=expert", "human=still", "port=0", "record=true", f"output={tmp_path}"]
    config = compose("studio", words)
    assert isinstance(config, StudioConfig)
    studio = LiveStudio(config)
    studio.start()
    until(lambda: studio.sessions[0].decisions > 2, "some decisions")
    studio.stop()
    assert (tmp_path / "recording_1" / "episodes.csv").is_file()
