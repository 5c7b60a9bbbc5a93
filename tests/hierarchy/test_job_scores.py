"""The network that scores every job alike."""

from __future__ import annotations

import pytest
import torch

from hrl_comfort.agents.tops.job_scores import JobScores
from hrl_comfort.config import ConfigError
from hrl_comfort.config.hierarchy import OBSERVED
from hrl_comfort.hierarchy.observation import observation_dim

JOBS = 4


def network(levels: int, layout: str = "jobs") -> JobScores:
    torch.manual_seed(0)
    return JobScores(observation_dim(layout, JOBS), levels * (JOBS + 2) + 2, [16, 16], layout)


@pytest.mark.parametrize("layout", OBSERVED)
@pytest.mark.parametrize("levels", [1, 3])
def test_jobs_in_another_order_have_the_same_scores_in_that_order(levels: int, layout: str) -> None:
    common, each = OBSERVED[layout]
    seen = torch.randn(5, observation_dim(layout, JOBS))
    order = torch.tensor([2, 0, 3, 1])
    moved = torch.cat([seen[:, :common], seen[:, common:].unflatten(1, (JOBS, each))[:, order].flatten(1)], dim=1)
    scores, other = (network(levels, layout)(each) for each in (seen, moved))
    for first in range(0, levels * (JOBS + 2), JOBS + 2):
        picks, single = slice(first, first + JOBS), slice(first + JOBS, first + JOBS + 2)
        torch.testing.assert_close(other[:, picks], scores[:, picks][:, order])
        torch.testing.assert_close(other[:, single], scores[:, single])
    torch.testing.assert_close(other[:, -2:], scores[:, -2:])


def test_a_job_is_scored_by_what_is_observed_of_it_and_of_the_others() -> None:
    common, each = OBSERVED["jobs"]
    seen = torch.randn(1, observation_dim("jobs", JOBS))
    for job in range(JOBS):
        changed = seen.clone()
        changed[:, common + each * job :][:, :each] += 1.0
        gain = (network(1)(changed) - network(1)(seen)).detach()[0, :JOBS].abs()
        assert (gain > 0).all() and gain.unique().numel() == JOBS


def test_a_pick_is_scored_from_its_job_and_from_mean_and_greatest_of_all() -> None:
    common, each = OBSERVED["jobs"]
    seen, net = torch.randn(5, observation_dim("jobs", JOBS)), network(3)
    jobs = seen[:, common:].unflatten(1, (JOBS, each))
    of_job = net.embed(torch.cat([seen[:, None, :common].expand(-1, JOBS, -1), jobs], dim=2))
    of_all = torch.cat([of_job.mean(dim=1), of_job.amax(dim=1)], dim=1)[:, None].expand(-1, JOBS, -1)
    picks = net(seen)[:, :-2].unflatten(1, (3, JOBS + 2))[..., :JOBS]
    torch.testing.assert_close(picks, net.pick(torch.cat([of_job, of_all], dim=2)).movedim(2, 1))


def test_options_of_another_form_are_refused() -> None:
    with pytest.raises(ConfigError, match="network=shared is for jobs; here there are 9 options and 63 observations"):
        JobScores(observation_dim("jobs", JOBS), 9, [16], "jobs")
