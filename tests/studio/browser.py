"""A headless Chromium, and waiting for what a page does."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
REASON = "no Chromium here; on Debian or Ubuntu: apt-get install chromium"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE = {"width": 640, "height": 320}
PATIENCE_S = 180.0
HARMLESS = ("Unable to preventDefault inside passive event listener",)
"""Lines of viser's own page, which camera-controls writes where a scripted mouse scrolls or drags."""


@contextmanager
def opened(browser: Any, address: str, script: str = "", **settings: Any) -> Iterator[tuple[Any, list[str]]]:
    """Open a page, perhaps after a `script` of its own; yield it, and a list of what goes wrong.

    That are errors, and requests to anything but the page's server.
    """
    wrong: list[str] = []
    base = address.split("/?")[0]
    page = browser.new_page(**{"viewport": SIZE, **settings})
    page.add_init_script(script)
    page.set_default_timeout(1000 * PATIENCE_S)
    page.on("pageerror", lambda error: wrong.append(f"pageerror {error}"))
    page.on("console", lambda line: wrong.append(line.text) if is_error(line) else None)
    page.on("request", lambda request: None if base in request.url else wrong.append(f"request {request.url}"))
    page.goto(address)
    yield page, wrong
    page.close()


def is_error(line: Any) -> bool:
    """Return whether a line of the console is an error of the page."""
    return line.type == "error" and not line.text.startswith(HARMLESS)


def until(condition: Callable[[], object], what: str) -> None:
    """Wait until `condition` holds; fail with `what` after PATIENCE_S."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"not within {PATIENCE_S:g} s: {what}"
        time.sleep(0.02)


def pixel(camera: Any, point: tuple[float, float, float]) -> tuple[float, float]:
    """Return where on the page a point (m) is seen by a viser camera."""
    import viser.transforms

    turn = viser.transforms.SO3(np.asarray(camera.wxyz)).as_matrix()
    seen = turn.T @ (np.asarray(point) - np.asarray(camera.position))
    height = SIZE["height"] / 2 / np.tan(camera.fov / 2)
    return SIZE["width"] / 2 + height * seen[0] / seen[2], SIZE["height"] / 2 + height * seen[1] / seen[2]
