"""Take the pictures of docs/studio.md in headless Chromium: `python -m docs.images.shoot_studio`, after `make page`.

A desktop and a phone are shown side by side.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import imageio.v3 as iio
import numpy as np
from playwright.sync_api import sync_playwright

from hrl_comfort.cli.main import configuration
from hrl_comfort.config import StudioConfig
from hrl_comfort.studio.server import LiveStudio
from hrl_comfort.studio.web.page import export_page
from tests.studio.browser import CHROMIUM, FLAGS, until

HERE = Path(__file__).parent
LEVELS = "policy=runs/reference/comfort_shift/levels0"
SHIELDED = "policy=runs/reference/shielded/seed2"
HEIGHT_PX, WIDTHS_PX = 700, {"desktop": 1000, "phone": 360}
GAP_PX = 12
SEEN_M = 0.4
"""x up to which the panel hides nobody near the arm."""
SHOWN = "getComputedStyle(document.querySelector('canvas[data-engine]') ?? document.body).opacity === '1'"
"""viser lets the scene appear slowly."""


def shots(browser: Any, address: str, devices: list[str], act: Callable[[], None]) -> np.ndarray:
    """Return a page as the devices show it, side by side, (H, W, 3) uint8; `act` runs once it is there."""
    pictures: list[np.ndarray] = []
    for device in devices:
        size, phone = {"width": WIDTHS_PX[device], "height": HEIGHT_PX}, device == "phone"
        page = browser.new_page(viewport=size, is_mobile=phone, has_touch=phone)
        page.set_default_timeout(120_000)
        page.goto(address)
        page.get_by_role("button", name="One decision", exact=True).wait_for()
        page.wait_for_function(SHOWN)
        for button in page.locator(".mantine-Notification-closeButton").all():
            button.dispatch_event("click")  # of a notice about software rendering
        act()
        page.wait_for_timeout(5000)
        pictures += [iio.imread(page.screenshot())[..., :3], np.full((HEIGHT_PX, GAP_PX, 3), 255, np.uint8)]
        page.close()
    return np.concatenate(pictures[:-1], axis=1)


def live(browser: Any, words: list[str], devices: list[str], act: Callable[[LiveStudio], None]) -> np.ndarray:
    """Return pictures of a live studio."""
    config = configuration("studio", [*words, "port=0", "frames_per_s=10"])
    assert isinstance(config, StudioConfig)
    studio = LiveStudio(config)
    studio.start()
    try:
        return shots(browser, studio.page.address, devices, lambda: act(studio))
    finally:
        studio.stop()


def at_level(studio: LiveStudio) -> None:
    """Play at level 3 until the person is near, and not behind the panel."""
    session, loop = studio.sessions[0], studio.loop

    def seen_near() -> bool:
        left = float(session.state.humans_pos[0, 0, 0]) < SEEN_M
        return int(session.state.steps) > 100 and (session.distance_m or 9.0) < 0.8 and left

    loop.ask(lambda: studio.panel.set_level(3))
    loop.ask(lambda: loop.set_running(True))
    until(seen_near, "a person near by")
    studio.panel.ask(lambda: loop.set_running(False))


def walk_in(studio: LiveStudio) -> None:
    """Drag the person to the arm until it is stopped."""
    session = studio.sessions[0]
    studio.loop.ask(lambda: studio.person.drag(-0.1, -0.45))
    until(lambda: float(session.state.share) == 0.0, "the arm is stopped")
    studio.panel.ask(lambda: studio.loop.set_running(False))


def main() -> None:
    """Write studio.png, shield.png and page.png."""
    with sync_playwright() as playwright, TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        both = list(WIDTHS_PX)
        iio.imwrite(HERE / "studio.png", live(browser, [LEVELS], both, at_level))
        iio.imwrite(HERE / "shield.png", live(browser, [SHIELDED, "human=still"], both[:1], walk_in))
        config = configuration("studio", [LEVELS, f"export={folder}/page.html"])
        assert isinstance(config, StudioConfig)
        address = export_page(config).as_uri()
        iio.imwrite(HERE / "page.png", shots(browser, address, both, lambda: time.sleep(3)))
        browser.close()


if __name__ == "__main__":
    main()
