"""Distance to the human and presence of the human."""

from __future__ import annotations

from torch import Tensor
from torch.linalg import vector_norm

from hrl_comfort.config import FAR_AWAY_M


def human_distance(tcp_pos: Tensor, human_pos: Tensor) -> Tensor:
    """Return the horizontal distance (...,) m from tool (..., 3) to the human's axis (..., 2), as in the paper."""
    return vector_norm(tcp_pos[..., :2] - human_pos, dim=-1)


def present(human_pos: Tensor) -> Tensor:
    """Return (...,) bool: a human is in the cell; human_pos (..., 2) m is far away for `human=none`."""
    return human_pos[..., 0] < 0.5 * FAR_AWAY_M
