"""No state of finite numbers makes a subtask or a form of comfort say what is no number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from hrl_comfort.comfort import terms
from hrl_comfort.comfort.adapt import with_comfort
from hrl_comfort.config import comfort as allowed
from hrl_comfort.tasks import SUBTASKS, subtask
from hrl_comfort.tasks.observations import LAYOUTS
from tests.generating import COMFORT, ROWS, inputs, random_state, tried


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
