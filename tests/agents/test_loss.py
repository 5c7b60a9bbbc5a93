"""The loss module against TorchRL's own."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate, ValueEstimators

from hrl_comfort.agents.loss import TwinSACLoss

B, D, A = 32, 7, 3
pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")


NORM = ("norm_class", "norm_kwargs")


def loss_of(kind: type[SACLoss], seed: int = 0, distribution: Any = TanhNormal, **options: Any) -> SACLoss:
    torch.manual_seed(seed)
    body = nn.Sequential(MLP(D, 2 * A, num_cells=[16, 16]), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=distribution,
        return_log_prob=True,
    )
    norm = {name: options.pop(name) for name in NORM if name in options}
    critic = ValueOperator(
        MLP(D + A, 1, num_cells=[16, 16], activation_class=nn.ReLU, **norm),
        in_keys=options.pop("in_keys", ["observation", "action"]),
    )
    chosen = {"loss_function": "l2", "target_entropy": -float(A), "alpha_init": 0.3, **options}
    loss = kind(actor, critic, **chosen)
    loss.make_value_estimator(gamma=0.97)
    return loss


def batch(steps: bool = False) -> TensorDict:
    torch.manual_seed(1)
    ended = torch.rand(B, 1) < 0.3
    after = {
        "observation": torch.randn(B, D),
        "reward": torch.randn(B, 1),
        "terminated": ended,
        "done": ended,
    }
    data: dict[str, Any] = {
        "observation": torch.randn(B, D),
        "action": torch.rand(B, A) * 2 - 1,
        "next": after,
    }
    if steps:
        data["steps_to_next_obs"] = torch.randint(1, 6, (B, 1))
    return TensorDict(data, batch_size=[B])


def moved_apart(loss: SACLoss) -> SACLoss:
    """Let the targets differ from the critics."""
    with torch.no_grad():
        for tensor in loss.target_qvalue_network_params.flatten_keys().values():
            tensor.mul_(0.9)
    return loss


@pytest.mark.parametrize(("steps", "options"), [(False, {}), (True, {}), (False, {"max_alpha": 0.1})])
def test_values_and_gradients_are_those_of_torchrl_at_the_same_seed(steps: bool, options: dict[str, Any]) -> None:
    theirs, ours = (moved_apart(loss_of(kind, **options)) for kind in (SACLoss, TwinSACLoss))
    results = []
    for loss in (theirs, ours):
        torch.manual_seed(2)
        out = loss(batch(steps))
        (out["loss_actor"] + out["loss_qvalue"] + out["loss_alpha"]).backward()
        results.append((out, {name: p.grad for name, p in loss.named_parameters() if p.grad is not None}))
    (their_out, their_grads), (our_out, our_grads) = results
    names = ("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy")
    assert {*our_out.keys()} == {*their_out.keys()} == {*names}
    for name in names:
        torch.testing.assert_close(our_out[name], their_out[name], rtol=1e-5, atol=1e-5)
    assert our_grads.keys() == their_grads.keys() and len(our_grads) > 10
    for name, gradient in their_grads.items():
        torch.testing.assert_close(our_grads[name], gradient, rtol=1e-4, atol=1e-6)


def test_checkpoint_goes_from_one_to_the_other() -> None:
    theirs, ours = loss_of(SACLoss, seed=3), loss_of(TwinSACLoss, seed=4)
    ours.load_state_dict(theirs.state_dict())
    theirs.load_state_dict(ours.state_dict())
    values = []
    for loss in (theirs, ours):
        torch.manual_seed(2)
        values.append(loss(batch())["loss_qvalue"])
    torch.testing.assert_close(*values, rtol=1e-5, atol=1e-6)


def test_same_training_as_with_torchrls_loss() -> None:
    finals = []
    for kind in (SACLoss, TwinSACLoss):
        loss = loss_of(kind)
        target = SoftUpdate(loss, tau=0.1)
        optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
        torch.manual_seed(5)
        for _ in range(10):
            out = loss(batch())
            optimiser.zero_grad()
            (out["loss_actor"] + out["loss_qvalue"] + out["loss_alpha"]).backward()
            optimiser.step()
            target.step()
        finals.append(torch.cat([p.detach().flatten() for p in loss.parameters()]))
    torch.testing.assert_close(*finals, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"loss_function": "smooth_l1"}, "loss_function=l2"),
        ({"num_qvalue_nets": 3}, "num_qvalue_nets=2"),
        ({"reduction": "sum"}, "reduction=mean"),
        ({"delay_actor": True}, "delay_actor=False"),
        ({"distribution": torch.distributions.Normal}, "actor_network=one module and TanhNormal"),
        ({"norm_class": nn.LayerNorm, "norm_kwargs": {"normalized_shape": 16}}, "qvalue_network=an nn.Seq"),
        ({"in_keys": ["action", "observation"]}, "qvalue_network.in_keys=what the actor sees"),
    ],
)
def test_what_it_does_not_take_is_refused_by_name(options: dict[str, Any], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        loss_of(TwinSACLoss, **options)


def test_prioritised_weights_are_refused() -> None:
    weighted = batch().set("priority_weight", torch.rand(B))
    with pytest.raises(ValueError, match="prioritised"):
        loss_of(TwinSACLoss)(weighted)


def test_targets_other_than_td0_are_refused() -> None:
    loss = loss_of(TwinSACLoss)
    loss.make_value_estimator(ValueEstimators.TDLambda, gamma=0.97, lmbda=0.9)
    with pytest.raises(ValueError, match="TD0"):
        loss(batch())
