"""SIGINT at any moment ends the command with exit code 130 and one line."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

HIT = "os.kill(os.getpid(), signal.SIGINT); time.sleep(9)"
MOMENTS = {
    "import": "import swallows",
    "finaliser": f"class A:\n    def __del__(self):\n        {HIT}\nA()\ntime.sleep(9)",
    "call": HIT,
    "call that turns it into another error": f"try:\n    {HIT}\nexcept BaseException:\n    raise ValueError('other')",
    "cleanup": f"try:\n    {HIT}\nfinally:\n    {HIT}",
    "exit": f"import atexit\natexit.register(lambda: exec({HIT!r}, globals()))",
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interrupt_is_one_line_even_where_the_interpreter_would_swallow_it(moment: str, tmp_path: Path) -> None:
    imports = "import os, signal, sys, time\n"
    swallows = f"try:\n    {HIT}\nexcept BaseException:\n    raise ImportError('from C')"
    (tmp_path / "swallows.py").write_text(imports + swallows)
    (tmp_path / "command.py").write_text(
        f"{imports}sys.path.insert(0, {str(tmp_path)!r})\nfrom hrl_comfort.cli import main\n"
        f"def work(words=None):\n    exec({MOMENTS[moment]!r}, globals())\n    return 0\n"
        "main.execute = work\nfrom hrl_comfort.__main__ import console\nconsole()"
    )
    done = subprocess.run([sys.executable, tmp_path / "command.py"], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (130, "hrl-comfort: interrupted\n")


@pytest.mark.parametrize("module", ["hydra", "mujoco", "torchrl"])
def test_a_command_that_is_interrupted_while_it_imports_exits_130(module: str, tmp_path: Path) -> None:
    words = ["train", "task=reach", "agent=quick", f"output={tmp_path / 'run'}"]
    command = [sys.executable, "-X", "importtime", "-m", "hrl_comfort", *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        for line in running.stderr:
            if line.split("|")[-1].strip().split(".")[0] == module:
                running.send_signal(signal.SIGINT)
                break
        error = running.communicate(timeout=300)[1]
    assert running.returncode == 130
    assert error.splitlines()[-1] == "hrl-comfort: interrupted" and "Traceback" not in error
