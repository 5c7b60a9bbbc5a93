"""Command lines that nobody should write."""

from __future__ import annotations

import random

from hrl_comfort.config.overrides import ROOTS, groups
from tests.artefacts import READ, SMALL
from tests.generating import ODD

COMMANDS = [words for words, _ in READ.values()]
OUTPUTS = [
    "foreign", "foreign/config.yaml", "foreign/notes.txt", "foreign/fifo", "foreign/link", "foreign/loop",
    "foreign/zero", "run", "run/eval", "run/policy.pt", "sweep", "", ".", "..", "/", "/proc/x", "/dev/null/x", "a\0b",
    "x" * 300, "out/" * 900, "foreign/episodes.csv", "run/eval/summary.png", "controller", "~", "${oc.env:HOME}/x",
]  # fmt: skip
FILES = [
    "foreign/fifo", "foreign/zero", "/dev/zero", "foreign", "foreign/loop", "walk.csv", "run/config.yaml",
    "/proc/self/mem", "run/policy.pt", "nowhere", "", "starts.npz", "json:dumps", "sb3:foreign/notes.txt",
    "x.onnx", "sb3:/dev/zero", "sb3:foreign/fifo", "os:nowhere", "a b",
]  # fmt: skip
READING = [
    "policy", "initial_policy", "agent.next_skill", "agent.demonstrator", "task.start", "human.file", "comfort.file",
    "policies.pick", "policies.meta_controller", "run", "replay", "beside", "resume", "robot.name",
]  # fmt: skip
BIG = [
    f"agent.hidden=[{','.join(['8192'] * 200)}]", f"agent.hidden=[{','.join(['8'] * 5000)}]",
    f"meta_controller_agent.hidden=[{','.join(['8192'] * 60)}]", "agent.buffer_size=1000000000000",
    "agent.batch_size=1000000000", "engine.num_envs=100000000", "episodes=1000000000", "engine.num_envs=0",
    "task.max_episode_steps=1000000000", "~output", "~episodes", "hierarchy.controller=[a=b]",
    "human.spawns_m=[[1,1]]", "levels=[1,1]", "levels=[99]", "group_by=[nothing]", "policies.foo=x", "record=5",
    "--nothing", "-h", "=", "a=", "task=", "task=\ud800", "x" * 10**5, "[" * 3000, "train_seed=-1",
    "train_seed=1e400", "curriculum.stages=[]", "curriculum.stages=[{name:a}]", "meta_controller.options=[pick,pick]",
    "hydra.run.dir=/x", "hydra.verbose=true", "hydra/launcher=nowhere", "--config-dir=/",
]  # fmt: skip
SWEEPS = [
    "train_seed=range(0,1000000000)", "train_seed=range(0,300) episode_seed=range(0,300) agent.gamma=0.1,0.2,0.3,0.4",
    "task=reach,nothing", "train_seed=choice()", "train_seed=glob(*)", "output=${now:%}", "output=foreign/notes.txt",
    "output=foreign/zero", "resume=a,b", "train_seed=interval(0,1)", "task=glob(*)", "output=foreign",
]  # fmt: skip


def hostile(rng: random.Random) -> list[str]:
    """Return a hostile command line."""
    command = list(rng.choice(COMMANDS))
    if rng.random() < 0.12:
        return ["train", "-m", *SMALL, "hydra.launcher.n_jobs=1", "output=out", *rng.choice(SWEEPS).split()]
    if rng.random() < 0.1:
        command = list(rng.choice([["evaluate", "handover"], ["nothing"], []]))
    for _ in range(rng.choice([1, 1, 2])):
        keys = [*groups(rng.choice([*ROOTS])), "task.name", "agent.gamma"]
        said = (
            f"output={rng.choice(OUTPUTS)}", f"{rng.choice(READING)}={rng.choice(FILES)}", rng.choice(BIG),
            f"{rng.choice(keys)}={rng.choice(ODD)}",
        )  # fmt: skip
        command.append(rng.choice(said))
    return command
