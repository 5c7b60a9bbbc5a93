"""The options of `sort`, and the controller that lets a choice decide whenever one of them has ended."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hrl_comfort.config import ComfortConfig, ConfigError, EnvConfig, MetaControllerConfig, TaskConfig
from hrl_comfort.hierarchy.controllers import OptionRun
from hrl_comfort.hierarchy.executor import TERMINATIONS, OptionExecutor
from hrl_comfort.hierarchy.meta_controllers import WAIT, Choose, Decision
from hrl_comfort.hierarchy.observation import ROUND
from hrl_comfort.hierarchy.options import IdleOption, Option
from hrl_comfort.policies.expert import Expert
from hrl_comfort.policies.load import Act, make_policy
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State, subtask
from hrl_comfort.tasks.return_home import GO_HOME

SKILLS = ("pick", "place", "return")
WAIT_STEPS = 25
"""Control steps that a wait lasts: half a second."""
REST_RAD_S = 0.1
"""A joint that is slower than this is at rest."""


def sorting_options(
    meta_controller: MetaControllerConfig, policies: dict[str, str], scene: Scene, config: EnvConfig, seed: int
) -> list[Option | IdleOption]:
    """Return a pick for each ball, place and return, for each level they may be told, then wait and retreat.

    Policies, by subtask name, see the level in force or, in further options, one of
    `meta_controller.level_override`.

    Raises:
      ConfigError: the division is another, or a policy is missing or does not fit.
    """
    if tuple(meta_controller.options) != SKILLS:
        raise ConfigError(f"meta_controller.options={list(meta_controller.options)} do not sort; choose division=three")
    missing = [name for name in SKILLS if name not in policies]
    if missing:
        raise ConfigError(f"policies.{missing[0]} is not given; task=sort needs {', '.join(SKILLS)}")
    if config.task.action != "joint":
        raise ConfigError(f"task.action={config.task.action!r} does not go with task=sort; choose joint")
    for known in meta_controller.level_override:
        check_told(known, config.comfort)
    act = {name: make_policy(policies[name], subtask(name), scene, config, seed) for name in SKILLS}
    skills: list[Option | IdleOption] = []
    for level in (None, *meta_controller.level_override):
        suffix = "" if level is None else f"_as_{level}"
        skills += [
            Option(f"pick_{k + 1}{suffix}", subtask("pick"), act["pick"], 0, ROUND, k, level)
            for k in range(config.task.balls)
        ]
        skills += [
            Option(f"{name}{suffix}", subtask(name), act[name], first, ROUND, level=level)
            for first, name in enumerate(SKILLS)
            if name != "pick"
        ]
    home = Expert(scene, config, subtask("return"))
    return [
        *skills,
        # Where a ball has just been placed the arm may be fast, close above a table. A ball just taken is not
        # carried home, for a place is trained to begin where a pick ends.
        IdleOption("wait", stop(config.task), lambda state: ~has_placed(state), WAIT_STEPS),
        IdleOption("retreat", home.act, has_placed, done=GO_HOME.done),
    ]


def has_placed(state: State) -> Tensor:
    """Return (N,) bool: a ball has just been placed, and the arm is to return."""
    return state.stage % ROUND == SKILLS.index("return")


def check_told(level: int, comfort: ComfortConfig) -> None:
    """Raise ConfigError if there is no such level to tell a skill, or none in force."""
    if comfort.source == "none" or level > comfort.levels:
        raise ConfigError(
            f"meta_controller.level_override={level} with comfort.source={comfort.source} and "
            f"comfort.levels={comfort.levels}; "
            "choose among the levels of a source, or meta_controller.level_override=[]"
        )


def stop(task: TaskConfig) -> Act:
    """Return what brings the arm to rest: while a joint moves, the servos' targets go back to the joints.

    At rest they stay as they are, for a servo holds the arm up by how far it is from its target.
    """
    reach = task.action_repeat * math.radians(task.max_step_deg)

    def act(state: State) -> Tensor:
        moving = state.joint_vel.abs().amax(dim=-1, keepdim=True) > REST_RAD_S
        back = ((state.joint_pos - state.joint_target) / reach).clamp(-1.0, 1.0)
        return torch.where(moving, back, 0.0)

    return act


class SortController:
    """Runs options until they end, and lets `choose` say what comes next."""

    def __init__(self, executor: OptionExecutor, choose: Choose) -> None:
        self.executor, self._choose = executor, choose
        self.runs: list[OptionRun] = []

    def begin(self, rows: int) -> None:
        """Start afresh with N rows."""
        self._deciding = torch.ones(rows, dtype=torch.bool)
        self._over = torch.zeros(rows, dtype=torch.bool)
        self._last = torch.full((rows,), -1, dtype=torch.int64)
        self._waits = torch.zeros(rows, dtype=torch.int64)
        self._attempt = torch.zeros(rows, dtype=torch.int64)
        self.runs = []

    def act(self, state: State) -> Tensor:
        """Return actions (N, 6); rows whose option has ended choose anew, those that are over stand still."""
        rows = self._deciding & ~self._over
        if bool(rows.any()):
            decision = Decision(state, self.executor.available(state), self._waits)
            chosen = torch.where(rows, self._choose(decision), self.executor.option)
            self._attempt = torch.where(rows, torch.where(chosen == self._last, self._attempt + 1, 1), self._attempt)
            state = self.executor.begin(rows, chosen)
        return self.executor.act(state, ~self._over)

    def observe(self, outcome: StepResult) -> Tensor:
        """Note what a decision led to and return (N,) bool: rows given up, none."""
        ended = self.executor.ended(outcome)
        rows = ended.rows & ~self._over
        wait = len(self.executor.options) + WAIT
        for row in torch.nonzero(rows).squeeze(-1).tolist():
            index = int(self.executor.option[row])
            self.runs.append(
                OptionRun(
                    row,
                    self.executor.options[index].name,
                    int(self._attempt[row]),
                    int(self.executor.started[row]),
                    int(outcome.state.steps[row]),
                    TERMINATIONS[int(ended.termination[row])].value,
                )
            )
        self._waits = torch.where(rows, torch.where(self.executor.option == wait, self._waits + 1, 0), self._waits)
        self._last = torch.where(rows, self.executor.option, self._last)
        self._deciding = rows
        self._over = self._over | outcome.done
        return torch.zeros_like(self._over)
