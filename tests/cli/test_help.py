"""Help, version, dry run and completion: what a shell sees before anything runs."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from hrl_comfort import __version__
from hrl_comfort.cli.commands import COMMANDS, VERBS
from hrl_comfort.cli.completion import candidates
from hrl_comfort.cli.help import WIDTH
from hrl_comfort.cli.main import configuration, main
from hrl_comfort.composition.compose import compose
from hrl_comfort.composition.keys import keys_of
from hrl_comfort.config.overrides import root_of
from hrl_comfort.files.run_config import load_config


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_lists_its_keys_and_an_example_that_composes(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    out = capsys.readouterr().out
    for key in keys_of(root_of(command)):
        assert f"  {key.name}" in out and key.meaning
    assert f"  hrl-comfort {command} {COMMANDS[command].example[:20]}" in out
    assert max(map(len, out.splitlines())) <= WIDTH
    compose(root_of(command), COMMANDS[command].example.split())


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"], ["help"], ["bench", "--help"]])
def test_the_overview_lists_every_command_in_eighty_columns(words, capsys):
    assert main(words) == 0
    out = capsys.readouterr().out
    assert all(f"  {command} " in out for command in COMMANDS)
    assert max(map(len, out.splitlines())) <= WIDTH


def test_help_says_defaults_choices_and_what_is_required(capsys):
    main(["train", "--help"])
    out = capsys.readouterr().out
    assert "  agent.gamma=" in out and "pick, cycle" in out and "(0 to 1)" in out
    main(["report", "-h"])
    assert "  run (required)" in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hrl-comfort {__version__}\n"


def test_a_dry_run_prints_the_configuration_that_a_run_would_write(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["task=reach", "agent.gamma=0.5", "output=runs/reach"]
    assert main(["train", *words, "--dry-run"]) == 0
    assert main(["train", "-m", "--dry-run"]) == 1
    assert not (tmp_path / "runs").exists()
    (tmp_path / "runs" / "reach").mkdir(parents=True)
    (tmp_path / "runs" / "reach" / "config.yaml").write_text(capsys.readouterr().out)
    assert load_config("runs/reach") == configuration("train", words)


@pytest.mark.parametrize(
    ("words", "prefix", "found"),
    [
        ([], "ev", ["evaluate"]),
        ([], "", [*VERBS, "doctor"]),
        (["train"], "hier", ["hierarchy"]),
        (["bench"], "u", ["update"]),
        (["train"], "agent.gam", ["agent.gamma="]),
        (["train", "hierarchy"], "hierarchy.ep", ["hierarchy.episodes="]),
        (["evaluate", "policy=expert"], "hum", ["human="]),
        (["evaluate"], "human=ad", ["human=adversary"]),
        (["nothing"], "", []),
    ],
)
def test_completion_of_commands_keys_and_choices(words, prefix, found):
    assert [each for each in candidates(words, prefix) if not each.startswith("human.")] == found


def test_the_shell_gets_its_completions():
    line = "hrl-comfort train task=pi"
    shell = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": " "}
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m hrl_comfort 8>&1 9>/dev/null"],
        env={**os.environ, **shell, "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n=:"},
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["pick", "pick_place"]
