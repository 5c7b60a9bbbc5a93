"""Every artefact of the program, and the commands that read each."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import stat
import time
from pathlib import Path

import pandas as pd

from hrl_comfort.cli.main import main

SMALL = [
    "agent=quick", "agent.policy_steps=640", "agent.learning_starts=64", "agent.hidden=[16]", "agent.batch_size=32",
    "agent.log_every=320", "agent.checkpoint_every=320", "task.max_episode_steps=40", "human=arc",
]  # fmt: skip
LONG, REST = "policy_steps: 64000", "policy_steps: 1600"
"""Budget of a training that is stopped, and the one that it is resumed with."""
EXPERTS = ["policies.pick=expert", "policies.place=expert", "policies.return=expert"]
SHORT = ["policy=expert", "episodes=1", "task.max_episode_steps=40", "output=out"]
MAKE = [
    ["train", "task=reach", *SMALL, "output=run"],
    ["evaluate", "run", "episodes=2", "record=true", "levels=[1,2]"],
    ["train", "-m", "task=reach", *SMALL, "train_seed=0,1", "hydra.launcher.n_jobs=1", "output=sweep"],
    ["evaluate", "task=pick", "policy=expert", "episodes=4", "human=none", "terminal_states=starts.npz"],
    ["train", "meta_controller", *EXPERTS, "meta_controller_agent.options=40", "engine.num_envs=4",
     "meta_controller_agent.warmup_options=8", "meta_controller_agent.log_every=20", "output=controller"],
]  # fmt: skip
EVALUATION = [f"run/eval/{name}" for name in ("episodes.csv", "summary.json", "config.yaml")]
READ: dict[str, tuple[list[str], list[str]]] = {
    "evaluate": (["evaluate", "run", "episodes=1", "output=out"], ["run/policy.pt", "run/config.yaml"]),
    "checkpoints": (
        ["evaluate", "run", "checkpoints=all", "episodes=1", "output=out"],
        ["run/checkpoints/step_000000320.pt", "run/checkpoints/step_000000640.pt", "run/config.yaml"],
    ),
    "report": (
        ["report", "run", "video=false", "output=out.html"],
        ["run/config.yaml", "run/provenance.json", "run/metrics.csv", "run/timing.csv", "run/eval/paths.csv",
         "run/eval/options.csv", *EVALUATION],
    ),
    "report of tables": (["report", "tables", "video=false", "output=out.html"], ["tables/eval/episodes.parquet"]),
    "report of a sweep": (
        ["report", "sweep", "output=out.html"],
        ["sweep/multirun.yaml", "sweep/0/job.json", "sweep/0/config.yaml", "sweep/0/metrics.csv"],
    ),
    "figure": (["figure", "kind=levels", "evaluations=[run/eval]", "output=out.png"], EVALUATION),
    "resume": (
        ["train", "resume=stopped"],
        [f"stopped/{name}" for name in ("checkpoints/latest.pt", "checkpoints/previous.pt", "config.yaml",
                                        "metrics.csv", "timing.csv", "provenance.json")],
    ),
    "initial policy": (
        ["train", "task=reach", *SMALL, "initial_policy=run", "output=out"], ["run/policy.pt", "run/config.yaml"]
    ),
    "starts": (["evaluate", "task=pick", "task.start=starts.npz", *SHORT], ["starts.npz"]),
    "walk": (["evaluate", "task=reach", "human=recorded", "human.file=walk.csv", *SHORT], ["walk.csv"]),
    "levels": (
        ["evaluate", "task=reach", "comfort=conditioned", "comfort.source=file", "comfort.file=levels.csv", *SHORT],
        ["levels.csv"],
    ),
    "controller": (
        ["evaluate", "task=sort", "comfort=sort", "reward=sort", "task.max_episode_steps=60", "human=arc", *EXPERTS,
         "meta_controller=learned", "policies.meta_controller=controller", "episodes=1", "output=out"],
        ["controller/meta_controller.pt", "controller/config.yaml"],
    ),
    "replay": (["studio", "replay=run/eval", "output=out"], ["run/eval/paths.csv", *EVALUATION]),
    "export": (["export", "policy=run", "output=out"], ["run/policy.pt", "run/config.yaml"]),
}  # fmt: skip
"""Command and the artefacts that it reads, by name."""
FOREIGN = ("config.yaml", "video.mp4", "report.html", "episodes.csv", "notes.txt")


def make(folder: Path) -> None:
    """Write every artefact, and `foreign/`, files of somebody else."""
    with contextlib.chdir(folder):
        for words in MAKE:
            assert main(words) == 0, words
        _stop_a_training()
        shutil.copytree("run/eval", "tables/eval")
        pd.read_csv("tables/eval/episodes.csv").to_parquet("tables/eval/episodes.parquet")
        Path("tables/eval/episodes.csv").unlink()
        Path("walk.csv").write_text("t,x,y,yaw\n" + "".join(f"{t},{t / 10},1,0\n" for t in range(10)))
        Path("levels.csv").write_text("t,value\n" + "".join(f"{t},{1 + t % 3}\n" for t in range(10)))
        Path("foreign").mkdir()
        for name in FOREIGN:
            Path("foreign", name).write_text("of somebody else\n")
        os.mkfifo("foreign/fifo")
        Path("foreign/link").symlink_to("notes.txt")
        Path("foreign/loop").symlink_to("loop")
        if os.getuid() == 0:
            zero(Path("foreign/zero"))


def zero(path: Path) -> None:
    """Make a device without end (root only)."""
    os.mknod(path, 0o666 | stat.S_IFCHR, os.makedev(1, 5))


def _stop_a_training() -> None:
    """Leave `stopped/` with two checkpoints to resume from."""
    pid = os.fork()
    if not pid:
        main(["train", "task=reach", *SMALL, "agent.policy_steps=64000", "output=stopped"])
        os._exit(0)
    log = Path("stopped/metrics.csv")
    while not log.is_file() or len(log.read_text().splitlines()) < 3:
        time.sleep(0.05)
    os.kill(pid, signal.SIGTERM)
    os.waitpid(pid, 0)
    config = Path("stopped/config.yaml")
    config.write_text(config.read_text().replace(LONG, REST))
