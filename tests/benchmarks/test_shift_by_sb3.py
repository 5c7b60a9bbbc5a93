"""The rivals of docs/shift_by_sb3.py are trained in the environments of `experiment=comfort_shift`."""

from __future__ import annotations

import importlib.util
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from pandas import json_normalize

import hrl_comfort
from hrl_comfort.config import EnvConfig, TrainConfig
from hrl_comfort.config.compose import environment, load_config

ROOT = Path(__file__).resolve().parents[2]
OWN = {"engine.num_envs", "task.start"}


def script() -> Any:
    pytest.importorskip("stable_baselines3", reason="stable_baselines3 is not installed: pip install -e '.[test]'")
    spec = importlib.util.spec_from_file_location("shift_by_sb3", ROOT / "docs" / "shift_by_sb3.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def flat(config: EnvConfig) -> dict[str, str]:
    values = json_normalize(asdict(config)).iloc[0].to_dict()
    return {key: str(value) for key, value in values.items() if key not in OWN}


@pytest.mark.parametrize("task", ["pick", "place", "return"])
def test_its_environments_and_steps_are_those_of_the_committed_policies(task: str) -> None:
    rivals, config = script(), load_config(ROOT / "runs" / "reference" / "comfort_shift" / "levels0" / task)
    assert isinstance(config, TrainConfig)
    assert flat(hrl_comfort.environment_of(task, rivals.ENVIRONMENT)) == flat(environment(config))
    assert rivals.POLICY_STEPS[task] == config.agent.policy_steps


def test_a_learner_of_each_algorithm_is_made_with_the_discount_of_a_decision() -> None:
    rivals = script()
    env = rivals.make_vec_env("hrl_comfort/Pick-v0", 2, seed=0, **rivals.ENVIRONMENT)
    for algorithm in ("SAC", "TD3", "PPO"):
        model = rivals.learner(algorithm, env, 0)
        assert type(model).__name__ == algorithm and model.gamma == pytest.approx(0.995**5)
    env.close()
