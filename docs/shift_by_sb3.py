"""Train the skills of a shift with Stable-Baselines3: `python docs/shift_by_sb3.py ALGORITHM FOLDER [SEED]`.

ALGORITHM is SAC, TD3 or PPO. The environments are those of `experiment=comfort_shift`, with its ten levels and as many
policy steps; each skill starts where the one before it ends. FOLDER gets pick.zip, place.zip and return.zip:

hrl-comfort benchmark policies.pick=sb3:FOLDER/pick.zip policies.place=sb3:FOLDER/place.zip \
    policies.return=sb3:FOLDER/return.zip task.observation=proximity output=DIR
"""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.noise import NormalActionNoise

from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.compose import compose
from hrl_comfort.config.overrides import override
from hrl_comfort.evaluation.evaluate import evaluate
from hrl_comfort.sb3 import make_vec_env

POLICY_STEPS = {"pick": 40_000, "place": 100_000, "return": 50_000}
ENVIRONMENT: dict[str, object] = {
    "robot.rating": "collaborative",
    "human": "mixture",
    "safety": "ssm",
    "comfort": "distance_and_speed",
    "task.observation": "proximity",
    "task.ball_jitter_m": 0.075,
    "task.max_step_deg": 1.4,
    "task.terminate_on": "unsafe_contact",
    "task.arrival_speed_rad_s": 0.5,
    "reward.pick": 60,
    "reward.place": 60,
    "reward.home": 60,
    "reward.arrival_speed": -10,
    "reward.contact": -80,
    "reward.other_collision": -150,
    "reward.overtime": -0.2,
}
"""Overrides that `experiment=comfort_shift` makes for each of its skills."""


def learner(algorithm: str, env: Any, seed: int) -> Any:
    """Return a learner by the library's defaults but for gamma, 0.995 a control step, and what each line below sets.

    SAC and TD3 start after 2,000 steps and do 4 updates in 16 steps; PPO learns from rollouts of 2,048 steps.
    """
    common = {"seed": seed, "gamma": 0.995**5, "device": "cpu"}
    off_policy = {**common, "learning_starts": 2000, "train_freq": 1, "gradient_steps": 4}
    if algorithm == "PPO":
        return PPO("MlpPolicy", env, **common, n_steps=128)
    if algorithm == "TD3":
        return TD3("MlpPolicy", env, **off_policy, action_noise=NormalActionNoise([0.0] * 6, [0.1] * 6))
    return SAC("MlpPolicy", env, **off_policy)


def train(algorithm: str, folder: Path, seed: int) -> None:
    """Train the three skills, one after the other."""
    folder.mkdir(parents=True)
    start: dict[str, object] = {}
    for task, steps in POLICY_STEPS.items():
        env = make_vec_env(f"hrl_comfort/{task.title()}-v0", 16, seed=seed, **ENVIRONMENT, **start)
        learner(algorithm, env, seed).learn(steps).save(folder / f"{task}.zip")
        env.close()
        if task == "return":
            return
        ends = str(folder / f"{task}_ends.npz")
        asked = {"task": task, "policy": f"sb3:{folder / task}.zip", "episodes": 500, **ENVIRONMENT, **start}
        config = compose("evaluate", [override(key, each) for key, each in (asked | {"terminal_states": ends}).items()])
        assert isinstance(config, EvaluateConfig)
        try:
            evaluate(config)
            start = {"task.start": ends}
        except ConfigError as error:
            if "episode succeeded" not in str(error):
                raise
            print(f"{error}: the next skill starts as it does alone")
            start = {}


if __name__ == "__main__":
    parser = ArgumentParser(description="Train the skills of a shift with Stable-Baselines3.")
    parser.add_argument("algorithm", choices=["SAC", "TD3", "PPO"])
    parser.add_argument("folder", type=Path, help="a new folder for pick.zip, place.zip and return.zip")
    parser.add_argument("seed", type=int, nargs="?", default=0)
    given = parser.parse_args()
    if given.folder.exists():
        parser.error(f"{given.folder} exists already")
    torch.set_num_threads(1)
    train(given.algorithm, given.folder, given.seed)
