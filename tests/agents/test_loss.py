"""The loss module against TorchRL's own."""

from __future__ import annotations

import math
from copy import deepcopy
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import SACLoss, SoftUpdate

from hrl_comfort.agents.loss import ActorCriticLoss, bc_loss
from hrl_comfort.agents.networks import Actor, Critics

B, D, A = 64, 7, 3
GAMMA = 0.98
LOSSES = ("loss_actor", "loss_qvalue", "loss_alpha")
pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")


class Critic(nn.Module):
    """One of the twin critics made of PyTorch's own layers."""

    def __init__(self, twins: Critics, which: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for index, (weight, bias) in enumerate(zip(twins.weights, twins.biases, strict=True)):
            linear = nn.Linear(weight.shape[1], weight.shape[2])
            linear.weight.data.copy_(weight[which].detach().T)
            linear.bias.data.copy_(bias[which, 0].detach())
            layers.append(linear)
            if index < len(twins.weights) - 1:
                layers += [nn.LayerNorm(weight.shape[2], elementwise_affine=False)] * twins.layer_norm + [nn.ReLU()]
        self.body = nn.Sequential(*layers)

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return self.body(torch.cat([observation, action], dim=-1))


def twin_loss(layer_norm: bool = False) -> ActorCriticLoss:
    """Return the module under test; its targets differ from its critics."""
    torch.manual_seed(0)
    critics, targets = (Critics(D, A, [16, 16], layer_norm) for _ in range(2))
    return ActorCriticLoss(Actor(D, A, [16, 16]), critics, targets, GAMMA, -float(A), 0.3)


def torchrl_loss(ours: ActorCriticLoss) -> SACLoss:
    """Return TorchRL's loss of the same networks."""
    policy = ProbabilisticActor(
        TensorDictModule(deepcopy(ours.actor_network), in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    keys = {"in_keys": ["observation", "action"], "out_keys": ["state_action_value"]}
    loss = SACLoss(
        policy,
        [TensorDictModule(Critic(ours.qvalue_network, i), **keys) for i in range(2)],
        loss_function="l2",
        alpha_init=math.exp(ours.log_alpha.item()),
        target_entropy=-float(A),
    )
    loss.make_value_estimator(gamma=GAMMA)
    for i in range(2):
        wanted = Critic(ours.target_qvalue_network, i).state_dict()
        for key, value in loss.target_qvalue_network_params.flatten_keys(".").items():
            value.data[i].copy_(wanted[key.removeprefix("module.")])
    return loss


def batch(seed: int = 1) -> TensorDict:
    torch.manual_seed(seed)
    terminated = torch.rand(B, 1) < 0.3
    return TensorDict(
        {
            "observation": torch.randn(B, D),
            "action": torch.rand(B, A) * 1.8 - 0.9,
            "steps_to_next_obs": torch.randint(1, 6, (B, 1)),
            "next": {
                "observation": torch.randn(B, D),
                "reward": torch.randn(B, 1),
                "terminated": terminated,
                "done": terminated | (torch.rand(B, 1) < 0.3),  # truncated rows must bootstrap
            },
        },
        batch_size=[B],
    )


@pytest.mark.parametrize("layer_norm", [False, True])
def test_values_and_gradients_are_those_of_torchrl_at_the_same_seed(layer_norm: bool) -> None:
    ours = twin_loss(layer_norm)
    theirs = torchrl_loss(ours)
    outs = []
    for loss in (ours, theirs):
        torch.manual_seed(2)
        outs.append(loss(batch()))
        sum(outs[-1][name] for name in LOSSES).backward()
    close = {"rtol": 1e-5, "atol": 1e-5}
    for name in (*LOSSES, "alpha", "entropy"):
        torch.testing.assert_close(outs[0][name], outs[1][name], **close)
    torch.testing.assert_close(ours.log_alpha.grad, theirs.log_alpha.grad, **close)
    expected = {key: value.grad for key, value in theirs.actor_network_params.flatten_keys(".").items()}
    mine = dict(ours.actor_network.named_parameters())
    assert len(expected) == len(mine) == 6
    for key, gradient in expected.items():
        torch.testing.assert_close(mine[key.rsplit("module.", 1)[1]].grad, gradient, **close)
    critics, stride = ours.qvalue_network, 3 if layer_norm else 2
    expected = {key: value.grad for key, value in theirs.qvalue_network_params.flatten_keys(".").items()}
    for i, (weight, bias) in enumerate(zip(critics.weights, critics.biases, strict=True)):
        layer = f"module.body.{stride * i}"
        torch.testing.assert_close(weight.grad.mT, expected.pop(f"{layer}.weight"), **close)
        torch.testing.assert_close(bias.grad[:, 0], expected.pop(f"{layer}.bias"), **close)
    assert not expected


def test_training_is_that_of_torchrls_loss_and_target_updater() -> None:
    ours = twin_loss()
    theirs = torchrl_loss(ours)
    updater = SoftUpdate(theirs, tau=0.1)
    ours.target_qvalue_network.load_state_dict(ours.qvalue_network.state_dict())  # as SoftUpdate begins
    finals = []
    for loss, update_targets in ((theirs, updater.step), (ours, partial(ours.update_targets, 0.1))):
        optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
        for seed in range(10):
            data = batch(seed)
            out = loss(data)
            optimiser.zero_grad()
            sum(out[name] for name in LOSSES).backward()
            optimiser.step()
            update_targets()
        torch.manual_seed(5)
        finals.append(loss(batch()))
    for name in LOSSES:
        torch.testing.assert_close(finals[1][name], finals[0][name], rtol=1e-3, atol=1e-3)


def test_given_noise_is_used() -> None:
    loss, data = twin_loss(), batch()
    torch.manual_seed(3)
    expected = loss(data)
    torch.manual_seed(3)
    data["next_noise"], data["noise"] = torch.randn(B, A), torch.randn(B, A)
    found = loss(data)
    assert all(torch.equal(found[name], expected[name]) for name in loss.out_keys)


class PreferFirst(nn.Module):
    """Critics that value an action by its first number alone."""

    def value(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return action[:, 0]


def test_a_demonstrator_is_imitated_only_where_the_critics_prefer_it() -> None:
    actor = Actor(D, A, [16])
    observation = torch.randn(2, D)
    mode = actor.mode(observation).detach()
    action = mode + torch.tensor([[0.1, 0.2, 0.0], [-0.1, 0.2, 0.0]])
    loss = bc_loss(observation, action, actor, PreferFirst())
    torch.testing.assert_close(loss, torch.tensor(0.1**2 + 0.2**2))
