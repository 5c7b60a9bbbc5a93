"""TorchRL takes the environment of options as its documentation says: specs, masks, macros and PPO."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data.replay_buffers import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import ActionMask, MultiAction, RewardSum
from torchrl.envs.utils import check_env_specs
from torchrl.modules import MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from hrl_comfort import options_of
from hrl_comfort.config import ConfigError
from hrl_comfort.hierarchy.option_cells import OptionVector
from hrl_comfort.hierarchy.option_env import OptionEnv, make_option_env

GAMMA = 0.99
DURATION = ("next", "steps_to_next_obs")
QUICK: dict[str, Any] = {"task.max_episode_steps": 120, "human": "none"}


def made(rows: int, **choices: Any) -> OptionEnv:
    return make_option_env(options_of("sort", {**QUICK, **choices}), rows, gamma=GAMMA)


@pytest.mark.parametrize("masked", [False, True])
def test_its_specs_pass_torchrls_own_check(masked: bool) -> None:
    env = made(3)
    assert env.action_spec.n == env.observation_spec["action_mask"].shape[-1] == 8
    check_env_specs(TransformedEnv(env, ActionMask()) if masked else env)


def test_every_row_decides_at_every_step_as_in_the_vector_environment() -> None:
    env, twin = made(3), OptionVector(options_of("sort", QUICK), 3, gamma=GAMMA)
    env.set_seed(7)
    td, (observations, infos) = env.reset(), twin.reset(seed=7)
    durations = set()
    for _ in range(6):
        assert torch.equal(td["observation"], torch.from_numpy(observations)) and td["deciding"].all()
        chosen = td["action_mask"].int().argmax(dim=-1)
        stepped, td = env.step_and_maybe_reset(td.set("action", chosen))
        observations, rewards, *_, infos = twin.step(chosen.numpy())
        after = stepped["next"]
        assert torch.equal(after["reward"].squeeze(-1), torch.from_numpy(rewards).float())
        assert after["steps_to_next_obs"].squeeze(-1).tolist() == infos["duration"].tolist()
        durations |= {len(set(infos["duration"].tolist()))}
    assert durations - {1}, "rows waited for one another"


def test_random_choices_honour_the_mask() -> None:
    steps = TransformedEnv(made(3), ActionMask()).rollout(8, break_when_any_done=False)
    assert steps["action_mask"].gather(-1, steps["action"][..., None]).all()


def test_an_option_that_cannot_start_is_replaced() -> None:
    env = made(2)
    td = env.step(env.reset().set("action", torch.tensor([4, 1])))  # place, with nothing in the hand
    assert env.executor.option.tolist() == [0, 1] and (td["next", "steps_to_next_obs"] > 0).all()


def test_a_sequence_of_options_is_one_macro_action() -> None:
    env, plain = TransformedEnv(made(2), MultiAction()), made(2)
    names = plain.executor.table.names
    sequence = torch.tensor([names.index(each) for each in ("pick_2", "place", "return")]).repeat(2, 1)
    for each in (env, plain):
        each.set_seed(0)
    stepped = env.step(env.reset().set("action", sequence))
    td, rewards = plain.reset(), []
    for chosen in sequence.T:
        td = plain.step(td.set("action", chosen))
        rewards.append(td["next", "reward"])
        td = td["next"].clone()
    assert torch.equal(stepped["next", "reward"], torch.stack(rewards, dim=1))
    assert torch.equal(stepped["next", "observation"], td["observation"])


def test_rows_that_are_done_stand_still_within_a_macro() -> None:
    env = made(2, **{"task.max_episode_steps": 40})
    td = env.reset().set("action", torch.zeros(2, dtype=torch.int64)).set("_step", torch.tensor([True, False]))
    before = env.engine.episodes.state.steps.clone()
    after = env.step(td)["next"]
    assert after["deciding"].reshape(-1).tolist() == [True, False]
    assert float(after["reward"][1]) == 0.0 and int(env.last_state.steps[1]) == int(before[1])


def test_ppo_of_its_documentation_learns_on_it() -> None:
    torch.manual_seed(0)
    env = TransformedEnv(made(4), RewardSum())
    width, count = env.observation_spec["observation"].shape[-1], env.action_spec.n
    policy = nn.Sequential(nn.Linear(width, 32), nn.Tanh(), nn.Linear(32, count))
    actor = ProbabilisticActor(
        TensorDictModule(policy, ["observation"], ["logits"]),
        spec=env.action_spec,
        in_keys={"logits": "logits", "mask": "action_mask"},
        distribution_class=MaskedCategorical,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Sequential(nn.Linear(width, 32), nn.Tanh(), nn.Linear(32, 1)), ["observation"])
    advantage = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic)
    advantage.set_keys(steps_to_next_obs=DURATION)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2)
    optim = torch.optim.Adam(loss.parameters(), 1e-3)
    before = [each.detach().clone() for each in loss.parameters()]
    collector = Collector(env, actor, frames_per_batch=32, total_frames=64)
    buffer = ReplayBuffer(storage=LazyTensorStorage(32), sampler=SamplerWithoutReplacement(), batch_size=16)
    for batch in collector:
        assert batch["action_mask"].gather(-1, batch["action"][..., None]).all()
        advantage(batch)
        buffer.extend(batch.reshape(-1))
        for part in buffer:
            losses = loss(part)
            sum(losses[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
            optim.step()
            optim.zero_grad()
    collector.shutdown()
    assert all(each.isfinite().all() for each in loss.parameters())
    assert any(not torch.equal(old, new) for old, new in zip(before, loss.parameters(), strict=True))


def test_advantages_discount_over_the_durations_of_options() -> None:
    env = made(1)
    steps = env.rollout(3, policy=lambda td: td.set("action", td["action_mask"].int().argmax(dim=-1)))
    critic = TensorDictModule(lambda seen: torch.ones(*seen.shape[:-1], 1), ["observation"], ["state_value"])
    advantage = GAE(gamma=GAMMA, lmbda=0.0, value_network=critic, differentiable=False)
    advantage.set_keys(steps_to_next_obs=DURATION)
    found = advantage(steps.clone())["advantage"]
    ends = steps["next", "terminated"]
    expected = steps["next", "reward"] + torch.where(ends, 0.0, GAMMA ** steps[DURATION].float()) - 1
    torch.testing.assert_close(found, expected)


def test_other_numbers_and_tasks_are_refused() -> None:
    with pytest.raises(ConfigError, match="gamma=2"):
        make_option_env(options_of("sort", QUICK), 2, gamma=2.0)
    with pytest.raises(ConfigError, match="observation='none' is not allowed"):
        make_option_env(options_of("sort", QUICK), 2, observation="none")
