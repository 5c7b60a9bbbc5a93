"""Clone the policy of a data set: `python docs/behaviour_cloning.py DATA CLONE [SEED]`.

DATA is the folder `hrl_comfort/TASK-v0` that `hrl-comfort dataset` wrote, CLONE a file (.pt) for the network. `policy`
acts by the file that the environment variable CLONE names.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

WIDTH, STEPS, BATCH, LEARNING_RATE = 256, 2000, 256, 1e-3


class Clone(torch.nn.Module):
    """Network of two hidden layers from normalised observations (N, D) to actions (N, A) in [-1, 1]."""

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, seen: int, acts: int) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(seen, WIDTH), torch.nn.ReLU(), torch.nn.Linear(WIDTH, WIDTH), torch.nn.ReLU(),
            torch.nn.Linear(WIDTH, acts), torch.nn.Tanh(),
        )  # fmt: skip
        self.register_buffer("mean", torch.zeros(seen))
        self.register_buffer("std", torch.ones(seen))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the actions."""
        return torch.as_tensor(self.layers((observation - self.mean) / self.std))


def clone(data: Path, seed: int = 0) -> Clone:
    """Return a network fitted to the actions of the successful episodes of `data`, by least squares."""
    import minari

    episodes = [*minari.MinariDataset(data / "data").iterate_episodes()]
    won = [each for each in episodes if each.infos["success"][-1]]
    seen = torch.from_numpy(np.concatenate([each.observations[:-1] for each in won]))
    done = torch.from_numpy(np.concatenate([each.actions for each in won]))
    torch.manual_seed(seed)
    network = Clone(seen.shape[1], done.shape[1])
    network.mean, network.std = seen.mean(0), seen.std(0).clamp_min(1e-3)
    optimiser = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    for _ in range(STEPS):
        rows = torch.randint(len(seen), (BATCH,))
        loss = (network(seen[rows]) - done[rows]).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return network


@cache
def _loaded(file: str) -> Clone:
    weights = torch.load(file, weights_only=True)
    network = Clone(len(weights["mean"]), len(weights["layers.4.bias"]))
    network.load_state_dict(weights)
    return network


@torch.no_grad()
def policy(observation: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the actions (N, A) of the file CLONE for observations (N, D)."""
    network = _loaded(os.environ["CLONE"])
    return np.asarray(network(torch.from_numpy(observation).float()).numpy())


if __name__ == "__main__":
    torch.set_num_threads(1)
    torch.save(clone(Path(sys.argv[1]), int((*sys.argv[3:], 0)[0])).state_dict(), sys.argv[2])
