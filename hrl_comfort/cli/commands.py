"""The table of commands."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command: its function and its help; `config.overrides.root_of` names its configuration."""

    place: str
    """`module:function`, imported once the configuration has been checked."""
    about: str
    example: str
    """Overrides."""


COMMANDS = {
    "train": Command(
        "hrl_comfort.training.trainer:train",
        "train a policy for a subtask",
        "task=reach human=arc agent=quick output=runs/reach",
    ),
    "train hierarchy": Command(
        "hrl_comfort.training.hierarchy_trainer:train_hierarchy",
        "train the policies of a cycle, evaluate them and their chain, write the report",
        "division=three agent=quick output=runs/cycle",
    ),
    "train meta_controller": Command(
        "hrl_comfort.training.controller_trainer:train_meta_controller",
        "train a controller above frozen policies",
        "policies.pick=expert policies.place=expert policies.return=expert output=runs/controller",
    ),
    "evaluate": Command(
        "hrl_comfort.evaluation.evaluate:evaluate",
        "measure a policy, or a chain of policies (meta_controller=nearest)",
        "policy=runs/pick episodes=100 record=true",
    ),
    "evaluate handover": Command(
        "hrl_comfort.evaluation.handover:handover",
        "measure a subtask from the terminal states of the one before it",
        "task=cycle meta_controller=nearest policies.pick=runs/cycle/pick policies.place=runs/cycle/place "
        "policies.return=runs/cycle/return output=runs/handover",
    ),
    "benchmark": Command(
        "hrl_comfort.benchmarks.suite:benchmark",
        "run the benchmark's shifts beside people for one policy and top; write the entry",
        "policies.pick=expert policies.place=expert policies.return=expert split=validation episodes=2 "
        "output=runs/entry",
    ),
    "report": Command(
        "hrl_comfort.report.report:report",
        "write one HTML page about a run, the runs in a folder, or a sweep",
        "run=runs/pick",
    ),
    "figure": Command(
        "hrl_comfort.plots.figure:figure",
        "draw what comfort levels or controllers change",
        "kind=levels evaluations=[runs/comfort/eval] output=runs/levels.png",
    ),
    "results": Command(
        "hrl_comfort.results.command:results",
        "list published results, make them anew, fill the pages",
        "remake=comfort",
    ),
    "studio": Command(
        "hrl_comfort.studio.server:studio",
        "watch a policy in the browser, walk into its cell, replay an evaluation",
        "policy=runs/cycle",
    ),
    "deploy": Command(
        "hrl_comfort.deploy.runner:deploy",
        "move an arm in real time by a policy or a chain, behind the shield",
        "policy=expert connection=simulated output=runs/deploy",
    ),
    "identify": Command(
        "hrl_comfort.deploy.identify:identify",
        "fit lag and latency of an arm's servos to a log of deploy",
        "run=runs/deploy",
    ),
    "export": Command(
        "hrl_comfort.deploy.export:export",
        "write trained policies as ONNX files for other programs",
        "policy=runs/pick output=exported",
    ),
    "dataset": Command(
        "hrl_comfort.deploy.dataset:dataset",
        "write the episodes of a policy or a chain as a Minari data set",
        "policy=runs/pick split=validation episodes=1000 output=runs/dataset",
    ),
    "bench env": Command("hrl_comfort.benchmarks.env:bench_env", "measure the speed of the environment", "task=pick"),
    "bench safety": Command(
        "hrl_comfort.benchmarks.safety:bench_safety",
        "measure what rating and shield cost the environment",
        "task=pick_place human=mixture",
    ),
    "bench update": Command("hrl_comfort.benchmarks.update:bench_update", "measure the speed of updates", "agent=sac"),
    "bench studio": Command(
        "hrl_comfort.studio.measure:bench_studio", "measure the live view", "task=cycle policy=expert"
    ),
    "bench train": Command(
        "hrl_comfort.benchmarks.train:bench_train", "compare training with Stable-Baselines3", "task=pick"
    ),
}
VERBS = tuple(dict.fromkeys(command.split()[0] for command in COMMANDS))


def parts_of(verb: str) -> tuple[str, ...]:
    """Return the second words of the commands of `verb`: `hierarchy` and `meta_controller` of `train`."""
    return tuple(command.split()[1] for command in COMMANDS if command.startswith(f"{verb} "))
