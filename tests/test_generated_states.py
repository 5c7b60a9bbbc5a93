"""No state of finite numbers makes a subtask or a form of comfort say what is no number."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from hrl_comfort.comfort import terms
from hrl_comfort.comfort.adapt import with_comfort
from hrl_comfort.compose import compose
from hrl_comfort.config import FAR_AWAY_M
from hrl_comfort.config import comfort as allowed
from hrl_comfort.tasks import SUBTASKS, State, subtask
from hrl_comfort.tasks.observations import LAYOUTS
from tests.generating import inputs, tried

COMFORT = compose("evaluate", ["comfort=conditioned"]).comfort
SIZES = {
    "joint_pos": (6,), "joint_vel": (6,), "joint_target": (6,), "joint_home": (6,), "points": (2, 3),
    "human_pos": (2,), "human_seen": (2,), "human_yaw": (), "take": (), "leave": (), "home_tolerance": (),
    "arm_distance": (), "level": (), "balls": (1, 3),
}  # fmt: skip
"""Of a row of each field of `State`; the others are points."""
FLAGS = ("human_collision", "table_collision", "self_collision")
ROWS = 4


def random_state(rng: np.random.Generator, exponents: tuple[int, int]) -> State:
    """Return a state of finite numbers of such powers of ten, among them some zeros and some the same."""

    def numbers_of(size: tuple[int, ...]) -> torch.Tensor:
        scale = 10.0 ** rng.uniform(*sorted(exponents), (ROWS, *size))
        kept = rng.random((ROWS, *size)) > 0.2
        return torch.from_numpy(rng.choice([-1.0, 1.0], (ROWS, *size)) * scale * kept)

    whole: dict[str, torch.Tensor] = {
        "colour": torch.from_numpy(rng.integers(2, size=ROWS)),
        "colours": torch.from_numpy(rng.integers(2, size=(ROWS, 1))),
        "placed": torch.from_numpy(rng.random((ROWS, 1)) < 0.5),
        "target": torch.zeros(ROWS, dtype=torch.int64),
        "stage": torch.from_numpy(rng.integers(4, size=ROWS)),
        "steps": torch.from_numpy(rng.integers(10**6, size=ROWS)),
        "level": torch.from_numpy(rng.integers(1, COMFORT.levels + 1, size=ROWS).astype(np.float64)),
        **{name: torch.from_numpy(rng.random(ROWS) < 0.5) for name in FLAGS},
    }
    names = [field.name for field in dataclasses.fields(State)]
    state = State(**{name: whole.get(name, numbers_of(SIZES.get(name, (3,)))) for name in names})
    if rng.random() < 0.3:
        away = torch.tensor([[FAR_AWAY_M, 0.0]], dtype=torch.float64).expand(ROWS, 2)
        return state.with_(human_pos=away, human_seen=away, arm_distance=torch.full((ROWS,), math.nan))
    return state.with_(human_pos=state.tcp_pos[:, :2].clone()) if rng.random() < 0.3 else state


@inputs(0.12)
@given(
    seed=st.integers(0, 2**32 - 1),
    exponents=st.tuples(st.integers(-200, 100), st.integers(-200, 100)),
    name=st.sampled_from(sorted(SUBTASKS)),
    layout=st.sampled_from(sorted(LAYOUTS)),
    forms=st.tuples(
        st.sampled_from(sorted(terms.FORMS)),
        st.sampled_from(sorted(terms.THRESHOLDS)),
        st.sampled_from(sorted(terms.SPEED_FORMS)),
        st.sampled_from(allowed.DISTANCES),
    ),
)
def test_no_state_makes_a_subtask_or_a_form_of_comfort_say_what_is_no_number(
    seed: int, exponents: tuple[int, int], name: str, layout: str, forms: tuple[str, str, str, str]
) -> None:
    named = dict(zip(("form", "threshold", "speed_form", "distance"), forms, strict=True))
    config = replace(COMFORT, beta=0.5, **named)
    task = with_comfort(subtask(name, layout), config, max_step_deg=2.0)
    rng = np.random.default_rng(seed)
    before, after = (random_state(rng, exponents) for _ in range(2))
    before, after = (each.with_(stage=each.stage.clamp(max=len(task.stages))) for each in (before, after))

    def said() -> dict[str, torch.Tensor]:
        paid = {f"reward {name}": term(before, after) for name, term in task.rewards.items()}
        seen = {f"observation {name}": term(after) for name, term in task.observations.items()}
        return {**paid, **seen, "success": task.success(after), "failure": task.failure(after)}

    for what, tensor in (tried(said) or {}).items():
        assert tensor.shape[0] == ROWS and tensor.isfinite().all(), what
