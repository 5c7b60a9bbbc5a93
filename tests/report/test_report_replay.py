"""The replay in a report: offline, small, failures before successes, and it scrubs in a real browser."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import EvaluateConfig, ReportConfig
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.files.run_folder import read_run, recorded
from hrl_comfort.plots.tape import Tape
from hrl_comfort.report import replay as module
from hrl_comfort.report.replay import replays
from hrl_comfort.report.report import report
from tests.studio.browser import is_error

MOST_BYTES = 4_000_000


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replay")
    words = [
        "task=cycle", "policy=random", "comfort=conditioned", "levels=[2,5,9]", "episodes=3", "record=true",
        "task.max_episode_steps=20", f"output={folder}",
    ]  # fmt: skip
    config = compose("evaluate", words)
    assert isinstance(config, EvaluateConfig)
    evaluate(config)
    rows = pd.read_csv(folder / "episodes.csv")
    rows.assign(success=rows["episode"] == 0, truncated=rows["episode"] != 0).to_csv(
        folder / "episodes.csv", index=False
    )
    report(ReportConfig(run=str(folder), output=None, video=False))
    return folder


def test_failures_come_before_successes_at_the_lowest_and_the_highest_level(evaluation: Path) -> None:
    found, _ = replays([read_run(evaluation)])
    assert found is not None
    numbers = [re.search(r"episode (\d)", each["title"]) for each in found["episodes"]]
    assert [number and number[1] for number in numbers] == ["1", "2", "0"]
    assert [[take["title"].split()[1] for take in each["takes"]] for each in found["episodes"]] == [["2", "9"]] * 3


def test_the_last_picture_has_the_recorded_tool_and_person(evaluation: Path) -> None:
    found, _ = replays([read_run(evaluation)])
    assert found is not None
    take, moving = found["episodes"][0]["takes"][1], len(found["scenes"][0]["moving"])
    pictures = np.frombuffer(base64.b64decode(take["frames"]), dtype="<i2").reshape(len(take["times"]), moving + 1, 6)
    last = recorded(read_run(evaluation), episodes=[1])[1].path.iloc[-1]
    wanted = 1000 * last[["tcp_x", "tcp_y", "tcp_z", "human_x", "human_y"]].to_numpy(dtype=float)
    assert np.abs(pictures[-1, -1, :5] - wanted).max() <= 0.5
    assert take["times"][-1] == pytest.approx(0.02 * last["step"])


def test_a_page_never_holds_more_than_its_share(evaluation: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_BYTES", 1)
    found, _ = replays([read_run(evaluation)])
    assert found is not None and len(found["episodes"]) == 1


def test_quantities_over_time_are_the_worst_between_two_pictures_and_only_those_there_are(evaluation: Path) -> None:
    run = read_run(evaluation)
    take = Tape(run).recordings[0].takes[0]
    path = take.path.assign(human_distance_m=1.0, shield_share=1.0)
    path.loc[path.index[5], ["human_distance_m", "shield_share"]] = 0.25, 0.5
    rows = [0, 4, 8]
    shielded = replace(take, tape=Tape(replace(run, config={**run.config, "safety": {"kind": "ssm"}})), path=path)
    distance, speed, share = module.series(shielded, rows).values()
    assert (distance.tolist(), share.tolist()) == ([1.0, 0.25, 1.0], [100.0, 50.0, 100.0])
    tool = np.linalg.norm(np.diff(take.tool, axis=0), axis=1) / 0.02
    assert speed == pytest.approx([tool[:3].max(), tool[3:7].max(), tool[7:].max()])
    assert list(module.series(replace(take, path=path.assign(human_distance_m=50.0)), rows)) == [
        "speed of the tool (m/s)"
    ]


def test_a_report_without_paths_or_with_a_foreign_cell_says_why(evaluation: Path, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("robot: {name: none}\ncell: {}\ntask: {}\n")
    for name in ("episodes.csv", "paths.csv"):
        (tmp_path / name).write_bytes((evaluation / name).read_bytes())
    page = report(ReportConfig(run=str(tmp_path), output=None, video=False)).read_text()
    assert "No replay: " in page and "has another config.yaml" in page
    (tmp_path / "paths.csv").unlink()
    page = report(ReportConfig(run=str(tmp_path), output=None, video=False)).read_text()
    assert "No replay: " in page and "getContext" not in page


def test_the_page_loads_offline_plays_and_scrubs(browser: Any, evaluation: Path) -> None:
    file, wrong = evaluation / "report.html", []
    assert file.stat().st_size < MOST_BYTES
    page = browser.new_page()
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda line: wrong.append(line.text) if is_error(line) else None)
    page.on(
        "request", lambda request: None if request.url.startswith(("file:", "data:")) else wrong.append(request.url)
    )
    page.goto(file.as_uri())
    figure = page.locator("#replay")

    def picture() -> Any:
        return page.evaluate("document.querySelector('#replay canvas').toDataURL()")

    def clock() -> str:
        return str(page.evaluate("document.querySelector('#replay output').value"))

    first = picture()
    figure.locator("input").focus()
    figure.locator("input").press("End")
    assert picture() != first and clock().split(" s of ")[0] == clock().split(" s of ")[1].removesuffix(" s")
    figure.locator("input").press("Home")
    assert picture() == first and clock().startswith("0.0 s")
    figure.locator("button").click()
    page.wait_for_function("document.querySelector('#replay button').textContent == 'Play'")
    assert not clock().startswith("0.0 s")
    figure.locator("select").select_option(index=2)
    assert clock().startswith("0.0 s") and picture() != first
    assert wrong == []
    page.close()
