"""Observation of the learned controller of several objects: a pure function of State, lengths in metres."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hrl_comfort.comfort.terms import human_distance
from hrl_comfort.comfort.trajectory import PERSONAL_M
from hrl_comfort.config import SORTING, ConfigError, EnvConfig
from hrl_comfort.config.checks import implemented, one_of
from hrl_comfort.config.hierarchy import META_OBSERVATIONS, OBSERVED
from hrl_comfort.hierarchy.jobs import Jobs, jobs_of
from hrl_comfort.tasks import State
from hrl_comfort.tasks.cycle import CYCLE
from hrl_comfort.tasks.observations.standard import human, joint_error, seen_nearest, tool
from hrl_comfort.tasks.subtask import StateFunction

ROUND = len(CYCLE.stages)
"""Stages of one object's round: pick, place, return."""
OF_TASK = implemented(SORTING, {"sort": "default", "shift": "jobs", "kitting": "jobs"})
"""Layout of the observation that `observer` takes by default, by task."""
SOON_S = 20.0
"""Time until an order is due that is seen as 1, the largest."""


def observation_dim(layout: str, objects: int) -> int:
    """Return the size of `meta_observation`."""
    common, each = OBSERVED[layout]
    return common + each * objects


def meta_observation(state: State, levels: int, layout: str = "default") -> Tensor:
    """Return (N, observation_dim(layout, B)).

    The person seen nearest to the tool (2) and their facing direction (2, zero where their position is
    clipped) or, with the layout `jobs`, their nearness to the tool (1); tool (3), joints from home (6), stage of the
    round (3), level and whether there is one (2); of each object its position (3), where it belongs (2), the person's
    distance from both (2), whether it is placed and whether it is the target (2). With the layout `jobs` also how fast
    the nearest person comes nearer to both, m/s (2), and the time until it is due in SOON_S, from -1 to 1 (1). The
    layout `habits` has, beyond that, `met` of both (6) and `turns` (2).
    """
    place = state.object_places
    person = human(state)[:, None, None]
    index = torch.arange(state.objects.shape[1])
    parts = [
        state.objects,
        place[..., :2],
        human_distance(state.objects, person)[..., None],
        human_distance(place, person)[..., None],
        state.placed[..., None].double(),
        (state.target[:, None] == index)[..., None].double(),
    ]
    if layout != "default":
        jobs = jobs_of(state)
        nearest = jobs.gap.argmin(dim=-1, keepdim=True)
        left = (jobs.left / SOON_S).clamp(-1.0, 1.0)
        parts += [jobs.closing.gather(-1, nearest).squeeze(-1), left[..., None]]
    if layout == "habits":
        parts += [met(state, jobs), turns(state, jobs)]
    objects = torch.cat(parts, dim=-1)
    stage = torch.nn.functional.one_hot(state.stage % ROUND, ROUND).double()
    leveled = ~state.level.isnan()
    ease = torch.where(leveled, (state.level - 1) / (levels - 1), 0.0)
    level_given = torch.stack([ease, leveled.double()], dim=-1)
    seen = _position_and_facing(state) if layout == "default" else nearness(state)
    return torch.cat([seen, tool(state), joint_error(state), stage, level_given, objects.flatten(1)], dim=-1).float()


def observer(config: EnvConfig, layout: str | None = None) -> StateFunction:
    """Return `meta_observation` of the cells of `config`, with the layout of their task by default.

    Raises:
      ConfigError: there is no such layout, or the task has no options to choose from.
    """
    task = config.task.name
    if task not in OF_TASK:
        raise ConfigError(f"task.name={task!r} has one order of options; choose task={', '.join(SORTING)}")
    chosen = OF_TASK[task] if layout is None else layout
    one_of("observation", chosen, META_OBSERVATIONS)
    levels = config.comfort.levels
    return lambda state: meta_observation(state, levels, chosen)


def _position_and_facing(state: State) -> Tensor:
    """Return the person's position and facing direction (N, 4)."""
    yaw = state.humans_yaw
    facing = torch.stack([yaw.cos(), yaw.sin()], dim=-1) * state.humans_shown[..., None]
    return torch.cat([human(state), seen_nearest(state, facing)], dim=-1)


def met(state: State, jobs: Jobs) -> Tensor:
    """Return (N, B, 6) when the person nearest to each end of each job may come to it, by how they last walked.

    Of each end: sine and cosine of the angle that they have to go round the robot, the way they last walked (the sine
    is 0 before they walk), and how long they have stood, in SOON_S, at most 1.
    """
    nearest = jobs.gap.argmin(dim=-1)

    def of_nearest(each: Tensor) -> Tensor:
        return each[:, None, None].expand_as(jobs.gap).gather(-1, nearest[..., None]).squeeze(-1)

    angle = bearing_of(jobs.ends) - of_nearest(bearing_of(state.humans_pos))
    stood = (of_nearest(state.humans_stood) / SOON_S).clamp(max=1.0)
    return torch.cat([angle.sin() * of_nearest(state.humans_side), angle.cos(), stood], dim=-1)


def turns(state: State, jobs: Jobs) -> Tensor:
    """Return (N, B, 2) angles, in half turns, from the tool to each object and from there to where it belongs."""
    tool, (object_, place) = bearing_of(state.tcp_pos)[:, None], bearing_of(jobs.ends).unbind(dim=-1)
    angle = torch.stack([object_ - tool, place - object_], dim=-1)
    return torch.atan2(angle.sin(), angle.cos()).abs() / math.pi


def bearing_of(points: Tensor) -> Tensor:
    """Return the bearing (…,) rad of points (…, 2) or (…, 3) m round the robot's base."""
    return torch.atan2(points[..., 1], points[..., 0])


def nearness(state: State) -> Tensor:
    """Return (N, 1): nearness of the human as seen: 1 at the tool, 0 from `PERSONAL_M` on and beside nobody.

    It has no direction, so that a policy cannot learn the places of training by heart.
    """
    distance = (human(state) - state.tcp_pos[:, :2]).norm(dim=-1, keepdim=True)
    return (1 - distance / PERSONAL_M).clamp(min=0.0)
