"""The semi-MDP above the options: returns, masks, and TorchRL's own bootstrap over options of any length."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs.utils import check_env_specs
from torchrl.objectives.value import TD0Estimator

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.executor import TERMINATIONS
from hrl_comfort.hierarchy.option_env import OptionEnv
from hrl_comfort.hierarchy.options import OptionTable, Termination, chain, skill
from hrl_comfort.policies.expert import Expert
from hrl_comfort.sim.engine import Engine
from hrl_comfort.tasks import subtask

GAMMA = 0.97


def config(*overrides: str) -> EnvConfig:
    return environment(compose("train", ["task=cycle", "human=random_walk", *overrides]))


def experts(engine: Engine) -> OptionTable:
    parts = [subtask(name) for name in ("pick", "place", "return")]
    env = engine.episodes.config
    return chain([(part, Expert(engine.scene, env, part).act) for part in parts], 500)


def still(engine: Engine) -> OptionTable:
    return chain([(subtask(n), lambda s: torch.zeros_like(s.joint_pos)) for n in ("pick", "place", "return")], 20)


def choose(env: OptionEnv, td: TensorDict) -> Tensor:
    return td["action_mask"].int().argmax(dim=-1)


def test_it_is_a_sound_torchrl_environment() -> None:
    # Random actions of the check would choose options that cannot start: one option can always.
    def one(engine: Engine) -> OptionTable:
        return OptionTable([skill(subtask("pick"), lambda s: torch.zeros_like(s.joint_pos), 10)])

    check_env_specs(OptionEnv(environment(compose("train", ["task=pick"])), one, 3, 0, GAMMA))


@pytest.mark.parametrize("seed", [-1, 1.5, 2**32])
def test_a_seed_that_no_front_takes_is_refused(seed: int) -> None:
    message = "must be a whole number from 0 to 4294967295"
    with pytest.raises(ConfigError, match=message):
        OptionEnv(config("human=none"), still, 2, seed, GAMMA)
    with pytest.raises(ConfigError, match=message):
        OptionEnv(config("human=none"), still, 2, 0, GAMMA)._set_seed(seed)


def test_no_seed_draws_an_evaluation_episode() -> None:
    env = OptionEnv(config("human=none"), still, 2, 0, GAMMA)
    env.set_seed(1_000_000)
    assert env.engine.episodes.sampler.seed > 2**31


def test_experts_do_the_cycle_one_option_after_the_other() -> None:
    env = OptionEnv(config(), experts, 4, 0, GAMMA)
    td, terminal_states, done = env.reset(), [[] for _ in range(4)], torch.zeros(4, dtype=torch.bool)
    while not done.all():
        chosen = choose(env, td)
        td = env.step(td.set("action", chosen))["next"]
        for row in torch.nonzero(td["deciding"].squeeze(-1) & ~done).squeeze(-1).tolist():
            terminal_states[row].append((int(chosen[row]), TERMINATIONS[int(td["termination"][row])]))
        done |= td["done"].squeeze(-1)
    assert terminal_states == [[(k, Termination.SUCCESS) for k in range(3)]] * 4


def test_an_option_earns_its_rewards_discounted_by_the_control_step() -> None:
    env = OptionEnv(config(), experts, 3, 0, GAMMA)
    twin = Engine(config(), 3, 0)
    option, state = experts(twin).options[0], twin.reset()
    td = env.reset()
    lengths, returns, waiting = torch.zeros(3, dtype=torch.int64), torch.zeros(3), torch.ones(3).bool()
    while waiting.any():
        td = env.step(td.set("action", torch.zeros(3, dtype=torch.int64)))["next"]
        ended = td["deciding"].squeeze(-1) & waiting
        lengths[ended], returns[ended] = td["steps_to_next_obs"][ended, 0], td["reward"][ended, 0]
        waiting &= ~ended
        if waiting.any():
            td["action"] = td["action_mask"].int().argmax(-1)
            break  # from here on other options run beside it
    first = ~waiting
    by_hand = [0.0] * 3
    for _ in range(int(lengths[first].max())):
        outcome = twin.step(option.policy(state).numpy())
        for row in torch.nonzero(first).squeeze(-1).tolist():
            for k in range(int(outcome.decision_steps[row])):
                step = int(state.steps[row]) + k
                if step < int(lengths[row]):
                    by_hand[row] += GAMMA**step * float(outcome.step_rewards[row, k])
        state = outcome.state
    for row in torch.nonzero(first).squeeze(-1).tolist():
        assert float(returns[row]) == pytest.approx(by_hand[row], rel=1e-5)


def test_an_option_that_gets_nowhere_is_preempted_at_its_limit() -> None:
    env = OptionEnv(config("human=none"), still, 2, 0, GAMMA)
    td = env.reset()
    td = env.step(td.set("action", choose(env, td)))["next"]
    assert td["deciding"].all() and (td["steps_to_next_obs"] == 20).all()
    assert [TERMINATIONS[i] for i in td["termination"].squeeze(-1).tolist()] == [Termination.PREEMPTED] * 2
    assert not td["done"].any() and td["action_mask"].tolist() == [[True, False, False]] * 2


def test_an_option_that_cannot_start_is_masked_and_refused() -> None:
    env = OptionEnv(config(), still, 2, 0, GAMMA)
    td = env.reset()
    assert td["action_mask"].tolist() == [[True, False, False]] * 2
    with pytest.raises(ValueError, match="row 1: option return cannot start"):
        env.step(td.set("action", torch.tensor([0, 2])))


def test_rows_that_go_on_keep_their_option_whatever_is_chosen() -> None:
    env = OptionEnv(config(), experts, 6, 0, GAMMA)
    td = env.step(env.reset().set("action", torch.zeros(6, dtype=torch.int64)))["next"]
    deciding = td["deciding"].squeeze(-1)
    assert deciding.any() and not deciding.all()
    td["action"] = torch.where(deciding, choose(env, td), 2)
    env.step(td)
    assert (env.executor.option[~deciding] == 0).all()


def test_transitions_hold_the_option_from_where_it_began_to_where_it_ended() -> None:
    env = OptionEnv(config(), experts, 6, 0, GAMMA)
    start = env.reset()
    after = env.step(start.clone().set("action", torch.zeros(6, dtype=torch.int64)))["next"]
    rows = torch.nonzero(after["deciding"].squeeze(-1)).squeeze(-1)
    found = env.transitions(after)
    assert torch.equal(found["observation"], start["observation"][rows])
    assert torch.equal(found["next", "observation"], after["observation"][rows])
    assert torch.equal(found["steps_to_next_obs"], after["steps_to_next_obs"][rows])


class Table(nn.Module):
    """A value (…, 1) for each of two one-hot states."""

    def __init__(self, values: list[float]) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.tensor(values))

    def forward(self, observation: Tensor) -> Tensor:
        return (observation * self.values).sum(dim=-1, keepdim=True)


def test_two_states_reach_the_value_that_has_a_closed_form() -> None:
    """A -> B in 3 steps for 1, B -> A in 5 steps for 2: V(A) = (1 + g^3 2) / (1 - g^8), and V(B) alike."""
    transitions = TensorDict(
        {
            "observation": torch.eye(2),
            "steps_to_next_obs": torch.tensor([[3], [5]]),
            "next": TensorDict(
                {
                    "observation": torch.eye(2).flip(0),
                    "reward": torch.tensor([[1.0], [2.0]]),
                    "done": torch.zeros(2, 1, dtype=torch.bool),
                    "terminated": torch.zeros(2, 1, dtype=torch.bool),
                },
                batch_size=[2],
            ),
        },
        batch_size=[2],
    )
    table = Table([0.0, 0.0])
    critic = TensorDictModule(table, in_keys=["observation"], out_keys=["state_value"])
    estimator = TD0Estimator(gamma=GAMMA, value_network=critic)
    for _ in range(200):
        target = estimator.value_estimate(transitions.clone())
        table.values.data = target.detach().squeeze(-1)
    closed = [
        (1 + GAMMA**3 * 2) / (1 - GAMMA**8),
        (2 + GAMMA**5 * 1) / (1 - GAMMA**8),
    ]
    assert table.values.tolist() == pytest.approx(closed, rel=1e-4)


def test_rows_in_mid_option_keep_their_return_and_origin_while_others_begin_anew() -> None:
    env = OptionEnv(config(), experts, 6, 0, 1.0)
    td = env.reset()
    begun, seen = td["observation"].clone(), torch.zeros(6)
    earned, steps = torch.zeros(6, dtype=torch.float64), torch.zeros(6, dtype=torch.int64)
    kept = {"reward": torch.zeros(6, dtype=torch.float64), "steps": torch.zeros(6, dtype=torch.int64)}
    while not (seen > 0).all():
        deciding = td["deciding"].squeeze(-1)
        begun[deciding] = td["observation"][deciding]
        stepped, td = env.step_and_maybe_reset(td.set("action", choose(env, td)))
        after = stepped["next"]
        rows = torch.nonzero(after["deciding"].squeeze(-1)).squeeze(-1)
        found = env.transitions(after)
        assert torch.equal(found["observation"], begun[rows])
        earned += env.earned
        kept["reward"][rows] += found["next", "reward"].squeeze(-1).double()
        kept["steps"][rows] += found["steps_to_next_obs"].squeeze(-1)
        for row in torch.nonzero(after["done"].squeeze(-1)).squeeze(-1).tolist():
            steps[row] += env.last_state.steps[row]
            # With gamma 1 the options of an episode earn and last what the episode does.
            torch.testing.assert_close(kept["reward"][row], earned[row], rtol=1e-5, atol=1e-4)
            assert kept["steps"][row] == steps[row]
            seen[row] += 1
