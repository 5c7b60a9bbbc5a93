"""A TorchRL loss module: `SACLoss` for twin critics of linear layers, without vmap and distributions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from torch import Tensor, nn
from torchrl.modules import TanhNormal
from torchrl.objectives import SACLoss
from torchrl.objectives.value import TD0Estimator

from hrl_comfort.agents.networks import narrow, tanh_gaussian
from hrl_comfort.agents.sac import Batch, sac_losses


class TwinSACLoss(SACLoss):
    """Drop-in for `torchrl.objectives.SACLoss`: same arguments, parameters, checkpoint, values, gradients.

    It draws the same random numbers too, so a seed gives the same training. What makes it faster is that
    both critics are one batched product, and actions are sampled without distribution objects. It takes
    what this project trains, and refuses the rest: a `TanhNormal` actor over [-1, 1], two critics that are
    one `nn.Sequential` of `nn.Linear` and elementwise layers each, `loss_function="l2"`, TD(0) targets,
    transitions of equal weight; it writes no `td_error`.

    Raises:
        ValueError: something else is asked for.
    """

    def __init__(self, *networks: Any, **options: Any) -> None:
        super().__init__(*networks, **options)
        critic = getattr(self.qvalue_network, "module", None)
        plain = (
            isinstance(critic, nn.Sequential)
            and isinstance(critic[-1], nn.Linear)
            and all(
                layer.bias is not None if isinstance(layer, nn.Linear) else not list(layer.parameters())
                for layer in critic
            )
        )
        drawn, seen = self.actor_network[-1], self.actor_network.in_keys
        squashed = drawn.distribution_class is TanhNormal and not drawn.distribution_kwargs
        in_order = list(self.qvalue_network.in_keys) == [*seen, self.tensor_keys.action]
        allowed = {
            "value_network": (self._version == 2, "none"),
            "num_qvalue_nets": (self.num_qvalue_nets == 2, "2"),
            "loss_function": (self.loss_function == "l2", "l2"),
            "reduction": (self.reduction == "mean", "mean"),
            "skip_done_states": (not self.skip_done_states, "False"),
            "delay_actor": (not self.delay_actor, "False"),
            "qvalue_network": (plain, "an nn.Sequential of nn.Linear with bias that ends in one"),
            "qvalue_network.in_keys": (in_order, "what the actor sees, then the action,"),
            "actor_network": (
                squashed and len(self.actor_network) == 2,
                "one module and TanhNormal over [-1, 1]",
            ),
        }
        for name, (fits, value) in allowed.items():
            if not fits:
                raise ValueError(f"TwinSACLoss takes {name}={value} only; SACLoss takes the rest")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return loss_actor, loss_qvalue, loss_alpha, alpha and entropy, all scalars, as SACLoss does.

        tensordict (B,) holds the actor's and critics' `in_keys`, the action, and under `next` the same with
        reward, done and terminated (B, 1); where a transition took several steps, `steps_to_next_obs` (B, 1).
        """
        keys, after = self.tensor_keys, tensordict.get("next")
        alpha = self._alpha  # which keeps log_alpha within its bounds
        estimator = self.value_estimator
        if not isinstance(estimator, TD0Estimator):
            raise ValueError(f"TwinSACLoss takes TD0 targets only, not {type(estimator).__name__}")
        if self._maybe_get_priority_weight(tensordict) is not None:
            raise ValueError("TwinSACLoss takes no prioritised weights; SACLoss does")
        steps = tensordict.get("steps_to_next_obs", None)
        discount = estimator.gamma if steps is None else estimator.gamma**steps
        action = tensordict.get(keys.action)
        batch = Batch(
            observation=self._seen(tensordict),
            action=action,
            reward=after.get(keys.reward)[:, 0],
            next_observation=self._seen(after),
            discount=(discount * ~after.get(keys.terminated))[:, 0],
        )
        next_noise, noise = torch.randn_like(action), torch.randn_like(action)  # in SACLoss's order
        critic_loss, actor_loss, alpha_loss, entropy, _ = sac_losses(
            batch,
            self,
            StackedCritics(self.qvalue_network.module, self.qvalue_network_params),
            StackedCritics(self.qvalue_network.module, self.target_qvalue_network_params),
            self.log_alpha,
            float(self.target_entropy),
            noise,
            next_noise,
        )
        losses = {"loss_actor": actor_loss, "loss_qvalue": critic_loss, "loss_alpha": alpha_loss}
        return TensorDict({**losses, "alpha": alpha, "entropy": entropy}, batch_size=[])

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return the actor's actions (B, A) and their log-probability (B,) for standard normal `noise`."""
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            mean, std = self.actor_network[0].module(observation)
        return tanh_gaussian(mean, std.log(), noise)

    def _seen(self, tensordict: TensorDictBase) -> Tensor:
        return torch.cat([tensordict.get(key) for key in self.actor_network.in_keys], dim=-1)


@dataclass(frozen=True)
class StackedCritics:
    """Twin critics of one architecture, their parameters stacked (2, ...) as SACLoss keeps them."""

    layers: nn.Sequential
    parameters: TensorDictParams

    def __call__(self, observation: Tensor, action: Tensor, frozen: bool = False) -> Tensor:
        """Return Q (2, B) of (B, D) and (B, A); `frozen` keeps gradients off the weights."""
        x = torch.cat([observation, action], dim=-1).expand(2, -1, -1)
        last = len(self.layers) - 1
        for index, layer in enumerate(self.layers):
            if not isinstance(layer, nn.Linear):
                x = layer(x)
                continue
            weight, bias = (self.parameters.get(("module", str(index), name)) for name in ("weight", "bias"))
            if frozen:
                weight, bias = weight.detach(), bias.detach()
            weight, bias = weight.mT, bias[:, None]
            x = narrow(x, weight, bias) if index == last else torch.baddbmm(bias, x, weight)
        return x
