"""provenance.json: versions, commit, seeds and machine of a training, and how far it is."""

from __future__ import annotations

import math
import os
import platform
import re
import shutil
import subprocess
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, FiniteFloat

from hrl_comfort.config import HIERARCHY, TrainingConfig
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.documents import read_json

ROOT = Path(__file__).resolve().parents[2]
"""The checkout; in a wheel, the folder that holds the package."""
DECIDING = (".", ":!runs", ":!docs", ":!*.md")
"""Files that decide results, as pathspecs of git: all but the results themselves and the pages."""
RESUMABLE = ("latest.pt", "previous.pt")
"""Checkpoints to resume from, the newest first."""
STEP_FILE = re.compile(r"step_(\d{9})\.pt")
"""Name of a light checkpoint, with its policy steps."""
PACKAGES = ("mujoco", "dm-control", "mink", "torch", "torchrl", "tensordict", "numpy", "hydra-core")


class Provenance(BaseModel):
    """The content of provenance.json; further fields are kept as they are."""

    model_config = ConfigDict(extra="allow")

    finished: bool
    commit: str | None = None
    policy_steps: int = 0
    wall_seconds: FiniteFloat = math.nan


def read_provenance(folder: Path) -> Provenance:
    """Return a run's provenance; raise ConfigError where it is missing or damaged."""
    return read_json(folder / "provenance.json", Provenance)


def is_finished(folder: Path) -> bool:
    """Return whether the training in `folder` is complete; raise ConfigError where its provenance is damaged."""
    return (folder / "provenance.json").is_file() and read_provenance(folder).finished


class RunState(Enum):
    """State of the training in a folder."""

    NEW = "new"
    STOPPED = "stopped"
    FINISHED = "finished"


def run_state(folder: Path) -> RunState:
    """Return the state of the training or the hierarchy in a folder; raise ConfigError if it is damaged."""
    if is_finished(folder):
        return RunState.FINISHED
    return RunState.STOPPED if (folder / HIERARCHY).is_file() or resumable(folder) else RunState.NEW


def resumable(folder: Path) -> bool:
    """Return whether the run in a folder has a checkpoint to resume from, good or not."""
    return any((folder / "checkpoints" / name).exists() for name in RESUMABLE)


def unfinished(folder: Path) -> str | None:
    """Return how far the training in a run folder is, in a line; None if it is finished, or says nothing of it.

    Raises:
      ConfigError: its provenance is damaged.
    """
    if not (folder / "provenance.json").is_file() or is_finished(folder):
        return None
    files = step_files(folder / "checkpoints")
    reached = f": its policy has {policy_steps(files[-1]):,} policy steps so far" if files else ""
    return f"the training in {folder} is not finished{reached}"


def step_path(checkpoints: Path, policy_steps: int) -> Path:
    """Return the light checkpoint after so many policy steps in the folder `checkpoints` of a run."""
    return checkpoints / f"step_{policy_steps:09d}.pt"


def step_files(checkpoints: Path) -> list[Path]:
    """Return the light checkpoints in the folder `checkpoints` of a run, oldest first."""
    return sorted(path for path in checkpoints.glob("step_*.pt") if STEP_FILE.fullmatch(path.name))


def policy_steps(file: Path) -> int:
    """Return the policy steps of training after which a light checkpoint was written."""
    return int(file.stem.removeprefix("step_"))


def write_provenance(folder: Path, config: TrainingConfig, finished: bool, seconds: float, **progress: Any) -> None:
    """Write versions, commit, seeds, machine and progress (policy_steps, updates, …) of a training."""
    machine = {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}
    content = {
        "finished": finished,
        **progress,
        "wall_seconds": round(seconds, 1),
        "seeds": {"train_seed": config.train_seed, "episode_seed": config.episode_seed},
        "commit": commit(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
        "machine": machine,
    }
    write_json(folder / "provenance.json", content)


def commit() -> str | None:
    """Return the commit of the package's checkout, with `+` if files DECIDING results differ; None in a wheel."""
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        return None
    head = git("rev-parse", "HEAD")
    return head and head + ("+" if git("status", "--porcelain", "--untracked-files=no", "--", *DECIDING) else "")


def git(*words: str) -> str | None:
    """Return what git says of the checkout, None if it fails."""
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else None


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
