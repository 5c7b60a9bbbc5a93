"""The panel without a browser: what it shows is what is in force, in the words of the exported page."""

from __future__ import annotations

import re
import signal
import socket
from collections.abc import Callable, Iterator
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, StudioConfig

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.humans.motions.live import HELD
from hrl_comfort.streams import UdpStream
from hrl_comfort.studio import panel as module
from hrl_comfort.studio import server
from hrl_comfort.studio.panel import HIGHEST, LOWEST, NO_LEVEL, option_values, readout
from hrl_comfort.studio.person import motion_config
from hrl_comfort.studio.server import LiveStudio, made
from hrl_comfort.studio.text import mark

PAGE = Path(__file__).parents[2] / "hrl_comfort" / "studio" / "web" / "page.html"
Make = Callable[..., LiveStudio]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    """Make studios whose loops do not run."""
    made: list[LiveStudio] = []

    def studio(*words: str) -> LiveStudio:
        HELD.pose = HELD.hands = None
        config = compose("studio", ["task=pick", "human=still", "port=0", f"output={tmp_path}", *words])
        assert isinstance(config, StudioConfig)
        made.append(LiveStudio(config))
        return made[-1]

    yield studio
    for each in made:
        each.loop.running = False
        each.start()
        each.stop()


def test_the_panel_has_the_words_of_the_exported_page(make: Make) -> None:
    studio = make("policy=random", "robot.rating=collaborative")
    page, rows = PAGE.read_text(encoding="utf-8"), dict(readout(studio.sessions, "still"))
    assert set(re.findall(r"<dt.*?>(.*?)</dt>", page)) == rows.keys() - {"person"}
    assert f"1: {LOWEST}" in page and NO_LEVEL in page
    assert f"levels}}: {HIGHEST}" in (PAGE.parent / "src" / "controls.js").read_text(encoding="utf-8")


TOP = """
import torch

class Numbered:
    def choose(self, decision):
        return self.values(decision).masked_fill(~decision.mask, -1.0).argmax(dim=1)

    def values(self, decision):
        return torch.arange(len(decision.table)).expand(decision.mask.shape) / 10

class Sure(Numbered):
    quantity = "probability"
"""
SORTING = ("task=sort", "task.objects=3", *(f"policies.{name}=random" for name in ("pick", "place", "return")))


def test_the_readout_lists_the_options_with_their_values_and_marks_the_one_in_force(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numbered.py").write_text(TOP, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    panel = make(*SORTING, "meta_controller=numbered:Numbered", "meta_controller.max_waits=0").panel
    able = [("pick_3", ["0.20"]), ("pick_2", ["0.10"]), ("pick_1", ["0.00"])]
    assert option_values(panel.session) == [("options", ["value"]), ("▸ pick_3", ["0.20"]), *able[1:]]
    panel.session.force("pick_1")
    assert option_values(panel.session) == [("options", ["value"]), *able[:2], ("▸ pick_1", ["0.00"])]
    monkeypatch.setattr(module, "SHOWN_VALUES", 1)
    assert [name for name, _ in option_values(panel.session)] == ["options", "pick_3", "▸ pick_1"]
    assert "▸ pick_1" in "".join(panel._lines())
    sure = make(*SORTING, "meta_controller=numbered:Sure", "meta_controller.max_waits=0").panel
    assert option_values(sure.session) == [("options", ["probability"]), ("▸ pick_3", ["20%"])]


def test_a_top_without_values_is_not_said_to_have_any(make: Make) -> None:
    panel = make(*SORTING, "meta_controller=nearest").panel
    assert not panel.session.values and "▸" not in "".join(panel._lines())


def test_the_slider_leads_or_follows_and_the_source_says_which(make: Make) -> None:
    panel = make("policy=expert", "comfort=conditioned").panel
    assert panel._source.visible and panel._source.value == "random" and not panel.session.by_hand
    panel.set_level(3)
    assert panel._source.value == "slider" and panel._level.value == 3 and float(panel.session.state.level) == 3
    panel._take_source("random")
    assert not panel.session.by_hand
    panel.session.reset()
    panel.refresh(force=True)
    assert panel._level.value == float(panel.session.state.level)


def test_there_is_no_slider_where_no_policy_acts_on_the_level(make: Make) -> None:
    panel = make("policy=random", "comfort=conditioned").panel
    assert not panel._level.visible and not panel._again.visible and not panel._source.visible
    assert panel._ends.lines == (NO_LEVEL,)
    panel.swap_to("expert")
    assert panel._level.visible and panel._again.visible and panel._source.visible


def test_the_same_episode_is_begun_at_the_other_end_of_the_levels_in_one_click(make: Make) -> None:
    panel = make("policy=expert").panel
    episode = int(panel.session.engine.episodes.episode[0])
    for level in (10, 1, 10):
        assert panel._again.label == f"Same at level {level}"
        panel._repeat_otherwise()
        panel.refresh(force=True)
        assert float(panel.session.state.level) == panel._level.value == level
    assert int(panel.session.engine.episodes.episode[0]) == episode


def test_a_recording_is_marked_until_it_ends(make: Make) -> None:
    studio = make("policy=random")
    studio.records.toggle()
    studio.panel.refresh(force=True)
    assert mark("recording") in studio.panel._readout.lines
    studio.play.advance()
    studio.records.write()
    studio.panel.refresh(force=True)
    assert mark("recording") not in studio.panel._readout.lines


def test_a_change_that_a_recording_holds_up_is_made_once_it_has_ended(make: Make) -> None:
    studio = make("policy=random")
    studio.records.toggle()
    studio.play.advance()
    studio.tuning.draft.set("reward.contact", "-77")
    studio.tuning._changed(None)
    for _ in range(2):
        studio.play.reset()
        said = unescape(" ".join(studio.tuning._said.lines))
        assert studio.sessions[0].config.reward.contact != -77 and "⚠" not in said
        assert "At the next reset after the recording" in said
    studio.play.advance()
    studio.records.write()
    studio.play.reset()
    assert studio.sessions[0].config.reward.contact == -77
    assert "At the next reset" not in " ".join(studio.tuning._said.lines)


def test_the_motion_that_was_chosen_for_the_person_outlasts_a_change_of_another_key(make: Make) -> None:
    studio = make("policy=random")

    def moves_after(key: str, text: str) -> str:
        studio.tuning.draft.set(key, text)
        studio.tuning._changed(None)
        while not studio.loop._requests.empty():
            studio.loop._requests.get()()
        studio.play.reset()
        assert studio.sessions[0].engine.episodes.human == studio.person.human
        return studio.person.motion

    studio.person.let_go(motion_config("patrol"))
    assert moves_after("reward.contact", "-77") == "patrol" and studio.sessions[0].config.reward.contact == -77
    assert moves_after("human", "worker") == "worker"
    assert moves_after("reward.contact", "-88") == "worker"


def test_curves_go_on_while_an_episode_goes_on_in_any_cell(make: Make) -> None:
    studio = make("policy=random", "beside=expert")
    rows = studio.curves._charts["reward"]._rows
    for over in ([], [1], [0]):
        studio.play.reset()
        for cell in over:
            studio.sessions[cell].over = True
        points = len(rows)
        for _ in range(3):
            studio.play.advance()
        assert len(rows) == points + 3, over
    assert [row[0] for row in rows] == pytest.approx([0.1 * (1 + point) for point in range(9)])


@pytest.mark.filterwarnings("ignore:comfort.source=udp. no good value has come yet")
def test_cells_side_by_side_and_cells_made_anew_read_one_live_stream(make: Make) -> None:
    free = UdpStream("127.0.0.1", 0, "test")
    port = free.port
    free.close()
    stream = (f"comfort.stream.{each}" for each in (f"port={port}", "high=9", "smoothing_s=0", "stall_s=3600"))
    studio = make("policy=random", "beside=expert", "comfort=conditioned", "comfort.source=udp", *stream)

    def levels() -> list[float]:
        return [float(session.step().result.state.level) for session in studio.sessions]

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"7", ("127.0.0.1", port))
        assert levels() == [8, 8]
        studio.tuning.draft.set("reward.contact", "-77")
        studio.play.reset()
        assert studio.sessions[0].config.reward.contact == -77 and levels() == [8, 8]
        studio.tuning.draft.set("comfort.stream.low", "3")
        studio.play.reset()
        sender.sendto(b"9", ("127.0.0.1", port))
        assert levels() == [10, 10]
    studio.live.close()
    UdpStream("127.0.0.1", port, "test").close()


def test_a_studio_that_cannot_write_its_recording_stops_its_training_and_its_cells(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    studio, stopped = make("policy=random"), list[str]()

    def full() -> None:
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(studio.records, "write", full)
        patch.setattr(studio.loop, "stop", lambda: stopped.append("loop"))
        patch.setattr(studio.page, "stop", lambda: stopped.append("page"))
        patch.setattr(studio.tuning, "stop", lambda: stopped.append("training"))
        patch.setattr(studio.sessions[0], "close", lambda: stopped.append("cell"))
        with pytest.raises(OSError, match="no space"):
            studio.stop()
    assert stopped == ["loop", "training", "page", "cell"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_studio_that_is_terminated_ends_as_one_that_is_closed(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    running = SimpleNamespace(
        page=SimpleNamespace(announcement="studio"),
        start=lambda: signal.raise_signal(number),
        stop=lambda: seen.append("stopped"),
    )
    monkeypatch.setattr(server, "LiveStudio", lambda config: running)
    config, before = compose("studio", ["policy=random"]), signal.signal(number, signal.SIG_DFL)  # tests may ignore it
    assert isinstance(config, StudioConfig)
    try:
        server.studio(config)
        assert seen == ["stopped"] and signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)


def test_cells_that_were_made_before_one_that_cannot_be_are_closed() -> None:
    closed: list[str] = []

    def sessions() -> Iterator[Any]:
        yield SimpleNamespace(close=lambda: closed.append("first"))
        raise ConfigError("the second cannot be")

    with pytest.raises(ConfigError, match="the second cannot be"):
        made(sessions())
    assert closed == ["first"]


def test_cells_side_by_side_have_their_policies_names(make: Make) -> None:
    studio = make("policy=random", "beside=expert")
    assert [view._label and view._label.text for view in studio.views] == ["random", "expert"]
    said = unescape(" ".join(studio.panel._readout.lines))
    assert "random" in said and "expert" in said
    assert make("policy=random").views[0]._label is None


def test_the_tool_has_a_trail_that_begins_anew_with_an_episode(make: Make) -> None:
    studio = make("policy=random")
    studio.play.reset()
    studio.play.advance()
    line = studio.views[0]._line
    assert line.points.shape == (4, 2, 3)  # five control steps
    studio.play.reset()
    assert len(line.points) == 0


def test_a_second_policy_that_does_not_fit_is_named_as_such(make: Make) -> None:
    with pytest.raises(ConfigError, match="beside='runs/nowhere' does not fit the cell: policy='runs/nowhere'"):
        make("policy=random", "beside=runs/nowhere")
