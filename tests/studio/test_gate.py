"""Requests that are answered: those of the page itself on loopback, and with a token elsewhere; nothing is shared."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.studio.page import COOKIE, Page, is_loopback
from hrl_comfort.studio.server import on_plane


def status(address: str, **headers: str) -> int:
    request = urllib.request.Request(address, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    made = Page("127.0.0.1", 0, "a <b>policy</b>")
    yield made
    made.stop()


@pytest.fixture(scope="module")
def public() -> Iterator[Page]:
    made = Page("0.0.0.0", 0, "a policy")
    yield made
    made.stop()


def test_on_loopback_the_page_needs_no_token_and_answers_no_other_site(page: Page) -> None:
    assert page.gate.token is None and status(page.address) == 200
    assert status(page.address, Origin=page.address) == 200
    assert status(page.address, Origin="https://elsewhere.example") == 403
    assert status(page.address, Host="elsewhere.example") == 403  # a name that was made to lead to this machine


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_request_of_another_site_moves_nobody_and_a_link_there_opens_the_page(page: Page, site: str) -> None:
    pressed: list[frozenset[str]] = []
    page.on_keys = pressed.append
    other, keys = {"Sec-Fetch-Site": site}, f"{page.address}/studio/keys?held=w"
    for dest in ("image", "script", "iframe", "document", "empty", "websocket"):
        assert status(keys, **other, **{"Sec-Fetch-Dest": dest}) == 403
        assert status(page.address, **other, **{"Sec-Fetch-Dest": dest}) == (200 if dest == "document" else 403)
    assert status(keys, **other) == 403 and pressed == []
    assert status(keys, **{"Sec-Fetch-Site": "same-origin"}) == 200 and pressed == [frozenset("w")]


def test_the_page_is_titled_by_what_it_shows_and_that_is_text(page: Page) -> None:
    with urllib.request.urlopen(page.address, timeout=20) as answer:
        assert "<title>hrl-comfort: a &lt;b&gt;policy&lt;/b&gt;</title>" in answer.read().decode()


def test_a_taken_port_is_said(page: Page) -> None:
    other = Page("127.0.0.1", page.get_port(), "a policy")
    try:
        assert other.get_port() != page.get_port()
        assert other.announcement == f"studio: {other.address} (port {page.get_port()} is taken)"
        assert page.announcement == f"studio: {page.address}"
    finally:
        other.stop()


def test_the_page_brings_the_walking_keys_and_takes_them(page: Page) -> None:
    with urllib.request.urlopen(page.address, timeout=20) as answer:
        assert "/studio/keys?held=" in answer.read().decode()
    pressed: list[frozenset[str]] = []
    page.on_keys = pressed.append
    assert status(f"{page.address}/studio/keys?held=wq") == 200 and status(f"{page.address}/studio/keys?held=") == 200
    assert status(f"{page.address}/studio/keys?held=w", Origin="https://elsewhere.example") == 403
    assert pressed == [frozenset("wq"), frozenset()]


def test_elsewhere_the_token_is_asked_for_once_and_then_kept_in_a_cookie(public: Page) -> None:
    token = public.gate.token
    assert token is not None and token in public.address
    base = f"http://127.0.0.1:{public.get_port()}"
    assert status(base) == 403 and status(f"{base}/?token=wrong") == 403
    assert status(f"{base}/?token={token}") == 200
    assert status(base, Cookie=f"{COOKIE}={token}") == 200
    assert status(f"{base}/studio/keys?held=w") == 403


def test_the_page_is_never_shared(page: Page) -> None:
    assert page.request_share_url() is None


@pytest.mark.parametrize(
    ("host", "own"), [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("lab.org", False)]
)
def test_loopback_is_what_only_this_machine_reaches(host: str, own: bool) -> None:
    assert is_loopback(host) is own


def test_a_drag_meets_the_floor_where_the_pointer_is() -> None:
    import numpy as np

    camera = np.array([0.0, -3.0, 2.0])
    assert np.allclose(on_plane(camera, np.array([0.5, -1.5, 1.0]), 0.0), [1.0, 0.0, 0.0])
    assert on_plane(camera, np.array([0.0, -1.0, 2.0]), 0.0) is None  # level with the camera
    assert on_plane(camera, np.array([0.0, -1.0, 3.0]), 0.0) is None  # above the horizon
