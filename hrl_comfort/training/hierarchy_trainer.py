"""`hrl-comfort demo`: the whole line of work in minutes, from nothing to a report.

Each subtask is trained from where the one before it ended: pick from home, place from recorded endings of
pick, return from recorded endings of place. Then every policy and their chain are evaluated.

What trains and evaluates takes seconds to import: it is imported once every choice has been checked.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from hrl_comfort.config import ConfigError, EvaluateConfig, ReportConfig, TrainConfig
from hrl_comfort.config.compose import compose

LINE = ("pick", "place", "return")
SHARE = {"pick": 0.25, "place": 1.0, "return": 0.8}
"""How much of `agent.policy_steps` each subtask is given: pick is learnt soonest, place last."""
TERMINAL_STATES_EPISODES = 1000


def demo(overrides: list[str]) -> Path:
    """Train, evaluate, chain and report; return the report's path.

    `overrides` go to every training, on top of `experiment=demo` unless they name another; `output=DIR` says
    where (runs/demo), `episodes=N` how many each evaluation runs (200).
    """
    begin = time.perf_counter()
    for word in overrides:
        if "=" not in word:
            raise ConfigError(f"{word} is not an override; say key=value")
    chosen = dict(word.split("=", 1) for word in overrides)
    output, episodes = Path(chosen.pop("output", "runs/demo")), chosen.pop("episodes", "200")
    for key in ("task", "task.start", "resume"):
        if key in chosen:
            raise ConfigError(f"{key}={chosen[key]} is not the demo's to choose: it trains {', '.join(LINE)}")
    compose("evaluate", [f"episodes={episodes}"])  # a bad value is named before the training, not after
    trainings = compose_line(output, {"experiment": "demo", **chosen})
    from hrl_comfort.report.report import report

    policies = train_line(trainings)
    evaluate_line(output, policies, episodes)
    page = report(ReportConfig(run=str(output), output=None, video=True))
    print_table(output, time.perf_counter() - begin)
    Console().print(f"report: {page}", soft_wrap=True)
    return page


def compose_line(output: Path, chosen: dict[str, str]) -> dict[str, TrainConfig]:
    """Return what each subtask's training will be, starts aside."""
    trainings: dict[str, TrainConfig] = {}
    for name in LINE:
        words = [f"task={name}", f"output='{output}/{name}'", *(f"{k}={v}" for k, v in chosen.items())]
        config = compose("train", words)
        assert isinstance(config, TrainConfig)
        agent = replace(config.agent, policy_steps=round(config.agent.policy_steps * SHARE[name]))
        trainings[name] = replace(config, agent=agent)
    return trainings


def train_line(trainings: dict[str, TrainConfig]) -> dict[str, Path]:
    """Train the subtasks in order, each from recorded endings of the one before; return their folders."""
    from hrl_comfort.training.trainer import train

    folders: dict[str, Path] = {}
    start = "ik"
    for name, config in trainings.items():
        folder = folders[name] = train(replace(config, task=replace(config.task, start=start)))
        if name != LINE[-1]:
            start = str(terminal_states_of(folder))
    return folders


def terminal_states_of(folder: Path) -> Path:
    """Record how the trained policy of `folder` leaves the arm; return the file."""
    from hrl_comfort.evaluation.terminal_states import record_terminal_states

    path = folder / "terminal_states.npz"
    config = compose(
        "evaluate",
        [f"policy='{folder}'", f"episodes={TERMINAL_STATES_EPISODES}", f"terminal_states='{path}'"],
    )
    assert isinstance(config, EvaluateConfig)
    return record_terminal_states(config)


def evaluate_line(output: Path, policies: dict[str, Path], episodes: str) -> None:
    """Evaluate every policy, its checkpoints, and their chain."""
    for folder in policies.values():
        choices = [f"policy='{folder}'"]
        run_evaluation([*choices, f"episodes={episodes}", "record=true", "group_by=[seen]"])
        run_evaluation([*choices, "episodes=100", "checkpoints=all"])
    chained = [f"policies.{name}='{folder}'" for name, folder in policies.items()]
    where = f"output='{output}/cycle/eval'"
    run_evaluation(
        [
            "task=cycle",
            "meta_controller=scripted",
            *chained,
            f"episodes={episodes}",
            "record=true",
            "group_by=[seen]",
            where,
        ]
    )


def run_evaluation(overrides: list[str]) -> None:
    """Compose and run one evaluation."""
    from hrl_comfort.evaluation.evaluate import evaluate

    config = compose("evaluate", overrides)
    assert isinstance(config, EvaluateConfig)
    evaluate(config)


def print_table(output: Path, seconds: float) -> None:
    """Print what was reached."""
    table = Table(title=f"{output}: {seconds / 60:.1f} minutes")
    for name in ("task", "spawns", "episodes", "success [95 % interval]", "steps", "human distance, m"):
        table.add_column(name, justify="left" if name in ("task", "spawns") else "right")
    for name in (*LINE, "cycle"):
        summary = json.loads((output / name / "eval" / "summary.json").read_text(encoding="utf-8"))
        for group in summary["groups"]:
            metrics = group["metrics"]
            low, high = metrics["success"]["ci95"]
            table.add_row(
                name,
                "seen" if group["seen"] else "unseen",
                str(group["episodes"]),
                f"{metrics['success']['mean']:.1%} [{low:.1%}, {high:.1%}]",
                cell(metrics, "steps", "{:.0f}"),
                cell(metrics, "human_distance_mean_m", "{:.3f}"),
            )
    Console().print(table)


def cell(metrics: dict, name: str, form: str) -> str:
    """Return a metric's mean as text; a dash where there was nothing to measure."""
    return form.format(metrics[name]["mean"]) if name in metrics else "-"
