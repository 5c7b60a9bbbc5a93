"""Several learners whose updates are one: every product is batched over the policies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor, nn

from hrl_comfort.agents.networks import LOG_STD_MAX, LOG_STD_MIN, narrow, tanh_gaussian
from hrl_comfort.agents.sac import Batch, Sac, TrainingDiverged, products, sac_losses, terms_of

OWN = ("gamma", "entropy_coefficient", "successor", "cells_apart")
"""What learners may differ in by configuration; of the rest see `kind`."""


class Together:
    """P learners of one kind.

    Their parameters, targets, means and Adam's moments become views of stacked tensors (P, ...), which the
    update works on. So each remains a learner of its own: it acts, remembers, is saved and goes on alone as
    if it had never been one of several; only the order of summation within products is another.

    Raises:
        ValueError: they are of several kinds, or guided.
    """

    def __init__(self, learners: Sequence[Sac]) -> None:
        if len({kind(one) for one in learners}) > 1 or learners[0].config.guide is not None:
            raise ValueError("learners of several kinds, or with a guide, cannot be updated as one")
        self.learners = learners
        self._config = learners[0].config
        self._actor = StackedActor(_stacked(one.actor for one in learners))
        self._critics = StackedCritics(_stacked(one.critics for one in learners))
        self._targets = StackedCritics(_stacked(one.targets for one in learners))
        self._average = _stacked(one.average for one in learners)
        self._log_alpha = _stack([one.log_alpha for one in learners])
        self._parameters = [*self._actor.parameters, *self._critics.parameters, self._log_alpha]
        self.optimiser = torch.optim.Adam(
            [each.requires_grad_() for each in self._parameters], lr=self._config.learning_rate, fused=True
        )
        self._steps = []
        """Adam's counts of steps: of a stack, and those (P,) of the learners, which follow it."""
        for index, parameter in enumerate(self._parameters):
            state, counts = _moments([one.optimiser for one in learners], index)
            self.optimiser.state[parameter] = state
            self._steps.append((state["step"], counts))

    def update(self) -> list[dict[str, float]]:
        """Do one gradient step on every policy; return the `TERMS` of each.

        Raises:
            Diverged: a term of some policy is not finite; all learners are left as they were.
        """
        with products(self._config.products):
            return self._update()

    def _update(self) -> list[dict[str, float]]:
        generators = [one.generator.get_state() for one in self.learners]
        drawn = [one.draw() for one in self.learners]
        batches, _, noise, next_noise = zip(*drawn, strict=True)
        names = [each.name for each in fields(Batch)]
        batch = Batch(**{name: torch.stack([getattr(each, name) for each in batches]) for name in names})
        losses = sac_losses(
            batch,
            self._actor,
            self._critics,
            self._targets,
            self._log_alpha,
            self._config.target_entropy,
            torch.stack(noise),
            torch.stack(next_noise),
        )
        terms = []
        for one, values in zip(self.learners, terms_of(losses, self._log_alpha).T.tolist(), strict=True):
            try:
                terms.append(one.checked(values))
            except TrainingDiverged as error:
                for each, state in zip(self.learners, generators, strict=True):
                    each.generator.set_state(state)
                raise Diverged(one, str(error)) from error
        self.optimiser.zero_grad(set_to_none=True)
        critic_loss, actor_loss, alpha_loss, *_ = losses
        loss = critic_loss
        if self.learners[0].updates >= self._config.critic_first_updates:
            loss = loss + actor_loss + alpha_loss
        loss.sum().backward()  # no policy's loss has a gradient in another's parameters
        self.optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(self._targets.parameters, self._critics.parameters, self._config.tau)
            torch._foreach_lerp_(self._average, self._actor.parameters, self._config.actor_tau)
            for count, counts in self._steps:
                counts.copy_(count)
        for one in self.learners:
            one.updates += 1
        return terms


class Diverged(TrainingDiverged):
    """One of the policies has diverged; the others can go on without its learner."""

    def __init__(self, learner: Sac, message: str) -> None:
        super().__init__(message)
        self.learner = learner


@dataclass(frozen=True)
class StackedActor:
    """P actors as one: weights (P, out, in) and biases (P, out), by turns."""

    parameters: list[Tensor]

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions (P, B, A) and their log-probability (P, B) of observations (P, B, D)."""
        layers = [*zip(self.parameters[::2], self.parameters[1::2], strict=True)]
        x = observation
        for weight, bias in layers[:-1]:
            x = torch.baddbmm(bias[:, None], x, weight.mT).relu_()
        weight, bias = layers[-1]
        mean, log_std = torch.baddbmm(bias[:, None], x, weight.mT).chunk(2, dim=-1)
        return tanh_gaussian(mean, log_std.clamp(LOG_STD_MIN, LOG_STD_MAX), noise)


@dataclass(frozen=True)
class StackedCritics:
    """P twin critics as one: weights (P, 2, in, out) of all layers, then biases (P, 2, 1, out)."""

    parameters: list[Tensor]

    def __call__(self, observation: Tensor, action: Tensor, frozen: bool = False) -> Tensor:
        """Return Q (2, P, B) of observations (P, B, D); `frozen` keeps gradients off the weights."""
        flat = [each.flatten(0, 1) for each in self.parameters]
        flat = [each.detach() for each in flat] if frozen else flat
        *layers, last = zip(flat[: len(flat) // 2], flat[len(flat) // 2 :], strict=True)
        x = torch.cat([observation, action], dim=-1).repeat_interleave(2, dim=0)
        for weight, bias in layers:
            x = torch.baddbmm(bias, x, weight).relu_()
        return narrow(x, *last).unflatten(0, (-1, 2)).transpose(0, 1)


def kind(learner: Sac) -> tuple[object, ...]:
    """Return what learners have to have in common to be updated as one."""
    settings = {name: value for name, value in vars(learner.config).items() if name not in OWN}
    return learner.observation_dim, learner.action_dim, learner.updates, str(settings)


def _stacked(networks: Iterable[nn.Module]) -> list[Tensor]:
    """Return the parameters of P networks stacked (P, ...), in their order; the networks become views."""
    return [_stack(each) for each in zip(*(one.parameters() for one in networks), strict=True)]


def _stack(tensors: Sequence[Tensor]) -> Tensor:
    """Return P tensors stacked (P, ...), of which they become views."""
    stack = torch.stack([each.detach() for each in tensors])
    for each, view in zip(tensors, stack, strict=True):
        each.data = view
    return stack


def _moments(optimisers: Sequence[torch.optim.Adam], index: int) -> tuple[dict[str, Tensor], Tensor]:
    """Return Adam's state of the parameters `index` of P optimisers as one (P, ...), and their counts (P,).

    The states of the optimisers become views of these.
    """
    states = []
    for one in optimisers:
        parameter = one.param_groups[0]["params"][index]
        state = one.state[parameter]
        if not state:  # no step has been made
            state["step"] = torch.zeros((), device=parameter.device)
            state |= {name: torch.zeros_like(parameter) for name in ("exp_avg", "exp_avg_sq")}
        states.append(state)
    counts = _stack([state["step"] for state in states])
    moments = {name: _stack([state[name] for state in states]) for name in ("exp_avg", "exp_avg_sq")}
    return {"step": counts[0].clone(), **moments}, counts
