"""A question or a mistake is answered at once: nothing heavy is imported before it is needed."""

from __future__ import annotations

import json
import subprocess
import sys

HEAVY = ("torch", "torchrl", "tensordict", "mujoco", "dm_control", "mink", "scipy", "matplotlib")
PROGRAM = """
import json, sys
from hrl_comfort.__main__ import main
for words in json.loads(sys.argv[1]):
    main(words)
print()
print(json.dumps(list(sys.modules)))
"""


def imported_by(*commands: list[str]) -> set[str]:
    """Return the modules of a process of its own that has run these commands."""
    run = [sys.executable, "-c", PROGRAM, json.dumps(commands)]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_help_imports_neither_simulator_nor_learner_nor_hydra() -> None:
    assert not {*HEAVY, "numpy", "hydra", "omegaconf"} & imported_by(["--help"], [], ["learn"])


def test_a_mistake_is_named_before_anything_heavy_is_imported() -> None:
    wrong = [
        ["train", "agent.tau=7"],
        ["train", "meta", "meta_agent.tau=7"],
        ["train", "-m", "task=plce"],
        ["evaluate", "episodes=0"],
        ["evaluate", "handover", "episodes=0"],
        ["report"],
        ["figure", "kind=bars"],
        ["bench", "env", "agent.tau=7"],
        ["bench", "start", "agent.tau=7"],
        ["demo", "agent.tau=7"],
        ["demo", "episodes=0"],
    ]
    assert not set(HEAVY) & imported_by(*wrong)
