"""Text of the page: whatever is not `Markup` is shown as it is written."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from markupsafe import Markup


class Text:
    """Lines of text on the page.

    The page's markdown and HTML elements take raw markup, so every text of the studio goes through this class, which
    escapes names, paths and messages.

    Args:
      gui: of the page.
      kind: its class in page.css.
    """

    def __init__(self, gui: Any, kind: str, *lines: str) -> None:
        self._kind, self.lines = kind, lines
        self._handle = gui.add_html(self._content())

    def show(self, *lines: str) -> None:
        """Show lines; those that are not `Markup` are escaped."""
        if lines != self.lines:
            self.lines = lines
            self._handle.content = self._content()

    def _content(self) -> str:
        lines = Markup("").join(map(Markup("<div>{}</div>").format, self.lines))
        return str(Markup('<div class="studio-{}">{}</div>').format(self._kind, lines))


def bold(text: str) -> Markup:
    """Return bold text."""
    return Markup("<b>{}</b>").format(text)


def code(text: object) -> Markup:
    """Return the text of a command, a path or a key."""
    return Markup("<code>{}</code>").format(text)


def warning(text: object) -> Markup:
    """Return the text of an error."""
    return Markup('<span class="studio-warning">⚠ {}</span>').format(text)


def mark(text: str) -> Markup:
    """Return a red mark."""
    return Markup('<span class="studio-mark">● {}</span>').format(text)


def columns(rows: Iterable[tuple[str, Iterable[str]]], count: int) -> Markup:
    """Return rows of a name and `count` values as a list of definitions."""
    cells = Markup("").join(
        Markup("<dt>{}</dt>{}").format(name, Markup("").join(Markup("<dd>{}</dd>").format(each) for each in values))
        for name, values in rows
    )
    return Markup('<dl style="--columns: {}">{}</dl>').format(count, cells)
