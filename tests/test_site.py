"""The built site opens from disk: its links hold, search finds, the API shows shapes, the player plays (make docs)."""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

from tests.studio.browser import PATIENCE_S

SITE = Path(__file__).resolve().parent.parent / "build" / "docs" / "site"
DESKTOP = {"width": 1280, "height": 900}
PHONE = {"width": 390, "height": 844}
pytestmark = pytest.mark.site


class Page(HTMLParser):
    """Links, anchors and loaded files of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        self.anchors.update(value for name, value in found.items() if name in ("id", "name"))
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        if tag in ("script", "img", "iframe", "source"):
            self.loaded.append(found.get("src", ""))
        if tag == "link" and found.get("rel") != "canonical":
            self.loaded.append(found.get("href", ""))


@pytest.fixture(scope="module")
def pages() -> dict[Path, Page]:
    assert (SITE / "index.html").is_file(), "build the site first: make docs"
    return {path: Page(path) for path in SITE.rglob("*.html") if path.name not in ("player.html", "404.html")}


def test_no_page_loads_anything_from_the_network(pages: dict[Path, Page]) -> None:
    assert [(path.name, file) for path, page in pages.items() for file in page.loaded if urlsplit(file).netloc] == []


def test_every_link_and_every_loaded_file_is_there(pages: dict[Path, Page]) -> None:
    for path, page in pages.items():
        for target in (*page.links, *filter(None, page.loaded)):
            parts = urlsplit(target)
            if parts.scheme in ("http", "https", "mailto", "data", "javascript"):
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert file.is_file(), f"{path.relative_to(SITE)}: {target}"
            if parts.fragment and file in pages:
                assert unquote(parts.fragment) in pages[file].anchors, f"{path.relative_to(SITE)}: {target}"


@pytest.fixture
def shown(browser: Any) -> Iterator[Any]:
    """A tab without a network in which nothing goes wrong."""
    wrong: list[str] = []
    tab = browser.new_page(viewport=DESKTOP)
    tab.set_default_timeout(1000 * PATIENCE_S)
    tab.context.set_offline(True)
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("request", lambda request: wrong.append(request.url) if request.url.startswith("http") else None)
    yield tab
    tab.close()
    assert wrong == []


def test_search_finds_a_key(shown: Any) -> None:
    shown.goto((SITE / "index.html").as_uri())
    shown.get_by_role("button", name="Search").first.click()
    shown.keyboard.type("comfort.power")
    shown.locator("a[href*='configuration.html?h=comfort.power']").first.click()
    shown.wait_for_url("**/configuration.html*")
    shown.locator("td code", has_text="comfort.power").wait_for()


def test_the_api_shows_signatures_and_shapes(shown: Any) -> None:
    shown.goto((SITE / "api" / "tasks.html").as_uri())
    text = shown.locator("article").inner_text()
    assert "tool_distance(" in text
    assert "(N, 3)" in text
    shown.goto((SITE / "api" / "hrl_comfort.html").as_uri())
    assert "observations (N, D) to actions (N, A)" in shown.locator("article").inner_text()


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_the_player_plays(shown: Any, size: dict[str, int]) -> None:
    shown.set_viewport_size(size)
    shown.goto((SITE / "play.html").as_uri())
    frame = next(frame for frame in shown.frames if frame.url.endswith("player.html"))
    frame.wait_for_function("window.player")
    before = frame.evaluate("player.cell.state.steps")
    frame.wait_for_function(f"player.cell.state.steps != {before}")
    assert shown.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
