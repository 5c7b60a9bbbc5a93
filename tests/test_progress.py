"""Progress without a terminal: a plain line now and then."""

from __future__ import annotations

from hrl_comfort import progress as module
from hrl_comfort.progress import progress, success_of


def test_without_a_terminal_a_plain_line_says_where_it_is(monkeypatch, capsys):
    clock = iter([0.0, 10.0, 40.0, 50.0, 80.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with progress("train pick", 1000, 200) as show:
        for now in (300, 400, 500, 600):
            show(now, success_of([True, False]))
    assert capsys.readouterr().err.splitlines() == [
        "train pick: 400 of 1000, success 50%, left 0:02:00",
        "train pick: 600 of 1000, success 50%, left 0:01:20",
    ]
