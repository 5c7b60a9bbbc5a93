"""The table of options of `sort`, `shift` and `kitting`."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hrl_comfort.config import ConfigError, EnvConfig, MetaControllerConfig, TaskConfig
from hrl_comfort.hierarchy.observation import ROUND
from hrl_comfort.hierarchy.options import Begun, Option, OptionTable, grid, in_hand, lasts, skill
from hrl_comfort.hierarchy.own_options import with_own
from hrl_comfort.policies.load import Act, make_policy
from hrl_comfort.scene.workcell import Scene
from hrl_comfort.tasks import State, subtask
from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.pick import PICK, PICK_STAGE
from hrl_comfort.tasks.place import PLACE, PLACE_STAGE
from hrl_comfort.tasks.return_home import RETURN, RETURN_STAGE

SKILLS = (PICK, PLACE, RETURN)
WAIT_STEPS = 25
"""Duration of a wait, control steps (0.5 s)."""
REST_RAD_S = 0.1
"""Joint speed below which a joint is at rest."""


def sorting_table(
    meta_controller: MetaControllerConfig, policies: dict[str, str], scene: Scene, config: EnvConfig, seed: int
) -> OptionTable:
    """Return a pick for each object, place and return, for each level they may be given, then wait and retreat.

    Policies, by subtask name, see the level in force or, in further options, one of
    `meta_controller.level_override`. Options of users come last.

    Raises:
      ConfigError: the division is not three, a policy is missing or does not fit, a level is not one of the source, or
        as `with_own` does.
    """
    hand = config.robot.gripper.holds
    parts = [subtask(each.name, hand=hand) for each in SKILLS]
    names = [each.name for each in SKILLS]
    if list(meta_controller.options) != names:
        raise ConfigError(f"meta_controller.options={list(meta_controller.options)} do not sort; choose division=three")
    missing = [name for name in names if name not in policies]
    if missing:
        raise ConfigError(f"policies.{missing[0]} is not given; task={config.task.name} needs {', '.join(names)}")
    if config.task.action != "joint":
        raise ConfigError(f"task.action={config.task.action!r} does not go with task={config.task.name}; choose joint")
    comfort = config.comfort
    for given in meta_controller.level_override:
        if comfort.source == "none" or given > comfort.levels:
            raise ConfigError(
                f"meta_controller.level_override={given} with comfort.source={comfort.source} and "
                f"comfort.levels={comfort.levels}; "
                "choose among the levels of a source, or meta_controller.level_override=[]"
            )
    limit, waits = meta_controller.time_limit_steps, meta_controller.max_waits
    acts = [make_policy(policies[part.name], part, scene, config, seed) for part in parts]
    period = meta_controller.interruption_steps
    skills = [skill(part, acts[k], limit, k, ROUND, period) for k, part in enumerate(parts)]
    home, rest, at_home = way_home(scene, config, seed), stop(config.task), RETURN_STAGE.done
    rest = holding(rest) if hand else rest
    # After a place the arm may be fast, close above a table: it retreats, and does not wait. With an object it
    # does not retreat, for a place is trained to begin where a pick ends. An interrupted pick can give way to a person.
    wait = Option("wait", rest, lambda state: ~has_placed(state), lasts(WAIT_STEPS), max_runs=waits)
    can_retreat = has_placed if period is None else has_nothing
    retreat = Option(
        "retreat", home, lambda state: can_retreat(state) & ~at_home(state), lambda state, _: at_home(state),
        interruption_steps=period, recovers=True,
    )  # fmt: skip
    choices = grid(skills, {PICK.name: config.task.objects}, meta_controller.level_override)
    return OptionTable(with_own([*choices, wait, retreat], meta_controller, scene, config, seed))


def way_home(scene: Scene, config: EnvConfig, seed: int) -> Act:
    """Return the policy that brings the arm home from wherever a skill has left it: the scripted expert."""
    hand = config.robot.gripper.holds
    act = make_policy("expert", subtask(RETURN.name, hand=hand), scene, config, seed)
    return holding(act) if hand else act


def recovery(scene: Scene, config: EnvConfig, seed: int) -> Option:
    """Return the option `retreat` of a chain with a hand: after an option that was cut short, home to pick anew."""
    home, at_home = way_home(scene, config, seed), RETURN_STAGE.done

    def never(state: State) -> Tensor:
        return torch.zeros_like(at_home(state))

    def ends(state: State, _: Begun) -> Tensor:
        return at_home(state) | ~(has_to_pick(state) & has_nothing(state))

    return Option("retreat", home, never, ends, recovers=True)


def has_placed(state: State) -> Tensor:
    """Return (N,) bool: an object has just been placed; the arm is to return."""
    return state.stage % ROUND == CYCLE.stages.index(RETURN_STAGE)


def has_to_pick(state: State) -> Tensor:
    """Return (N,) bool: the next object is to be picked."""
    return state.stage % ROUND == CYCLE.stages.index(PICK_STAGE)


def has_nothing(state: State) -> Tensor:
    """Return (N,) bool: no object is on the tool or in the hand."""
    return (state.stage % ROUND != CYCLE.stages.index(PLACE_STAGE)) & ~in_hand(state).any(dim=1)


def stop(task: TaskConfig) -> Act:
    """Return a policy that brings the arm to rest: while a joint moves, the servo targets go to the joint angles.

    At rest they stay, for a servo's position error holds the arm up.
    """
    reach = task.action_repeat * math.radians(task.max_step_deg)

    def act(state: State) -> Tensor:
        moving = state.joint_vel.abs().amax(dim=-1, keepdim=True) > REST_RAD_S
        back = ((state.joint_pos - state.joint_target) / reach).clamp(-1.0, 1.0)
        return torch.where(moving, back, 0.0)

    return act


def holding(act: Act) -> Act:
    """Return the policy `act` of an arm with a hand, whose fingers stay as they are around an object, and else open."""

    def holding(state: State) -> Tensor:
        arm = act(state)[:, : state.joint_pos.shape[1]]
        fingers = torch.where(in_hand(state).any(dim=1), 2 * state.grip_target - 1, -1.0)
        return torch.cat([arm, fingers[:, None]], dim=-1)

    return holding
