"""Replay: episodes with failures first, levels side by side, and a time line that scrubs."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, StudioConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_folder import read_run, recorded
from hrl_comfort.studio.replay import ReplayStudio, tape
from tests.studio.browser import opened, until


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluation")
    words = [
        "task=cycle", "policy=random", "comfort=conditioned", "levels=[2,9]", "episodes=3", "record=true",
        "task.max_episode_steps=20", f"output={folder}",
    ]  # fmt: skip
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    evaluate(config)
    # An episode that succeeded at every level, which a random policy does not bring about.
    with (folder / "episodes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["success"] = str(row["episode"] == "0")
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder


def test_failures_come_first_and_levels_side_by_side(evaluation: Path) -> None:
    found = tape(evaluation)
    assert [each.episode for each in found.recordings] == [1, 2, 0] and found.cells == 2
    assert found.recordings[-1].title == "episode 0: level 2 success, level 9 success"
    assert all(
        take.title.startswith(f"level {level} ") for take, level in zip(found.recordings[0].takes, (2, 9), strict=True)
    )


def test_a_clip_shows_the_recorded_instants(evaluation: Path) -> None:
    path = recorded(read_run(evaluation), episodes=[1])[1].path
    take = tape(evaluation).recordings[0].takes[1]
    frame = take.clip.frame(7 * 0.02)
    assert np.allclose(frame.joints, path.loc[7, [f"q{joint}" for joint in range(6)]].to_numpy(dtype=float))
    assert np.allclose(frame.limbs[0, :2], path.loc[7, ["human_x", "human_y"]].to_numpy(dtype=float), atol=1e-9)


@pytest.mark.parametrize("name", ["nowhere", "empty"])
def test_a_folder_without_paths_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="is not a folder" if name == "nowhere" else "has no paths.csv"):
        tape(tmp_path / name)


def test_a_pause_by_the_time_line_holds_against_the_play(evaluation: Path) -> None:
    config = compose("studio", [f"replay={evaluation}", "port=0"])
    assert isinstance(config, StudioConfig)
    studio = ReplayStudio(config)  # its loop does not run: this test says in which order things happen
    try:
        end_s = studio.recording.duration_s
        studio.seek(0.0)  # the play wraps around between the viewer's move and its request
        studio.scrub(end_s)
        assert (studio.loop.running, studio.position_s, studio.time_line.value) == (False, end_s, end_s)
    finally:
        studio.page.stop()


def test_the_time_line_scrubs(browser: Any, evaluation: Path) -> None:
    config = compose("studio", [f"replay={evaluation}", "port=0", "frames_per_s=10"])
    assert isinstance(config, StudioConfig)
    studio = ReplayStudio(config)
    studio.start()
    try:
        with opened(browser, studio.page.address) as (page, wrong):
            page.get_by_text("level 2").first.wait_for()
            until(lambda: studio.position_s > 0, "it plays")
            line = page.get_by_role("slider").first
            line.focus()
            line.press("End")
            until(lambda: studio.position_s == pytest.approx(studio.recording.duration_s, abs=0.02), "the end")
            assert not studio.loop.running
            line.press("Home")
            until(lambda: studio.position_s == 0, "the beginning")
            assert wrong == []
    finally:
        studio.stop()
