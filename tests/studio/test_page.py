"""The page in a real browser: it loads, moves, and obeys mouse, keys, slider and buttons."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import StudioConfig

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.studio.server import LiveStudio
from tests.studio.browser import opened, pixel, until


@dataclass
class Shown:
    studio: LiveStudio
    page: Any
    wrong: list[str]

    @property
    def session(self):
        return self.studio.sessions[0]

    def click(self, label: str) -> None:
        self.page.get_by_role("button", name=label, exact=True).dispatch_event("click")


@pytest.fixture(scope="module")
def shown(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    folder = tmp_path_factory.mktemp("studio")
    words = [
        "task=cycle", "policy=potential_field", "human=still", "human.spawn=points", "human.spawns_m=[[-0.55,-0.75]]",
        "human.spawn_jitter_m=0.0", "human.held_out=[]", "port=0", "frames_per_s=10", f"output={folder}",
    ]  # fmt: skip
    config = compose("studio", words)
    assert isinstance(config, StudioConfig)
    studio = LiveStudio(config)
    studio.start()
    try:
        with opened(browser, studio.page.address) as (page, wrong):
            page.get_by_role("button", name="Pause", exact=True).wait_for()
            assert page.title() == "hrl-comfort: potential_field"
            until(studio.page.get_clients, "the page is connected")
            yield Shown(studio, page, wrong)
    finally:
        studio.stop()


@pytest.fixture(autouse=True)
def running(shown: Shown) -> None:
    shown.studio.loop.ask(lambda: shown.studio.loop.set_running(True))
    shown.studio.loop.ask(lambda: shown.studio.panel.refresh(force=True))


def test_the_page_loads_from_its_own_server_alone_and_the_arm_moves(shown: Shown) -> None:
    joints = shown.session.state.joint_pos.clone()
    until(lambda: (shown.session.state.joint_pos - joints).abs().max() > 0.05, "the arm moves")
    assert shown.wrong == []


def test_pause_one_decision_and_reset(shown: Shown) -> None:
    shown.click("Pause")
    until(lambda: not shown.studio.loop.running, "paused")
    shown.page.get_by_role("button", name="Run", exact=True).wait_for()
    decisions = shown.session.decisions
    shown.click("One decision")
    until(lambda: shown.session.decisions == decisions + 1, "one decision")
    assert int(shown.session.state.steps) > 0
    shown.click("Reset")
    until(lambda: int(shown.session.state.steps) == 0, "a new episode")
    assert shown.session.decisions == decisions + 1
    shown.click("Run")
    until(lambda: shown.session.decisions > decisions + 2, "it runs again")


def test_a_person_dragged_to_the_arm_is_nearer_and_the_level_matters(shown: Shown) -> None:
    def response() -> float:
        actions = []
        for level in (1, 10):
            shown.session.set_level(level)
            actions.append(shown.session.action.clone())
        return float((actions[0] - actions[1]).abs().max())

    shown.click("Pause")
    until(lambda: not shown.studio.loop.running, "paused")
    shown.click("Reset")  # an episode that ended during the drag would leave the person where they are
    until(lambda: int(shown.session.state.steps) == 0, "a new episode")
    (client,) = shown.studio.page.get_clients().values()
    x, y = shown.session.walk.position[0]
    far = float(np.hypot(x, y))
    start, end = pixel(client.camera, (x, y, 0.35)), pixel(client.camera, (-0.2, -0.2, 0.35))
    for button in shown.page.locator(".mantine-Notification-closeButton").all():
        button.dispatch_event("click")  # of viser, about software rendering: with some fonts it covers the person
    until(lambda: not shown.page.locator(".mantine-Notification-root").count(), "the notice is gone")
    shown.page.mouse.move(*start)
    shown.page.mouse.down()
    for share in (0.3, 1.0):
        shown.page.mouse.move(*(np.array(start) + share * (np.array(end) - start)))
    until(lambda: shown.studio.person.taken, "the person is held")
    shown.page.mouse.up()
    shown.page.get_by_role("button", name="Let the person go").wait_for()
    shown.click("Run")
    until(lambda: np.hypot(*shown.session.walk.position[0]) < far - 0.25, "the person comes nearer")
    shown.click("Pause")
    until(lambda: not shown.studio.loop.running, "paused")
    shown.studio.play.reset()  # the arm at home, the person where they are
    assert response() > 0.1
    assert shown.wrong == []


def test_keys_walk_the_person_and_leave_the_camera(shown: Shown) -> None:
    (client,) = shown.studio.page.get_clients().values()
    camera, place = np.array(client.camera.position), shown.session.walk.position[0].copy()
    shown.page.keyboard.down("s")
    until(lambda: np.linalg.norm(shown.session.walk.position[0] - place) > 0.2, "the person walks")
    shown.page.keyboard.up("s")
    assert np.allclose(camera, client.camera.position)


def test_the_slider_sets_the_level_that_the_policy_sees(shown: Shown) -> None:
    level = shown.page.get_by_role("slider").first
    level.focus()
    level.press("End")
    until(lambda: float(shown.session.state.level) == 10, "level 10")
    level.press("Home")
    until(lambda: float(shown.session.state.level) == 1, "level 1")
    assert shown.wrong == []


def test_a_typed_level_that_is_too_high_is_shown_as_the_highest(shown: Shown) -> None:
    label = "xpath=//label[contains(., 'Comfort level')]/following::input[not(@type='hidden')][1]"
    shown.page.locator(label).fill("99")
    until(lambda: float(shown.session.state.level) == 10, "level 10")
    until(lambda: shown.page.locator(label).input_value() == "10", "it says 10")


def test_a_policy_that_is_not_there_is_said_as_text_and_the_page_stays(shown: Shown) -> None:
    hostile = "runs/<img src=x onerror='window.hit = 1'><iframe srcdoc=x></iframe>"
    shown.page.get_by_text("Policy", exact=True).dispatch_event("click")
    shown.page.locator("input[value='potential_field']").fill(hostile)
    shown.click("Swap policy")
    shown.page.get_by_text('<iframe srcdoc=x></iframe>" is not there').first.wait_for()
    assert shown.page.evaluate("window.hit === undefined && !document.querySelector('iframe, img[src=x]')")
    decisions = shown.session.decisions
    until(lambda: shown.session.decisions > decisions, "it goes on")
    assert shown.wrong == []
