"""Standard streams that are closed or know few signs change nothing that a command does."""

from __future__ import annotations

import subprocess
import sys

import pytest

WHAT = "import os; from hrl_comfort.cli import main\nmain.execute = lambda words: WORK\n"
CONSOLE = "from hrl_comfort.__main__ import console\nconsole()"


def run(work: str, redirections: str = "", encoding: str = "utf-8") -> subprocess.CompletedProcess[str]:
    """Run the command with another work, through a shell with redirections."""
    command = ["sh", "-c", f'exec "$0" -c "$1" {redirections}', sys.executable, WHAT.replace("WORK", work) + CONSOLE]
    return subprocess.run(
        command,
        capture_output=True,
        encoding=encoding,
        errors="replace",
        env={"PYTHONIOENCODING": encoding},
        check=False,
    )


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_is_none_that_a_file_could_take(closed: str) -> None:
    work = "(print('said'), print('said', file=sys.stderr), sys.stdin.read(), [os._exit(9) for _ in [0] if FREE < 3])"
    free = "os.open(os.devnull, os.O_RDONLY)"
    done = run(work.replace("sys.", "__import__('sys').").replace("FREE", free), closed)
    assert (done.returncode, done.stderr.replace("said\n", "")) == (0, "")


def test_a_stream_that_closes_after_the_work_is_no_error() -> None:
    assert run("print('said' * 10**5)", "| true").returncode == 0


@pytest.mark.parametrize("text", ["– §", "\\udcff"])
@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_any_text_can_be_said_in_any_encoding(text: str, encoding: str) -> None:
    done = run(f"print('a {text} b')", encoding=encoding)
    assert done.returncode == 0 and done.stdout[:2] == "a " and done.stdout[-3:] == " b\n"
