"""Every choice a user can make, as frozen dataclasses with units and range checks.

Values live in `conf/*.yaml` alone: no field here has a default, so a choice has one home.
Each part of the program is given its own section, never the root.
"""

from __future__ import annotations

from hrl_comfort.config.cell import CellConfig, EngineConfig, RobotConfig
from hrl_comfort.config.checks import ConfigError
from hrl_comfort.config.comfort import ComfortConfig
from hrl_comfort.config.commands import (
    DISTURBANCES,
    FIGURES,
    EnvConfig,
    EvaluateConfig,
    FigureConfig,
    MetaTrainConfig,
    ReportConfig,
    TrainConfig,
)
from hrl_comfort.config.constants import (
    CONTROL_STEP_S,
    ENDINGS_SEED,
    EVALUATION_EPISODES,
    FAR_AWAY_M,
    FIRST_SEED,
)
from hrl_comfort.config.human import HumanConfig
from hrl_comfort.config.learning import AgentConfig, CurriculumConfig
from hrl_comfort.config.meta import MetaAgentConfig, MetaConfig
from hrl_comfort.config.task import PrecisionConfig, RewardConfig, TaskConfig

__all__ = [
    "CONTROL_STEP_S",
    "DISTURBANCES",
    "ENDINGS_SEED",
    "EVALUATION_EPISODES",
    "FAR_AWAY_M",
    "FIGURES",
    "FIRST_SEED",
    "AgentConfig",
    "CellConfig",
    "ComfortConfig",
    "ConfigError",
    "CurriculumConfig",
    "EngineConfig",
    "EnvConfig",
    "EvaluateConfig",
    "FigureConfig",
    "HumanConfig",
    "MetaAgentConfig",
    "MetaConfig",
    "MetaTrainConfig",
    "PrecisionConfig",
    "ReportConfig",
    "RewardConfig",
    "RobotConfig",
    "TaskConfig",
    "TrainConfig",
]
