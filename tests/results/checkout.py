"""A small repository with a result, and commands that are noted instead of run."""

from __future__ import annotations

import subprocess
from pathlib import Path

from hrl_comfort.results import remake
from hrl_comfort.results.manifest import PHASES, Entry


def commit(folder: Path, *first: str) -> str:
    """Commit everything in a repository, or run `git FIRST`; return the commit."""
    me = ("-c", "user.name=test", "-c", "user.email=test@test")
    for words in [first] if first else [("add", "-A"), ("commit", "-qm", "x")]:
        subprocess.run(["git", "-C", str(folder), *me, *words], check=True)
    done = subprocess.run(["git", "-C", str(folder), "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip()


MADE = Entry(
    about="x", pages=["README.md"], draw=["python -m nothing"], artefacts=["runs/made.csv"], decided_by=["code.py"]
)


EVALUATED = MADE.model_copy(
    update={
        "draw": [],
        "seeds": [0, 1],
        "train": ["hrl-comfort train hierarchy agent.policy_steps=9000 train_seed={seed} output=runs/p{seed}"],
        "evaluate": ["hrl-comfort evaluate policy=runs/p{seed} episodes=1 output=runs/e{seed}"],
    }
)
"""A result of a training."""

COMMANDS = [" ".join(words) for phase in PHASES for words in EVALUATED.commands(phase)]


class Ran:
    """Stands in for commands: notes them with the code in code.py, which an evaluation gives as the success."""

    def __init__(self) -> None:
        self.words: list[list[str]] = []
        self.code: list[str] = []

    def __call__(self, words: list[str], code: Path) -> None:
        self.words.append(words)
        self.code.append((code / "code.py").read_text(encoding="utf-8").strip())
        if words[1] == "evaluate":
            output, policy = Path(remake.output_of(words)), words[2].removeprefix("policy=")
            output.mkdir(parents=True)
            rows = f"episode,comfort_level,policy,success\n0,,{policy},{self.code[-1]}\n"
            (output / "episodes.csv").write_text(rows, encoding="utf-8")
