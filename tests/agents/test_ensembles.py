"""Losses of TQC, REDQ and CrossQ against TorchRL's own, in values and gradients."""

from __future__ import annotations

import math
from copy import deepcopy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import CrossQLoss as TorchRLCrossQ
from torchrl.objectives import LossModule, REDQLoss, TQCLoss

from hrl_comfort.agents.crossq import CrossQ, NormalisedCritics
from hrl_comfort.agents.learners import SKILLS
from hrl_comfort.agents.loss import ActorCriticLoss
from hrl_comfort.agents.networks import Critics
from hrl_comfort.agents.sac import SAC
from tests.agents.test_loss import GAMMA, LOSSES, A, B, Critic, D, batch
from tests.agents.test_sac import agent, filled

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
CLOSE = {"rtol": 1e-4, "atol": 1e-5}


class Single(nn.Module):
    """A critic alone, of stacked ones: a copy of them of which one speaks."""

    def __init__(self, critics: NormalisedCritics, which: int) -> None:
        super().__init__()
        self.norms = nn.ModuleList()
        self.layers = nn.ModuleList()
        for weight, bias, scale, shift in zip(
            critics.weights, critics.biases, critics.scales, critics.shifts, strict=True
        ):
            norm = nn.BatchNorm1d(weight.shape[1], eps=1e-5, momentum=critics.momentum)
            norm.weight.data.copy_(scale[which, 0])
            norm.bias.data.copy_(shift[which, 0])
            linear = nn.Linear(*weight.shape[1:])
            linear.weight.data.copy_(weight[which].T)
            linear.bias.data.copy_(bias[which, 0])
            self.norms.append(norm)
            self.layers.append(linear)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        x = torch.cat([observation, action], dim=-1)
        for index, (norm, layer) in enumerate(zip(self.norms, self.layers, strict=True)):
            x = layer(norm(x.relu() if index else x))
        return x


def learner(name: str, **own: object) -> SAC:
    torch.manual_seed(0)
    made = SKILLS[name](agent(name=name, own=own, gamma=GAMMA, critic_layer_norm=False), D, A)
    if made.targets is not None:  # differ from the critics
        for parameter in made.targets.parameters():
            parameter.data.add_(0.1 * torch.randn_like(parameter))
    return made


def torchrl(kind: type[LossModule], ours: ActorCriticLoss, critics: list[nn.Module], **more: object) -> LossModule:
    """Return TorchRL's loss of the same actor and of these critics."""
    policy = ProbabilisticActor(
        TensorDictModule(deepcopy(ours.actor_network), in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True,
    )  # fmt: skip
    keys = {"in_keys": ["observation", "action"], "out_keys": ["state_action_value"]}
    loss = kind(
        policy, [TensorDictModule(critic, **keys) for critic in critics], num_qvalue_nets=len(critics),
        alpha_init=math.exp(ours.log_alpha.item()), target_entropy=ours.target_entropy, **more,
    )  # fmt: skip
    loss.make_value_estimator(gamma=GAMMA)
    if hasattr(ours, "target_qvalue_network"):
        for i in range(len(critics)):
            wanted = Critic(ours.target_qvalue_network, i).state_dict()
            for key, value in loss.target_qvalue_network_params.flatten_keys(".").items():
                value.data[i].copy_(wanted[key.removeprefix("module.")])
    return loss


def found(loss: LossModule, data: TensorDict) -> TensorDict:
    out = loss(data)
    sum(out[name].mean() for name in LOSSES).backward()
    return out


def same_gradients(critics: Critics, theirs: LossModule, scale: float = 1.0) -> None:
    expected = dict(theirs.qvalue_network_params.flatten_keys(".").items())
    for i, (weight, bias) in enumerate(zip(critics.weights, critics.biases, strict=True)):
        layer = f"module.body.{2 * i}"
        torch.testing.assert_close(weight.grad.mT * scale, expected[f"{layer}.weight"].grad, **CLOSE)
        torch.testing.assert_close(bias.grad[:, 0] * scale, expected[f"{layer}.bias"].grad, **CLOSE)


def test_tqc_is_torchrls() -> None:
    ours = learner("tqc", critics=3, quantiles=7, dropped=2).loss
    singles = [Critic(ours.qvalue_network, i) for i in range(3)]
    theirs = torchrl(TQCLoss, ours, singles, top_quantiles_to_drop_per_net=2)
    outs = [found(loss, batch()) for loss in (ours, theirs)]  # `batch` seeds
    for name in LOSSES:
        torch.testing.assert_close(outs[0][name], outs[1][name], **CLOSE)
    same_gradients(ours.qvalue_network, theirs)


def test_redq_is_torchrls() -> None:
    ours = learner("redq", critics=4, subset=2).loss
    singles = [Critic(ours.qvalue_network, i) for i in range(4)]
    theirs = torchrl(REDQLoss, ours, singles, sub_sample_len=2, loss_function="l2", min_alpha=0.01)
    data, state = batch(), torch.get_rng_state()
    data["steps_to_next_obs"] = torch.ones(B, 1)  # the only length that TorchRL's loss knows
    expected = found(theirs, data.clone())
    torch.set_rng_state(state)
    torch.randperm(4)
    data["noise"], data["next_noise"] = torch.randn(2, B, A)
    torch.set_rng_state(state)
    ours.generator = None  # the same targets are drawn
    out = found(ours, data)
    torch.testing.assert_close(out["loss_actor"], expected["loss_actor"], **CLOSE)
    torch.testing.assert_close(out["loss_qvalue"] / 4, expected["loss_qvalue"], **CLOSE)
    same_gradients(ours.qvalue_network, theirs, scale=0.25)


def test_crossq_is_torchrls_and_its_statistics_are_those_of_both_halves() -> None:
    made = learner("crossq", critic_hidden=[16, 16], momentum=0.2)
    assert isinstance(made, CrossQ) and made.targets is None
    ours, critics = made.loss, made.critics
    singles = [Single(critics, i) for i in range(2)]
    theirs = torchrl(TorchRLCrossQ, ours, singles, loss_function="l2", deactivate_vmap=True)
    outs = [found(loss, batch()) for loss in (ours, theirs)]  # `batch` seeds
    torch.testing.assert_close(outs[0]["loss_qvalue"], outs[1]["loss_qvalue"], **CLOSE)
    torch.testing.assert_close(outs[0]["loss_actor"], outs[1]["loss_actor"], **CLOSE)
    params = dict(theirs.qvalue_network_params.flatten_keys(".").items())
    for i in range(3):
        torch.testing.assert_close(critics.weights[i].grad.mT, params[f"module.layers.{i}.weight"].grad, **CLOSE)
        torch.testing.assert_close(critics.scales[i].grad[:, 0], params[f"module.norms.{i}.weight"].grad, **CLOSE)
        for mine, name in (("mean", "running_mean"), ("variance", "running_var")):
            running = params[f"module.norms.{i}.{name}"]
            torch.testing.assert_close(critics.get_buffer(f"{mine}_{i}")[:, 0], running, **CLOSE)


def test_after_the_warm_up_a_batch_is_corrected_towards_the_running_statistics() -> None:
    torch.manual_seed(0)
    critics = NormalisedCritics(D, A, [8], momentum=0.5, warmup=0)
    critics.mean_0.fill_(0.5)
    critics.variance_0.fill_(1.5)
    observation, action = torch.randn(64, D), torch.randn(64, A)
    x = torch.cat([observation, action], dim=-1).expand(2, -1, -1)
    expected = (x - 0.5) / math.sqrt(1.5 + 1e-5)
    torch.testing.assert_close(critics._normalised(x, 0, trains=True), expected, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(critics.mean_0, (0.5 + x.mean(1, keepdim=True)) / 2)


def test_redq_draws_its_targets_anew_and_tqc_leaves_out_the_highest() -> None:
    redq = learner("redq", critics=10, subset=2)
    data = batch()
    values = {float(redq.loss.next_value(data["observation"], data["action"]).sum().detach()) for _ in range(20)}
    assert len(values) > 10
    losses = [float(learner("tqc", dropped=dropped).loss(batch())["loss_qvalue"].detach()) for dropped in (0, 24)]
    assert losses[0] != losses[1]


def test_critics_of_many_layers_are_read_back() -> None:
    widths = list(range(2, 14))
    state = NormalisedCritics(3, 2, widths).state_dict()
    again = NormalisedCritics.of_state(3, 2, widths, state)
    again.load_state_dict(state)
    assert again.weights[11].shape[2] == 13


@pytest.mark.parametrize("name", ["crossq", "redq"])
def test_the_actor_is_updated_less_often_than_the_critics(name: str) -> None:
    made = filled(SKILLS[name](agent(name=name, own={"updates_per_actor_update": 3}), D, A))
    changed = []
    for _ in range(6):
        before = made.actor.body[0].weight.detach().clone()
        critic = made.critics.weights[0].detach().clone()
        made.update()
        changed.append(not torch.equal(made.actor.body[0].weight, before))
        assert not torch.equal(made.critics.weights[0], critic)
    assert changed == [True, False, False] * 2
