"""Parameters by hand and a training from the page, in a real browser."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from html import unescape
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, StudioConfig, TrainConfig

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.studio.server import LiveStudio
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.tune.draft import Draft, overlay, overrides_of, training_overrides
from hrl_comfort.studio.tune.training import Training
from tests.studio.browser import opened, until


def config_of(*words: str) -> StudioConfig:
    config = compose("studio", ["task=reach", "policy=expert", "human=still", *words])
    assert isinstance(config, StudioConfig)
    return config


@pytest.fixture(scope="module")
def shown(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[LiveStudio, Any, list[str]]]:
    studio = LiveStudio(config_of("port=0", "frames_per_s=10", f"output={tmp_path_factory.mktemp('tuning')}"))
    studio.start()
    try:
        with opened(browser, studio.page.address) as (page, wrong):
            page.get_by_role("button", name="Pause", exact=True).wait_for()
            for folder in ("Parameters", "reward", "human", "Train", "agent"):
                page.locator(f"xpath=//div[text()='{folder}'][*[contains(@class,'chevron-down')]]").dispatch_event(
                    "click"
                )
            yield studio, page, wrong
    finally:
        studio.stop()


def field(page: Any, label: str) -> Any:
    """Return the input after a label; viser does not tie the two, and may break a label after an underscore."""
    return page.locator(f"xpath=(//label[translate(., '\u200b', '')='{label}'])[last()]/following::input[1]")


def fill(page: Any, label: str, text: str) -> None:
    field(page, label).fill(text)


def click(page: Any, label: str) -> None:
    page.get_by_role("button", name=label, exact=True).dispatch_event("click")


def test_the_overrides_of_a_configuration_give_it_again() -> None:
    config = config_of("human=patrol", "task.precision.grasp_tolerance_m=0.2", "comfort=gentle")
    assert Draft("studio", overrides_of("studio", config)).config == config


def test_a_draft_refuses_a_value_and_stays_and_a_choice_drops_changes_of_its_section() -> None:
    draft = Draft("studio", {"task": "task=reach"})
    before = draft.config
    with pytest.raises(ConfigError, match=r"human\.speed_m_s"):
        draft.set("human.speed_m_s", "-1")
    assert draft.config == before and draft.changed == {}
    draft.set("human.keep_out_m", "0.5")
    draft.set("human", "patrol")
    assert draft.changed == {"human": "human=patrol"} and draft.value("human.motion") == "patrol"


def test_of_two_quick_edits_of_different_keys_both_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    draft = Draft("studio", {"task": "task=reach"})
    other = Thread(target=draft.set, args=("reward.contact", "-77"))

    def slow(root: str, lines: Iterable[str]) -> str:
        if not other.ident:  # the other edit comes while the first is composed
            other.start()
            other.join(timeout=0.1)
        return " ".join(lines)

    monkeypatch.setattr("hrl_comfort.studio.tune.draft.compose", slow)
    draft.set("human", "patrol")
    other.join()
    assert draft.config == "task=reach human=patrol reward.contact=-77" == " ".join(draft.lines.values())


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("cell=bench",), "cell"),
        (("cell=bench", "cell.places.left.top_m=[0.3,0.3,0.01]"), "cell.places"),
        (("cell.obstacles.post={shape:cylinder,position_m:[0.5,0.5,0],size_m:[0.1,0.7]}",), "cell.obstacles"),
    ],
)
def test_the_overrides_of_another_cell_give_that_cell(words: tuple[str, ...], key: str) -> None:
    config = config_of(*words)
    lines = overrides_of("studio", config)
    assert key in lines and Draft("studio", lines).config.cell == config.cell


def test_a_training_for_a_cell_without_levels_has_none() -> None:
    asked = Session(config_of()).asked
    lines = training_overrides(Draft("studio", overrides_of("studio", asked)), Draft("train", {"agent": "agent=quick"}))
    assert not any(line.startswith("comfort") for line in lines.values())


def test_an_overlay_gives_the_training_that_the_overrides_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from omegaconf import OmegaConf

    studio = Draft("studio", overrides_of("studio", config_of("human=patrol", "reward.contact=-7")))
    lines = training_overrides(studio, Draft("train", {"agent": "agent=quick", "agent.gamma": "agent.gamma=0.9"}))
    trained = compose("train", lines.values())
    assert isinstance(trained, TrainConfig)
    assert (trained.task.name, trained.human.motion, trained.reward.contact) == ("reach", "patrol", -7)
    node = OmegaConf.create(overlay(lines))
    assert overlay(lines).startswith("# @package _global_\n")
    assert node.reward.contact == -7 and node.agent.gamma == 0.9
    assert [dict(each) for each in node.defaults] == [
        {"override /task": "reach"}, {"override /human": "patrol"}, {"override /agent": "quick"},
    ]  # fmt: skip


def test_a_parameter_takes_effect_at_the_next_reset_and_the_page_says_so(shown: tuple[LiveStudio, Any, Any]) -> None:
    studio, page, wrong = shown
    click(page, "Pause")
    until(lambda: not studio.loop.running, "paused")
    fill(page, "contact", "-77")
    page.get_by_text("reward.contact=-77").first.wait_for()
    page.get_by_text("At the next reset").first.wait_for()
    click(page, "Reset")
    until(lambda: studio.sessions[0].config.reward.contact == -77, "the new reward")
    until(lambda: page.get_by_text("At the next reset").count() == 0, "it is in force")
    click(page, "Run")
    decisions = studio.sessions[0].decisions
    until(lambda: studio.sessions[0].decisions > decisions, "it goes on")
    fill(page, "contact", "many")
    page.get_by_text("⚠").first.wait_for()
    assert studio.tuning.draft.value("reward.contact") == -77
    fill(page, "contact", "-77")
    assert wrong == []


def test_the_controller_of_a_chain_is_changed_at_the_next_reset() -> None:
    chain = [f"policies.{name}=expert" for name in ("pick", "place", "return")]
    config = compose("studio", ["task=cycle", "meta_controller=nearest", *chain, "human=still", "port=0"])
    assert isinstance(config, StudioConfig)
    studio = LiveStudio(config)
    studio.loop.running = False
    studio.start()
    try:
        studio.tuning.draft.set("meta_controller.retries", "3")
        studio.loop.ask(studio.play.reset)
        until(lambda: studio.sessions[0].executor.retries == 3, "another number of retries")
        with pytest.raises(ConfigError, match=r"^policies\.return is not used by .*; its parts are pick, place$"):
            studio.tuning.draft.set("meta_controller.options", "[pick,place]")
        studio.tuning.draft.set("meta_controller.options", "[pick,return,place]")
        studio.loop.ask(studio.play.reset)
        refused = "meta_controller.options=['pick', 'return', 'place'] do the stages"
        until(lambda: refused in unescape(" ".join(studio.tuning._said.lines)), "refused")
        assert studio.sessions[0].options == ["pick", "place", "return"]
    finally:
        studio.stop()


def test_the_curves_of_a_sweep_are_in_the_order_of_its_jobs(tmp_path: Path) -> None:
    training = Training(tmp_path)
    training.folder = tmp_path / "training_1"
    for job in (0, 1, 2, 10):
        (training.folder / str(job)).mkdir(parents=True)
        rows = "" if job == 1 else f"100,0,0.1,{job / 10},0.0,9\n"
        (training.folder / str(job) / "metrics.csv").write_text(
            f"policy_steps,episodes,precision_m,success,return,steps\n{rows}"
        )
    _, *curves = training.curves()
    np.testing.assert_equal([curve[-1] for curve in curves[:5]], [0.0, np.nan, 0.2, 1.0, np.nan])


def test_a_sweep_has_a_curve_for_each_job_and_goes_on_when_it_is_given_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(Training, "_run", lambda self, words: started.append(words))
    training = Training(tmp_path)
    with pytest.raises(ConfigError, match="quot"):
        training.start([], "train_seed='0,1")
    folder = training.start(["task=reach", "train_seed=7"], "train_seed=0,1")
    assert started[-1] == ["-m", "task=reach", "train_seed=0,1", f"output={folder}"]
    for job in (0, 1):
        (folder / str(job)).mkdir(parents=True)
        (folder / str(job) / "policy.pt").touch()
        rows = "".join(f"{100 * (row + 1)},0,0.1,{0.1 * job},0.0,9\n" for row in range(2 + job))
        (folder / str(job) / "metrics.csv").write_text(
            f"policy_steps,episodes,precision_m,success,return,steps\n{rows}"
        )
    os.utime(folder / "0" / "policy.pt", (0, 0))
    assert training.newest() == str(folder / "1" / "policy.pt")
    steps, first, second, *others = training.curves()
    assert steps.tolist() == [100, 200, 300] and second.tolist() == [0.1] * 3
    assert first[:2].tolist() == [0, 0] and np.isnan(first[2]) and np.isnan(others).all()
    training.resume()
    assert started[-1] == started[-2]
    training.start(["task=reach"])
    assert started[-1] == ["task=reach", f"output={training.folder}"]


def test_how_the_person_moves_takes_effect_at_once(
    shown: tuple[LiveStudio, Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    studio, page, wrong = shown
    note, lines = studio.tuning._said, list[str]()  # the next reset takes it away again
    show = note.show
    monkeypatch.setattr(note, "show", lambda *said: (lines.extend(map(str, said)), show(*said)))
    field(page, "human").click()
    page.get_by_role("option", name="patrol", exact=True).last.click()
    until(lambda: studio.sessions[0].engine.episodes.config.human.motion == "patrol", "the person patrols")
    until(lambda: "In force: human" in lines, "it is said")
    assert wrong == []


def test_a_training_is_started_watched_stopped_and_resumed(shown: tuple[LiveStudio, Any, Any]) -> None:
    studio, page, wrong = shown
    training = studio.tuning.training
    for label, text in {
        "policy_steps": "20000", "learning_starts": "100", "log_every": "100", "checkpoint_every": "100",
        "batch_size": "32", "hidden": "[16]",
    }.items():  # fmt: skip
        fill(page, label, text)
        until(lambda label=label, text=text: str(studio.tuning.learner.value(f"agent.{label}")) == text, label)
    click(page, "Watch newest checkpoint")
    page.get_by_text("there is no checkpoint yet").first.wait_for()
    click(page, "Start training")
    until(lambda: training.folder is not None and list(training.folder.glob("checkpoints/step_*.pt")), "a checkpoint")
    until(lambda: len(training.curves()[0]) > 1, "a curve")
    click(page, "Watch newest checkpoint")
    until(lambda: str(studio.sessions[0].config.policy).endswith("policy.pt"), "the checkpoint plays")
    click(page, "Stop training")
    until(lambda: not training.running, "it is stopped")
    steps = training.curves()[0][-1]
    click(page, "Resume training")
    until(lambda: training.curves()[0][-1] > steps, "it goes on")
    training.stop()
    click(page, "Save overlay")
    until(lambda: list(training.folder.parent.glob("overlay.yaml")), "the overlay")  # type: ignore[union-attr]
    assert wrong == []
