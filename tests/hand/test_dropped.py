"""An object that lies elsewhere than where it belongs is picked again; the arm goes home first."""

from __future__ import annotations

import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import State, subtask
from hrl_comfort.tasks.hand.grasp import REST_STEPS
from hrl_comfort.tasks.hand.rewards import HIGHEST_M

WORDS = ["task=cycle", "cell=grasp", "human=none", "meta_controller=nearest", "division=three"]
EXPERTS = [f"policies.{name}=expert" for name in ("pick", "place", "return")]


def cell(rows: int) -> Engine:
    return Engine(environment(compose("evaluate", [*WORDS, *EXPERTS])), rows, 0)


def lying(state: State, far: torch.Tensor) -> State:
    """Return the state in stage `place` whose target has been let go `far` (N,) tolerances from its place, at rest."""
    away = torch.zeros_like(state.target_place)
    away[:, 0] = far * state.place_tolerance
    rows = torch.arange(len(far)), state.target
    objects, free = state.objects.clone(), state.free_steps.clone()
    objects[rows], free[rows] = state.target_place + away, REST_STEPS
    still = torch.zeros_like(state.objects_vel)
    return state.with_(stage=torch.ones_like(state.stage), objects=objects, free_steps=free, objects_vel=still)


def test_a_stage_ends_forwards_in_its_place_and_backwards_elsewhere() -> None:
    engine = cell(3)
    state = lying(engine.reset(), torch.tensor([0.0, 0.9, 1.1]))
    after = subtask("cycle", hand=True).next_stage(state)
    assert after.tolist() == [2, 2, 0]
    paid = engine.episodes.subtask.rewards["pick"](state, state.with_(stage=after))
    assert paid.tolist() == [0.0, 0.0, -1.0]  # what the pick was paid for
    back = state.with_(stage=after)
    rewards, held = engine.episodes.subtask.rewards, state.pads.clone()
    held[2, state.target[2]] = True
    aloft = state.objects.clone()
    aloft[2, state.target[2], 2] += 1.0
    again = back.with_(pads=held, objects=aloft)
    for name, best in ("grasp", 1.0), ("lift", HIGHEST_M):
        dropped, picked = rewards[name](state, back), rewards[name](back, again)
        assert dropped[:2].tolist() == [0.0, 0.0] and -best <= float(dropped[2]) < 0.0
        assert float(dropped[2] + picked[2]) == pytest.approx(0.0, abs=1e-9)  # to pick it once more gains nothing
    assert (rewards["align"](state, back)[2] + rewards["align"](back, back.with_(stage=after + 1))[2]) <= 0.0
    alone = subtask("place", hand=True)
    assert alone.next_stage(state.with_(stage=torch.zeros_like(state.stage))).tolist() == [1, 1, 0]


def test_a_chain_goes_home_after_an_option_that_was_cut_short() -> None:
    engine = cell(2)
    executor, _ = make_executor(compose("evaluate", [*WORDS, *EXPERTS]), None, engine, 0)
    state = engine.reset()
    assert executor.table.names == ["pick", "place", "return", "retreat"]
    assert executor.available(state).tolist() == [[True, False, False, False]] * 2
    executor.load_state_dict({**executor.state_dict(), "_preempted": torch.tensor([True, True])})
    bent = state.joint_pos.clone()
    bent[1] += 0.5
    assert executor.available(state.with_(joint_pos=bent, steps=state.steps + 1)).tolist() == [
        [True, *[False] * 3],
        [*[False] * 3, True],
    ]
