"""Names, paths and messages are text on the page, whatever they hold."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import pytest

from hrl_comfort.studio.text import Text, bold, code, columns, mark, warning

HOSTILE = (
    """<iframe srcdoc="<script>hit()</script>"> <img src=x onerror='hit()'> &lt; **a** [b](javascript:hit()) `c`"""
)
STUDIO = Path(__file__).parents[2] / "hrl_comfort" / "studio"


class Read(HTMLParser):
    """The tags and the text of some markup."""

    def __init__(self, markup: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.text = ""
        self.feed(markup)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.add(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.parametrize(
    "form", [str, bold, code, mark, warning, lambda text: columns([(text, [text])], 1)], ids=lambda form: form.__name__
)
def test_hostile_text_comes_out_as_text(form) -> None:
    added: list[SimpleNamespace] = []
    gui = SimpleNamespace(add_html=lambda content: added.append(SimpleNamespace(content=content)) or added[-1])
    shown = Text(gui, "note", form(HOSTILE))
    shown.show(form(HOSTILE), HOSTILE)
    read = Read(added[0].content)
    assert read.text.count(HOSTILE) >= 2 and read.tags <= {"div", "b", "code", "span", "dl", "dt", "dd"}
    assert type(added[0].content) is str  # what viser can send


def test_no_other_part_of_the_studio_makes_markup() -> None:
    makers = re.compile(r"add_markdown|add_html|\.content = |Markup\(f|Markup\([a-z]")
    found = {path.name for path in STUDIO.rglob("*.py") if makers.search(path.read_text(encoding="utf-8"))}
    assert found == {"text.py"}
