"""Commands of the documentation: read from ```sh blocks and run in order with small budgets."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from hrl_comfort.cli.main import main

ROOT = Path(__file__).resolve().parent.parent
NOT_RUN = (
    "git ",
    "cd ",
    "apt-get ",
    "sudo ",
    "pip ",
    "source ",
    "tensorboard ",
    "make test",
    "make page",
    "make docs",
    "docs/",
    "hrl-comfort studio",
)
"""Commands that install, fetch or take hours. The rest must run."""
TRAINING = (
    "agent.policy_steps=640", "agent.learning_starts=64", "agent.hidden=[16]", "agent.batch_size=32",
    "agent.log_every=320", "agent.checkpoint_every=320",
)  # fmt: skip
LONG = "200000"
"""Steps of trainings by scripts of the documentation."""
BUDGETS = {
    "train": TRAINING,
    "train hierarchy": (*TRAINING, "hierarchy.episodes=2", "hierarchy.terminal_states_episodes=8"),
    "train meta_controller": (
        "meta_controller_agent.options=40", "meta_controller_agent.warmup_options=8",
        "meta_controller_agent.log_every=20", "engine.num_envs=4",
    ),
    "evaluate": ("episodes=2",),
    "evaluate handover": ("episodes=2",),
    "benchmark": ("task.max_episode_steps=100",),
    "bench": TRAINING,
}  # fmt: skip
"""Overrides that are appended to a verb's commands; the last value of a key counts."""


def commands(page: Path) -> list[str]:
    """Return the commands of the page's ```sh blocks in order, continued lines joined and comments left out."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


def run(line: str) -> None:
    """Run one command in the working directory; raise AssertionError if it fails."""
    if line.startswith(NOT_RUN) or ("franka" in line and find_spec("gymnasium_robotics") is None):
        return
    words = shlex.split(line, comments=True)
    line = line.replace(LONG, "200")
    if words[0] == "make":
        words = ["hrl-comfort", *shlex.split(_recipe(words[1]))]
    if words[0] == "hrl-comfort":
        words = [*words[1:], *budget(words[1:])]
        if "-m" not in words:
            assert main(words) == 0, line
            return
        line = shlex.join([sys.executable, "-m", "hrl_comfort", *words])  # a sweep's jobs are processes
    paths = {"PYTHONPATH": str(ROOT), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(line, shell=True, env={**os.environ, **paths}, capture_output=True, text=True)
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"


def write_files(page: Path, folder: Path) -> None:
    """Write the page's blocks that begin with `# FILE`, a name without folders, to `folder`."""
    text = page.read_text(encoding="utf-8")
    for name, content in re.findall(r"^```\w+\n# ([\w.]+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        (folder / name).write_text(content, encoding="utf-8")


def budget(words: list[str]) -> tuple[str, ...]:
    """Return the overrides that make a command of hrl-comfort short."""
    verb = " ".join(words[:2])
    if any(word.startswith(("resume=", "-h", "--")) for word in words):
        return ()
    if any(word.startswith("terminal_states=") for word in words):
        return ("episodes=8",)  # an object of each kind
    return BUDGETS.get(verb, BUDGETS.get(words[0], ()) if words else ())


def _recipe(target: str) -> str:
    """Return the arguments of hrl-comfort in the recipe of `make target`."""
    lines = (ROOT / "Makefile").read_text("utf-8").replace("\\\n", " ")
    found = re.search(rf"^{target}:.*\n\t\S*/hrl-comfort (.*)$", lines, re.MULTILINE)
    assert found is not None, f"make {target} runs no hrl-comfort"
    return found[1]
