"""Missing parts of the machine are told by `doctor`, and at the start of the command that needs them."""

from __future__ import annotations

import sys
import warnings

import pytest

from hrl_comfort import __version__
from hrl_comfort.cli import doctor, first_checks
from hrl_comfort.cli.main import configuration, main
from hrl_comfort.config import ConfigError


def test_doctor_prints_a_table_for_an_issue(capsys):
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith("| ") and line.endswith(" |") and line.count(" | ") == 1 for line in lines)
    assert lines[1] == "| --- | --- |" and __version__ in lines[2]
    names = [line.split(" | ")[0][2:] for line in lines]
    assert {"cores", "memory", "packages", "extra studio", "off-screen drawing", "Lab Streaming Layer"} <= set(names)


def test_doctor_tells_missing_packages_and_versions_that_were_not_tested(monkeypatch):
    pins = ["numpy==0.1", "no-such-thing==1.0; extra == 'studio'", "hrl-comfort[gymnasium]; extra == 'sb3'"]
    monkeypatch.setattr(doctor, "requires", lambda _: pins)
    text = doctor.report()
    assert "(tested: 0.1)" in text and "| extra studio | no-such-thing missing |" in text and "| extra sb3 |  |" in text


@pytest.mark.parametrize(
    ("command", "words", "says"),
    [
        ("report", ["."], "the report will have no video"),
        ("train hierarchy", [], "the report will have no video"),
        ("studio", ["expert"], "clips cannot be saved"),
    ],
)
def test_missing_opengl_is_said_at_the_start(monkeypatch, command, words, says):
    configuration(command, words)
    monkeypatch.setattr(first_checks, "find_library", lambda _: None)
    with pytest.warns(UserWarning, match=f"{says}.*libegl1"):
        configuration(command, words)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        configuration("train", [])
        configuration("report", [".", "video=false"])


@pytest.mark.parametrize(
    ("command", "words"),
    [("evaluate", ["expert", "comfort.source=lsl"]), ("studio", ["expert", "human=live", "human.file='lsl:person'"])],
)
def test_missing_liblsl_is_said_at_the_start(monkeypatch, command, words):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(ConfigError, match="needs pylsl and liblsl"):
        configuration(command, words)
