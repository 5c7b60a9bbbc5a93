"""Videos of a report show the episodes that matter, from a side from which they can be seen."""

import ast
import sys
from dataclasses import replace

import numpy as np
import pytest
from pandas import DataFrame

from hrl_comfort.config import ConfigError, ReportConfig
from hrl_comfort.files import run_folder
from hrl_comfort.plots import video
from hrl_comfort.plots.tape import Tape
from hrl_comfort.report import videos as module
from hrl_comfort.report.videos import videos
from hrl_comfort.scene.camera import PicturesUnavailableError
from tests.report.demo import levels_of


def test_without_egl_the_page_names_the_packages(demo, monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    config = ReportConfig(run=str(demo), output=None, video=True)
    found, why = videos(run_folder.find_runs(demo), config)
    assert not found
    assert "libegl1 libegl-mesa0 libgl1-mesa-dri" in why


@pytest.fixture
def undrawn(monkeypatch):
    """Write a video as the length of each of its episodes, its speed, azimuth, begin and end; draw nothing."""
    monkeypatch.setattr(video, "frames", lambda take, *words: (len(take.path), words))
    monkeypatch.setattr(video, "beside", list)
    monkeypatch.setattr(video, "write_video", lambda file, episodes: file.write_text(repr(episodes)))


def test_a_failure_is_shown_before_a_success_or_the_episode_that_was_asked_for(demo, undrawn, monkeypatch):
    runs = run_folder.find_runs(demo)
    found, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=True))
    assert [caption.split(";")[0] for _, caption in found] == [
        "cycle, episode 3, unsafe contact", "cycle, episode 0, success",
    ]  # fmt: skip
    monkeypatch.setattr(module, "LONGEST_S", 0.04)
    found, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=True))
    assert all(caption.endswith(", real time, the last 0.04 s.") for _, caption in found)
    ((_, (_, _, begin_s, end_s)),) = ast.literal_eval((demo / "cycle" / "eval" / "failure.mp4").read_text())
    assert begin_s > 0.04 and end_s is None
    found, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=True, episode=2, speed=0.5))
    assert [caption for _, caption in found] == ["cycle, episode 2, success; drawn from its joint angles, half speed."]
    assert "(0.5," in (demo / "cycle" / "eval" / "video.mp4").read_text()
    kept, _ = videos(runs, ReportConfig(run=str(demo), output=None, video=False))
    assert len(kept) == 2, "those of before"
    with pytest.raises(ConfigError, match="episode=20 is not recorded"):
        videos(runs, ReportConfig(run=str(demo), output=None, video=True, episode=20))
    for name in module.FILES.values():
        (demo / "cycle" / "eval" / name).unlink()


def test_the_first_and_the_last_level_are_drawn_beside_each_other_from_one_side(demo, tmp_path, undrawn, monkeypatch):
    folder = tmp_path / "pick"
    runs = levels_of(demo, folder)
    found, _ = videos(runs, ReportConfig(run=str(folder), output=None, video=True, episode=1))
    assert "episode 1 at level 1 (left: success) and at level 10 (right: success);" in found[0][1]
    (one, here), (other, there) = ast.literal_eval((folder / "eval" / "video.mp4").read_text())
    assert one == other and here == there
    monkeypatch.setattr(module, "LONGEST_S", 0.04)
    found, _ = videos(runs, ReportConfig(run=str(folder), output=None, video=True))
    assert found[0][1].endswith(", real time, the first 0.04 s.")
    for _, (_, _, begin_s, end_s) in ast.literal_eval((folder / "eval" / "video.mp4").read_text()):
        assert (begin_s, end_s) == (0.0, 0.04)


def test_pictures_beside_each_other_last_as_long_as_the_longest():
    short, long = (iter([np.full((2, 3, 3), k) for k in range(n)]) for n in (1, 3))
    pictures = list(video.beside([short, long]))
    assert [each.shape for each in pictures] == [(2, 6, 3)] * 3 and pictures[2][0, :, 0].tolist() == [0] * 3 + [2] * 3


@pytest.mark.parametrize("angle", np.arange(0, 360, 20))
def test_the_camera_sees_person_and_tool_beside_each_other(angle):
    x, y = 0.7 * np.cos(np.radians(angle)), 0.7 * np.sin(np.radians(angle))
    path = DataFrame({"human_x": [x] * 5, "human_y": y, "tcp_x": 0.0, "tcp_y": 0.0})
    view = np.radians(video.azimuth_deg(path))
    across, ahead = x * np.sin(view) - y * np.cos(view), x * np.cos(view) + y * np.sin(view)
    assert 0.5 < abs(across) < 1.1 and ahead > -0.2
    assert video.azimuth_deg(path.assign(human_x=50.0)) == video.ALONE_DEG


def test_an_episode_is_drawn_to_an_mp4(demo, tmp_path):
    run = run_folder.find_runs(demo)[0]
    (take,) = next(each.takes for each in Tape(run).recordings if each.episode == 0)
    try:
        file = video.write_video(tmp_path / "video.mp4", video.frames(replace(take, path=take.path[:12])))
        duration_s = take.clip.duration_s
        last = list(video.frames(take, begin_s=duration_s - 0.08))
        whole = list(video.frames(take))
        assert len(last) == 3 < len(whole) == round(duration_s * video.FRAMES_PER_S) + 1
        assert (last[2] == whole[-1]).all() and len(list(video.frames(take, end_s=0.08))) == 3
    except PicturesUnavailableError as error:
        pytest.skip(f"nothing can be drawn off screen here: {error}")
    data = file.read_bytes()
    assert data[4:8] == b"ftyp"
    assert len(data) > 2000
