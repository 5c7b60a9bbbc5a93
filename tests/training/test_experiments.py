"""Every overlay of conf/experiment is a whole configuration whose first steps train."""

from __future__ import annotations

import pytest
from omegaconf import OmegaConf

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import HierarchyTrainConfig, TrainConfig
from hrl_comfort.config.overrides import choices, config_dir
from hrl_comfort.training.hierarchy_trainer import option_config
from hrl_comfort.training.trainer import train

CUT = (
    "agent.policy_steps=2000", "agent.hidden=[16,16]", "agent.batch_size=32", "agent.learning_starts=200",
    "agent.log_every=500", "agent.checkpoint_every=1000",
)  # fmt: skip


def root(name: str) -> str:
    overlay = OmegaConf.load(config_dir() / "experiment" / f"{name}.yaml")
    return "train_hierarchy" if "hierarchy" in overlay else "train"


def test_there_are_at_most_ten() -> None:
    assert len(choices("experiment")) <= 10


@pytest.mark.parametrize("name", choices("experiment"))
def test_its_first_steps_train(tmp_path, name: str) -> None:
    config = compose(root(name), [f"experiment={name}", *CUT, f"output='{tmp_path}'"])
    if isinstance(config, HierarchyTrainConfig):
        config = option_config(config, "pick", tmp_path / "pick", "ik")
    assert isinstance(config, TrainConfig)
    folder = train(config)
    stages = [stage.name for stage in config.curriculum.stages] or ["train"]
    rows = (folder / "metrics.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert list(dict.fromkeys(row.split(",")[1] for row in rows)) == stages
    assert (folder / "policy.pt").is_file()
