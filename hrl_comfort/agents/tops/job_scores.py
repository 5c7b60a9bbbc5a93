"""A network that scores every job alike: what it learns of one holds for all.

It is a deep set (Zaheer et al. 2017, arXiv:1703.06114).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import linear
from torchrl.modules import MLP

from hrl_comfort.config import ConfigError
from hrl_comfort.config.hierarchy import OBSERVED

SINGLE, LAST = 2, 2
"""Options without a job: place and return at each level, wait and retreat at the end."""


class JobScores(nn.Module):
    """Scores (N, K) of options from observations (N, C + B J): C numbers of all, and J of each of B jobs.

    The options are, for each of the levels that they may be given, a pick of each job, place and return, then at last
    wait and retreat (`hierarchy.sort`). A pick is scored from an embedding of its job and from the mean and the
    greatest of the embeddings of all, the others from these two and from the C numbers. Jobs in another order have the
    same scores, in that order.

    Args:
      observation_dim: C + B J.
      options: K.
      hidden: widths; the first is that of the embeddings.
      layout: of the observation, one of META_OBSERVATIONS.

    Raises:
      ConfigError: the observation or the options have another form.
    """

    def __init__(self, observation_dim: int, options: int, hidden: Sequence[int], layout: str) -> None:
        super().__init__()
        self._common, self._each = OBSERVED[layout]
        self._jobs, odd = divmod(observation_dim - self._common, self._each)
        self._levels, rest = divmod(options - LAST, self._jobs + SINGLE)
        if odd or rest or self._jobs < 1 or self._levels < 1:
            raise ConfigError(
                f"meta_controller_agent.network=shared is for jobs; here there are {options} options and "
                f"{observation_dim} observations: choose flat"
            )
        width, further = hidden[0], list(hidden[1:])
        made = {"num_cells": further, "activation_class": nn.ReLU}
        self.embed = nn.Sequential(nn.Linear(self._common + self._each, width), nn.ReLU())
        self.pick = MLP(3 * width, self._levels, **made)
        self.single = MLP(2 * width + self._common, SINGLE * self._levels + LAST, **made)

    def forward(self, observation: Tensor) -> Tensor:
        """Return the scores (…, K)."""
        common, jobs = observation.split([self._common, self._jobs * self._each], dim=-1)
        jobs = jobs.unflatten(-1, (self._jobs, self._each))
        embed, (first, *further) = self.embed[0], self.pick
        assert isinstance(embed, nn.Linear) and isinstance(first, nn.Linear)
        for_common, for_job = embed.weight.split([self._common, self._each], dim=1)
        of_job = _linear_of_parts(jobs, for_job, common, for_common, embed.bias).relu()
        of_all = torch.cat([of_job.mean(dim=-2), of_job.amax(dim=-2)], dim=-1)
        for_job, for_all = first.weight.split([of_job.shape[-1], of_all.shape[-1]], dim=1)
        picks = _linear_of_parts(of_job, for_job, of_all, for_all, first.bias)
        for layer in further:
            picks = layer(picks)
        single, last = self.single(torch.cat([of_all, common], dim=-1)).split([SINGLE * self._levels, LAST], dim=-1)
        by_level = torch.cat([picks.movedim(-1, -2), single.unflatten(-1, (self._levels, SINGLE))], dim=-1)
        return torch.cat([by_level.flatten(-2), last], dim=-1)


def _linear_of_parts(jobs: Tensor, for_job: Tensor, common: Tensor, for_common: Tensor, bias: Tensor) -> Tensor:
    """Return a linear layer (…, B, H) of each job's numbers (…, B, J) with those of all (…, C), which are not repeated.

    Its weights are `for_job` (H, J) and `for_common` (H, C).
    """
    return linear(jobs, for_job) + linear(common, for_common, bias)[..., None, :]
