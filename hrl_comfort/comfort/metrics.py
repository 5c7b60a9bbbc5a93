"""What is measured of the person's comfort."""

from __future__ import annotations

from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.config import FAR_AWAY_M


def human_distance(tcp_pos: Tensor, human_pos: Tensor) -> Tensor:
    """Return the horizontal distance (...,) m from tool (..., 3) to the human's axis (..., 2).

    The distance of the paper's figures and of its released code.
    """
    return vector_norm(tcp_pos[..., :2] - human_pos, dim=-1)


def present(human_pos: Tensor) -> Tensor:
    """Return (...,) bool: somebody is there, not far away (`human=none`); human_pos (..., 2) m."""
    return human_pos[..., 0] < 0.5 * FAR_AWAY_M
