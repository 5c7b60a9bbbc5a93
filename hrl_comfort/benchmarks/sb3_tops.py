"""Learners of Stable-Baselines3 and sb3-contrib as tops of `kitting` (extra `sb3`).

`python -m hrl_comfort.benchmarks.sb3_tops LEARNER CHOICES SEED FOLDER WORDS…` trains one for CHOICES options, by its
defaults but for OWN, and writes FOLDER; the words are those of `hrl-comfort evaluate`. `benchmarks.tops` sets
it beside other tops.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from sb3_contrib import QRDQN, MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import Tensor

from hrl_comfort.benchmarks.measure import as_command, given
from hrl_comfort.benchmarks.tops import TOLD, WORDS
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig
from hrl_comfort.config.checks import one_of
from hrl_comfort.files.atomic import write_json
from hrl_comfort.files.output import held_folder
from hrl_comfort.hierarchy.decision import Choose, Decision
from hrl_comfort.hierarchy.observation import observer
from hrl_comfort.hierarchy.option_cells import OptionCells
from hrl_comfort.sb3 import OptionVecEnv
from hrl_comfort.sb3_buffers import OptionMaskableRolloutBuffer, OptionReplayBuffer, OptionRolloutBuffer

LEARNERS: dict[str, type[BaseAlgorithm]] = {"PPO": PPO, "MaskablePPO": MaskablePPO, "QRDQN": QRDQN}
CELLS, GAMMA, OBSERVATION = 64, 0.998, "jobs"
"""Number of cells, the discount factor of a control step, and the layout that learned tops observe in `kitting`."""
ROLLOUT = 2048
"""Choices of a rollout of the PPOs, by default of the library."""
OWN: dict[str, dict[str, Any]] = {
    "PPO": {"rollout_buffer_class": OptionRolloutBuffer, "n_steps": ROLLOUT // CELLS},
    "MaskablePPO": {"rollout_buffer_class": OptionMaskableRolloutBuffer, "n_steps": ROLLOUT // CELLS},
    "QRDQN": {
        "replay_buffer_class": OptionReplayBuffer,
        "replay_buffer_kwargs": {"gamma": GAMMA},
        "buffer_size": 100_000,
        "train_freq": 1,
        "gradient_steps": -1,
        "exploration_fraction": 0.5,
    },
}
"""Keys that differ from the defaults: the discount over an option; for QRDQN an update a choice, as in our DQN."""
FILE, LIBRARY = "model.zip", "sb3"


def train(learner: str, choices: int, seed: int, folder: Path, config: EvaluateConfig) -> Path:
    """Train a learner for `choices` options in the world of `config`; return its folder.

    Raises:
      ConfigError: there is no such learner, or the folder holds something.
    """
    one_of("LEARNER", learner, tuple(LEARNERS))
    if folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty; choose another folder")
    cells = OptionVecEnv(OptionCells(config, CELLS, None, GAMMA, OBSERVATION))
    cells.seed(seed)
    given = {"gamma": GAMMA, "seed": seed, "device": "cpu", **OWN[learner]}
    with held_folder(folder):
        model = LEARNERS[learner]("MlpPolicy", cells, **given).learn(choices)
        model.save(folder / FILE)
        told = {"learner": f"{LIBRARY} {learner}", "choices": choices, "train_seed": seed}
        write_json(folder / TOLD, {**told, "chooser": f"hrl_comfort.benchmarks.sb3_tops:{chooser.__name__}"})
    cells.close()
    return folder


def chooser(folder: Path, config: EvaluateConfig) -> Choose:
    """Return the top in a folder: the first choice that can start replaces one that cannot."""
    told = json.loads((folder / TOLD).read_text(encoding="utf-8"))
    learner = LEARNERS[told["learner"].removeprefix(f"{LIBRARY} ")]
    model, see = learner.load(folder / FILE, device="cpu"), observer(config, OBSERVATION)

    def choose(decision: Decision) -> Tensor:
        masks: dict[str, Any] = {"action_masks": decision.mask.numpy()} if learner is MaskablePPO else {}
        chosen = torch.from_numpy(model.predict(see(decision.state).float().numpy(), deterministic=True, **masks)[0])
        able = decision.mask.gather(1, chosen[:, None]).squeeze(1)
        return torch.where(able, chosen, decision.mask.int().argmax(dim=1))

    return choose


def main(words: Sequence[str]) -> None:
    """Train a learner and write its folder."""
    torch.set_num_threads(1)
    learner, choices, seed, folder = given(words, "LEARNER CHOICES SEED FOLDER WORDS…", str, int, int, Path)
    config = compose("evaluate", [*WORDS, *words[4:]])
    assert isinstance(config, EvaluateConfig)
    train(learner, choices, seed, folder, config)


if __name__ == "__main__":
    as_command(main)
