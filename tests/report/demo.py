"""Runs of four tasks with invented metrics and episodes."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd

from hrl_comfort.analysis.summary import summarise
from hrl_comfort.files import run_folder
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.tables import read_table, records_of
from tests.cells import SECTION

CONFIG = f"""\
robot: {{name: ur3e, home_deg: [0, -90, 0, 0, 90, 0], rating: paper}}
{SECTION}task: {{name: NAME}}
"""

ROUTE = {"pick": (0, 1), "place": (1, 2), "return": (2, 3), "cycle": (0, 1, 2, 3)}

POINTS = np.array([[0.3, -0.1, 0.35], [-0.55, -0.1, 0.3], [0.6, -0.05, 0.3], [0.3, -0.1, 0.35]])


def write(file: Path, rows: list[dict[str, object]]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", newline="") as out:
        writer = csv.DictWriter(out, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def make_training(folder: Path, rng: np.random.Generator, rows: int) -> None:
    share = 1 - np.exp(-np.linspace(0, 4, rows))
    noisy = np.clip(share + rng.normal(0, 0.05, rows), 0, 1)
    precision = 0.3 - 0.04 * np.floor(np.linspace(0, 5, rows))
    write(
        folder / "metrics.csv",
        [
            {
                "policy_steps": 1000 * i,
                "updates": 250 * i,
                "episodes": 20 * i,
                "precision_m": max(0.1, precision[i]),
                "success": noisy[i] if i else "",
                "return": 15 * noisy[i] - 3,
                "steps": 120,
                "contact": 0.1 * (1 - noisy[i]),
                "other_collision": 0,
                "critic_loss": 0.1,
                "entropy": -6 * share[i],
                "q_mean": 10 * share[i],
            }
            for i in range(rows)
        ],
    )
    write(folder / "timing.csv", [{"policy_steps": 1000 * i, "seconds": 6 * i} for i in range(rows)])
    (folder / "provenance.json").write_text(json.dumps({"finished": True, "commit": "abc123", "machine": {"cores": 2}}))
    write(
        folder / "eval" / "checkpoints.csv",
        [
            {
                "policy_steps": 20000 * (i + 1),
                "success": s,
                "success_low": s - 0.06,
                "success_high": min(1, s + 0.04),
                "precision_m": 0.1,
            }
            for i, s in enumerate((0.2, 0.6, 0.85, 0.97))
        ],
    )


def make_evaluation(folder: Path, task: str, rng: np.random.Generator, episodes: int) -> None:
    rows, paths, options = [], [], []
    for i in range(episodes):
        failed = i % 7 == 3
        steps = 90 * (len(ROUTE[task]) - 1) + int(rng.integers(20))
        rows.append(
            {
                "task": task,
                "policy": f"runs/demo/{task}",
                "train_seed": 0,
                "episode_seed": 1000000,
                "episode": i,
                "object": "orange",
                "spawn_id": i % 19,
                "motion_id": i,
                "seen": i % 2,
                "comfort_level": "",
                "human": "random_walk",
                "precision_m": 0.1,
                "success": int(not failed),
                "steps": steps,
                "policy_steps": steps // 5,
                "return": 11.0,
                "human_distance_mean_m": 0.8 + 0.1 * rng.random(),
                "human_distance_min_m": 0.4,
                "contact": int(failed),
                "unsafe_contact": int(failed),
                "other_collision": "none",
                "truncated": 0,
            }
        )
        legs = len(ROUTE[task]) - 1
        for leg in range(legs):
            start, end = leg * steps // legs, (leg + 1) * steps // legs
            options.append(
                {
                    "episode": i,
                    "option": list(ROUTE)[leg],
                    "attempt": 1,
                    "start_step": start,
                    "end_step": end,
                    "termination": "failure" if failed and leg == legs - 1 else "success",
                }
            )
        if i < 5:
            when = np.linspace(0, legs, steps)
            nodes = POINTS[list(ROUTE[task])]
            tool = np.stack([np.interp(when, np.arange(legs + 1), nodes[:, k]) for k in range(3)], axis=1)
            tool[:, 2] += 0.08 * np.sin(np.pi * (when % 1))
            human = np.array([0.2 + 0.1 * i, 0.75 - 0.3 * i]) + np.cumsum(rng.normal(0, 0.006, (steps, 2)), axis=0)
            for step in range(steps):
                paths.append(
                    {
                        "episode": i,
                        "step": step,
                        "stage": min(int(when[step]), legs - 1),
                        **{f"q{j}": q for j, q in enumerate((3 - when[step], -1.2, 1.0, 0.2, 1.57, 0))},
                        **dict(zip(("tcp_x", "tcp_y", "tcp_z"), tool[step], strict=True)),
                        "human_x": human[step, 0],
                        "human_y": human[step, 1],
                        "human_yaw": np.arctan2(-human[step, 1], -human[step, 0]),
                        "human_distance_m": np.hypot(*(tool[step, :2] - human[step])),
                    }
                )
    write(folder / "eval" / "episodes.csv", rows)
    write(folder / "eval" / "paths.csv", paths)
    if task == "cycle":
        write(folder / "eval" / "options.csv", options)
    write_json(folder / "eval" / "summary.json", summarise(records_of(rows, "episodes"), [], 500))


def make_demo(folder: Path, rows: int = 40, episodes: int = 21) -> Path:
    rng = np.random.default_rng(0)
    for task in ROUTE:
        (folder / task).mkdir(parents=True)
        (folder / task / "config.yaml").write_text(CONFIG.replace("NAME", task))
        if task != "cycle":
            make_training(folder / task, rng, rows)
        make_evaluation(folder / task, task, rng, episodes)
    return folder


def levels_of(demo, folder):
    shutil.copytree(demo / "pick", folder)
    for name, key in (("paths", "level"), ("episodes", "comfort_level")):
        table = pd.read_csv(folder / "eval" / f"{name}.csv")
        levels = [table.assign(**{key: level}) for level in (1, 4, 10)]
        pd.concat(levels).to_csv(folder / "eval" / f"{name}.csv", index=False)
    summary = summarise(read_table(folder / "eval" / "episodes.csv"), ["seen"], 500)
    write_json(folder / "eval" / "summary.json", summary)
    return run_folder.find_runs(folder)
