"""The page: a viser server that is never shared, behind a gate, with the walking keys."""

from __future__ import annotations

import hmac
import http
import ipaddress
import re
import secrets
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, redirect_stdout
from html import escape
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from io import StringIO
from typing import Any
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

COOKIE = "hrl_comfort_studio"
INDEX = ("/", "/index.html")
KEYS_PATH = "/studio/keys"
Answer = Callable[[Any, Request], Response | None]
"""(connection, request) -> response, or None where a websocket is to be opened."""
Change = Callable[[float], object]


def by_viewer(change: Callable[[Any], object]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """Return a callback of a control that calls `change` with the value which a viewer, not the program, has set.

    It runs in the server's event loop, at once: in a thread it might read what the program has written meanwhile.
    """

    async def changed(event: Any) -> None:
        if event.client is not None:
            change(event.target.value)

    return changed


def add_slider(gui: Any, label: str, limits: tuple[float, float], step: float, value: float, change: Change) -> Any:
    """Return a slider that calls `change` with what a viewer sets, within its limits.

    A typed number above them is replaced on the page by the limit. One below may be the beginning of another
    (0 of 0.5): the page replaces it once the field is left.
    """
    made = gui.add_slider(label, min=limits[0], max=limits[1], step=step, initial_value=value)

    def changed(given: float) -> None:
        if given > made.max:
            made.value = made.max
        change(min(max(given, made.min), made.max))

    made.on_update(by_viewer(changed))
    return made


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Gate:
    """Gate in front of the page.

    A request must come from the page itself, not from another site that the browser shows; a link on another site may
    open the page. On loopback its `Host` must be loopback too; elsewhere it must bring the token, in the address at
    first and then in a cookie.

    Args:
      host: address listened on.
      title: of the page.
      on_keys: called with the walking keys held, from the server's thread.
    """

    def __init__(self, host: str, title: str, on_keys: Callable[[frozenset[str]], None]) -> None:
        self.token = None if is_loopback(host) else secrets.token_urlsafe(16)
        self._title, self._on_keys = title, on_keys
        keys, *styles = (
            (files("hrl_comfort.studio") / name).read_text(encoding="utf-8")
            for name in ("keys.js", "card.css", "page.css")
        )
        self._head = f"<style>{''.join(styles)}</style><script>{keys}</script>"

    def allows(self, request: Request) -> bool:
        """Return whether a request is answered."""
        host = request.headers.get("Host", "")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return False
        if request.headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            link = request.headers.get("Sec-Fetch-Dest") == "document" and urlsplit(request.path).path in INDEX
            if not link:
                return False
        if self.token is None:
            return is_loopback(urlsplit(f"//{host}").hostname or "")
        return any(hmac.compare_digest(given.encode(), self.token.encode()) for given in _tokens(request))

    def answering(self, page: Answer) -> Answer:
        """Return the answers of viser's `page` behind the gate."""

        def answer(connection: Any, request: Request) -> Response | None:
            if not self.allows(request):
                return _plain(http.HTTPStatus.FORBIDDEN, "open the address that hrl-comfort studio printed")
            path = urlsplit(request.path)
            if path.path == KEYS_PATH:
                self._on_keys(frozenset(parse_qs(path.query).get("held", [""])[0]))
                return _plain(http.HTTPStatus.OK, "")
            index = path.path in INDEX and request.headers.get("Upgrade") != "websocket"
            if index:
                request.headers.pop("Accept-Encoding", None)  # the page is to be read here
            response = page(connection, request)
            return self._with_head(response) if index and response is not None else response

        return answer

    def _with_head(self, response: Response) -> Response:
        body = re.sub(rb"<title>.*?</title>", lambda _: f"<title>{escape(self._title)}</title>".encode(), response.body)
        body = body.replace(b"</head>", f"{self._head}</head>".encode(), 1)
        headers = Headers(response.headers)
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(body))
        if self.token is not None:
            headers["Set-Cookie"] = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        return Response(response.status_code, response.reason_phrase, headers, body)

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Put the gate in front of a viser server that is made meanwhile; viser has no hook of its own for it."""
        serve = websockets.asyncio.server.serve

        def behind_gate(*words: Any, process_request: Answer, **settings: Any) -> Any:
            return serve(*words, process_request=self.answering(process_request), **settings)

        websockets.asyncio.server.serve = behind_gate  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _tokens(request: Request) -> list[str]:
    """Return the tokens that a request brings, in its address and in its cookies."""
    found = parse_qs(urlsplit(request.path).query).get("token", [])
    try:
        cookie = SimpleCookie(request.headers.get("Cookie", ""))
    except CookieError:
        return found
    return [*found, *([cookie[COOKIE].value] if COOKIE in cookie else [])]


def _plain(status: http.HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status.value, status.phrase, headers, body)


APART_M = 3.0
"""Distance between the bases of two cells on the page."""
CAMERA_M, LOOK_AT_M = (0.85, -2.45, 1.3), (0.25, 0.0, 0.05)
UPRIGHT_FOV_RAD = 1.08
"""Vertical field of view of a scene that is higher than wide, as of the exported page."""
GREEN_RGB = (17, 49, 37)
"""Colour of which viser shows lighter shades: buttons in the exported page's #2b7a5b."""


class Page(viser.ViserServer):
    """A viser page that is never shared over the internet, behind a `Gate`.

    Args:
      host: address to listen on.
      port: port to listen on, or the next free one.
      shown: what the page shows, for its title.
    """

    def __init__(self, host: str, port: int, shown: str) -> None:
        self.on_keys: Callable[[frozenset[str]], None] = lambda keys: None
        self._asked_port = port
        self.gate = Gate(host, f"hrl-comfort: {shown}", lambda keys: self.on_keys(keys))
        with self.gate.installed(), redirect_stdout(StringIO()):  # its banner has the address without the token
            super().__init__(host=host, port=port, label="hrl-comfort studio", verbose=False)
        self.scene.configure_default_lights(cast_shadow=True)
        self.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium", brand_color=GREEN_RGB
        )
        self.on_client_connect(widen)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Return None: the page is not shared over the internet."""
        return None

    @property
    def address(self) -> str:
        """Address to open, with the token where one is needed."""
        host, token = self.get_host(), self.gate.token
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self.get_port()}" + (f"/?token={token}" if token else "")

    @property
    def announcement(self) -> str:
        """Line that says where the page is."""
        taken = self._asked_port not in (0, self.get_port())
        return f"studio: {self.address}" + (f" (port {self._asked_port} is taken)" if taken else "")


def widen(client: viser.ClientHandle) -> None:
    """Show as much of the cell to a viewer whose window is higher than wide, such as a phone."""
    if client.camera.aspect < 1:
        client.camera.fov = UPRIGHT_FOV_RAD


def set_camera(page: Page, cells: int) -> None:
    """Look at the cells from the front, far enough for all of them."""
    middle = APART_M * (cells - 1) / 2
    page.initial_camera.position = (CAMERA_M[0] + middle, CAMERA_M[1] * (1 + 0.5 * (cells - 1)), CAMERA_M[2])
    page.initial_camera.look_at = (LOOK_AT_M[0] + middle, *LOOK_AT_M[1:])
