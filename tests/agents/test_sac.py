"""The learner against TorchRL's own loss, and its bookkeeping."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from hrl_comfort.agents.networks import NORMALISED_LIMIT, Actor, Normaliser
from hrl_comfort.agents.sac import SAC, TERMS, TrainingDiverged
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import AgentConfig, ConfigError

D, A = 7, 3


def agent(**changes: object) -> AgentConfig:
    small = {"batch_size": 16, "buffer_size": 64, "hidden": [16, 16], "learning_starts": 0}
    return replace(compose("train").agent, **{**small, **changes})


def transitions(
    observation: Tensor, action: Tensor, reward: Tensor, after: Tensor, terminated: Tensor, steps: Tensor,
    demonstrated: Tensor | None = None,
) -> TensorDict:  # fmt: skip
    """Return transitions (F,) as the collector of a skill gives them."""
    rows = len(observation)
    then = {"observation": after, "reward": reward[:, None], "terminated": terminated[:, None]}
    now = {"observation": observation, "action": action, "steps_to_next_obs": steps[:, None], "next": then}
    now["demonstrated"] = torch.zeros(rows, dtype=torch.bool) if demonstrated is None else demonstrated
    return TensorDict(now, batch_size=[rows])


def filled(learner: SAC, rows: int = 40, reward: float | None = None) -> SAC:
    learner.observe(
        transitions(
            torch.randn(rows, D),
            torch.rand(rows, A) * 2 - 1,
            torch.randn(rows) if reward is None else torch.full((rows,), reward),
            torch.randn(rows, D),
            torch.rand(rows) < 0.2,
            torch.randint(1, 6, (rows,)),
        )
    )
    return learner


def trained(learner: SAC) -> list[torch.Tensor]:
    return [parameter for group in learner.optimiser.param_groups for parameter in group["params"]]


def beside_a_valley(bc_weight: float) -> float:
    """Return the final action of an actor that begins at -0.9; -1 is worth 1, +1 is worth 2, between is little.

    One action in eight is a demonstrator's, at +1; the others are uniform, so the critics know the valley.
    """
    torch.manual_seed(0)
    learner = SAC(
        agent(
            bc_weight=bc_weight,
            learning_rate=3e-3,
            entropy_coefficient=1e-3,
            target_entropy=-4.0,
            critic_warmup_updates=300,
            buffer_size=2048,
            batch_size=64,
        ),
        D,
        1,
    )
    with torch.no_grad():
        learner.actor.body[-1].weight.mul_(0.1)
        learner.actor.body[-1].bias.copy_(torch.tensor([-1.5, -2.0]))
    demonstrated = torch.arange(16) < 2
    for _ in range(600):
        observation = torch.randn(16, D)
        action = torch.rand(16, 1) * 2 - 1
        action[demonstrated] = 1.0
        reward = torch.maximum(1 - 2 * (action + 1), 2 - 2 * (1 - action))[:, 0]
        over = torch.ones(16, dtype=torch.bool)
        learner.observe(transitions(observation, action, reward, observation, over, torch.ones(16), demonstrated))
        if len(learner.buffer) >= 64:
            learner.update()
    return float(learner.actor.mode(learner.normaliser(torch.randn(64, D))).detach().mean())


def test_a_demonstrator_leads_the_actor_across_a_valley_that_gradients_do_not():
    assert beside_a_valley(bc_weight=0.0) < -0.5
    assert beside_a_valley(bc_weight=10.0) > 0.5


def test_update_moves_every_parameter_and_targets_follow_by_tau():
    learner = filled(SAC(agent(tau=0.25), D, A))
    before = [p.detach().clone() for p in trained(learner)]
    targets = [p.clone() for p in learner.targets.parameters()]
    terms = learner.update()
    assert list(terms) == list(TERMS)
    assert all(not torch.equal(p, q) for p, q in zip(trained(learner), before, strict=True))
    for old, new, critic in zip(targets, learner.targets.parameters(), learner.critics.parameters(), strict=True):
        torch.testing.assert_close(new, old + 0.25 * (critic - old))
        assert not new.requires_grad, "a graph of every update so far would pile up"


def test_a_broken_term_stops_before_the_parameters_change():
    learner = filled(SAC(agent(), D, A), reward=math.nan)
    before = [p.detach().clone() for p in trained(learner)]
    with pytest.raises(TrainingDiverged, match=r"update 0: critic_loss is nan"):
        learner.update()
    assert all(torch.equal(p, q) for p, q in zip(trained(learner), before, strict=True))


def test_a_broken_parameter_is_never_saved():
    learner = SAC(agent(), D, A)
    learner.critics.weights[1].data[0, 0, 0] = math.inf
    with pytest.raises(TrainingDiverged, match=r"critics weights\.1 is not finite"):
        learner.state_dict()


def test_a_loaded_learner_goes_on_bit_for_bit_even_after_the_buffer_wrapped():
    learner = SAC(agent(), D, A)
    for _ in range(3):
        filled(learner)
        learner.update()
    state, rng = learner.state_dict(), torch.get_rng_state()
    state = {**state, "networks": learner.networks_state()}
    state = torch.utils._pytree.tree_map(lambda x: x.clone() if isinstance(x, torch.Tensor) else x, state)

    def go_on(one: SAC) -> list[dict[str, float]]:
        torch.set_rng_state(rng)
        return [filled(one, 10).update() for _ in range(5)]

    other = SAC(agent(), D, A)
    other.load_state_dict(state)
    assert len(other.buffer) == 64
    assert go_on(other) == go_on(learner)


def test_normaliser_equals_the_statistics_of_everything_seen():
    data = torch.randn(100, D) * torch.linspace(0.1, 50, D) + 3
    normaliser = Normaliser(D)
    for part in data.split(30):
        normaliser.update(part)
    torch.testing.assert_close(normaliser.mean, data.double().mean(0))
    torch.testing.assert_close(normaliser.variance, data.double().var(0, correction=0))
    scaled = normaliser(data)
    torch.testing.assert_close(scaled.mean(0), torch.zeros(D), rtol=0, atol=1e-5)
    torch.testing.assert_close(scaled.std(0, correction=0), torch.ones(D), rtol=0, atol=1e-4)


def test_normaliser_bounds_outliers_and_leaves_a_constant_feature_at_zero():
    normaliser = Normaliser(2)
    normaliser.update(torch.stack([torch.randn(50), torch.full((50,), 50.0)], dim=1))
    scaled = normaliser(torch.tensor([[1e6, 50.0]]))
    assert scaled.tolist() == [[NORMALISED_LIMIT, 0.0]]


def test_normaliser_off_is_the_identity():
    normaliser = Normaliser(D, enabled=False)
    data = torch.randn(20, D) * 100
    normaliser.update(data)
    assert torch.equal(normaliser(data), data)


def test_log_probability_stays_finite_for_saturated_actions():
    actor = Actor(D, A, [8])
    actor.body[-1].bias.data[:A] = 40.0
    action, log_prob = actor.sample(torch.randn(5, D), torch.randn(5, A))
    assert action.abs().max() <= 1
    assert log_prob.isfinite().all()


@pytest.mark.parametrize("tau", [1.0, 0.25])
def test_a_policy_file_keeps_the_mean_of_actors(tau: float) -> None:
    learner = filled(SAC(agent(ema_rate=tau), D, A))
    mean = [parameter.detach().clone() for parameter in learner.actor.parameters()]
    for _ in range(3):
        learner.update()
        newest = list(learner.actor.parameters())
        mean = [(1 - tau) * old + tau * new.detach() for old, new in zip(mean, newest, strict=True)]
    kept = learner.policy_state()["actor"]
    names = [name for name, _ in learner.actor.named_parameters()]
    for name, expected in zip(names, mean, strict=True):
        torch.testing.assert_close(kept[name], expected)
        assert tau < 1 or torch.equal(kept[name], learner.networks_state()["actor"][name])
    other = SAC(agent(ema_rate=tau), D, A)
    other.load_state_dict(learner.state_dict())
    assert all(torch.equal(kept[name], other.policy_state()["actor"][name]) for name in names)


def test_critics_may_learn_alone_first() -> None:
    learner = filled(SAC(agent(critic_warmup_updates=2), D, A))
    before = {name: value.clone() for name, value in learner.actor.state_dict().items()}
    alpha = learner.log_alpha.detach().clone()
    critic = learner.critics.weights[0].detach().clone()
    for _ in range(2):
        learner.update()
    assert all(torch.equal(value, before[name]) for name, value in learner.actor.state_dict().items())
    assert torch.equal(learner.log_alpha.detach(), alpha)
    assert not torch.equal(learner.critics.weights[0], critic)
    learner.update()
    assert any(not torch.equal(value, before[name]) for name, value in learner.actor.state_dict().items())


def test_a_device_that_is_not_there_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"agent.device=cuda: .* agent.device=cpu"):
        SAC(agent(device="cuda"), D, A)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_cuda_learns_what_the_cpu_learns_and_its_checkpoint_continues_there() -> None:
    finals = []
    for device in ("cpu", "cuda"):
        torch.manual_seed(0)
        learner = filled(SAC(agent(device=device, matmul_precision="highest"), D, A))
        for _ in range(5):
            learner.update()
        finals.append(learner)
    continued = SAC(agent(), D, A)
    continued.load_state_dict(finals[1].state_dict())
    for cpu, cuda in zip(finals[0].actor.parameters(), continued.actor.parameters(), strict=True):
        torch.testing.assert_close(cpu, cuda, rtol=1e-3, atol=1e-4)
    assert finals[1].act(torch.zeros(2, D)).device.type == "cpu"


def test_inner_precision_of_products_holds_for_the_update_alone() -> None:
    seen = []
    learner = filled(SAC(agent(matmul_precision="medium"), D, A))
    learner.normaliser.register_forward_hook(lambda *_: seen.append(torch.get_float32_matmul_precision()))
    learner.update()
    assert seen[0] == "medium" and torch.get_float32_matmul_precision() == "highest"


def test_a_replay_buffer_larger_than_the_memory_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"agent\.buffer_size=100000000 takes 80\d\d GB; this machine has"):
        SAC(agent(buffer_size=10**8), 10_000, A)


@pytest.mark.parametrize(("end", "expected"), [(None, [1e-3] * 5), (2e-4, [1e-3, 8e-4, 6e-4, 4e-4, 2e-4, 2e-4])])
def test_the_learning_rate_falls_linearly_to_its_end(end: float | None, expected: list[float]) -> None:
    budget = {"policy_steps": 24, "learning_starts": 8, "updates_per_policy_step": 0.25}  # 4 updates
    learner = filled(SAC(agent(learning_rate=1e-3, learning_rate_end=end, **budget), D, A))
    rates = []
    for _ in expected:
        learner.update()
        rates.append(learner.optimiser.param_groups[0]["lr"])
    assert rates == pytest.approx(expected)


def test_critics_with_layer_norm_learn_and_continue_from_a_checkpoint() -> None:
    learner = filled(SAC(agent(critic_layer_norm=True), D, A))
    before = [p.detach().clone() for p in trained(learner)]
    learner.update()
    assert all(not torch.equal(p, q) for p, q in zip(trained(learner), before, strict=True))
    other = SAC(agent(critic_layer_norm=True), D, A)
    other.load_state_dict(learner.state_dict())
    assert learner.update() == other.update()
