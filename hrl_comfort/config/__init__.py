"""Every choice a user can make, as frozen dataclasses with units and range checks.

Values live in `conf/*.yaml` alone: no field here has a default, so a choice has one home.
Each part of the program is given its own section, never the root.
"""

from __future__ import annotations

from hrl_comfort.config.cell import (
    CellConfig,
    ConnectionConfig,
    EngineConfig,
    GripperConfig,
    ObjectConfig,
    ObstacleConfig,
    PlaceConfig,
    RobotConfig,
    VaryConfig,
)
from hrl_comfort.config.checks import ConfigError
from hrl_comfort.config.comfort import ComfortConfig
from hrl_comfort.config.commands import (
    DISTURBANCES,
    FIGURES,
    DeployConfig,
    EnvConfig,
    EvaluateConfig,
    ExportConfig,
    FigureConfig,
    IdentifyConfig,
    ReportConfig,
    ResultsConfig,
    StudioConfig,
)
from hrl_comfort.config.constants import (
    CONTROL_STEP_S,
    EVALUATION_EPISODES,
    FAR_AWAY_M,
    FIRST_SEED,
    HIERARCHY,
    POLICIES,
    PREGRASP,
    SCRIPTED_POLICIES,
    SPLITS,
    STARTS,
    TERMINAL_STATES_SEED,
    VALIDATION_SEED,
)
from hrl_comfort.config.hierarchy import MetaControllerAgentConfig, MetaControllerConfig
from hrl_comfort.config.human import HumanConfig
from hrl_comfort.config.learning import AgentConfig, CurriculumConfig, StageConfig
from hrl_comfort.config.safety import RandomiseConfig, SafetyConfig
from hrl_comfort.config.suite import BenchmarkConfig
from hrl_comfort.config.task import RANDOM, SORTING, PrecisionConfig, RewardConfig, TaskConfig
from hrl_comfort.config.training import (
    HierarchyConfig,
    HierarchyTrainConfig,
    MetaControllerTrainConfig,
    TrainConfig,
    TrainingConfig,
)

__all__ = [
    "CONTROL_STEP_S", "DISTURBANCES", "EVALUATION_EPISODES", "FAR_AWAY_M", "FIGURES", "FIRST_SEED", "HIERARCHY",
    "POLICIES", "PREGRASP", "RANDOM", "SCRIPTED_POLICIES", "SORTING", "SPLITS", "STARTS",
    "TERMINAL_STATES_SEED", "VALIDATION_SEED",
    "AgentConfig", "BenchmarkConfig", "CellConfig", "ComfortConfig", "ConfigError", "ConnectionConfig",
    "CurriculumConfig",
    "DeployConfig", "EngineConfig", "EnvConfig", "EvaluateConfig", "ExportConfig", "FigureConfig", "GripperConfig",
    "HierarchyConfig", "HierarchyTrainConfig", "HumanConfig", "IdentifyConfig", "MetaControllerAgentConfig",
    "MetaControllerConfig", "MetaControllerTrainConfig", "ObjectConfig", "ObstacleConfig", "PlaceConfig",
    "PrecisionConfig", "RandomiseConfig", "ReportConfig", "ResultsConfig", "RewardConfig", "RobotConfig",
    "SafetyConfig", "StageConfig", "StudioConfig", "TaskConfig", "TrainConfig", "TrainingConfig", "VaryConfig",
]  # fmt: skip
