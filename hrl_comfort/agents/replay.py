"""A replay buffer as plain data, and back."""

from typing import Any

from tensordict import TensorDict
from torchrl.data import TensorDictReplayBuffer


def replay_state(buffer: TensorDictReplayBuffer) -> dict[str, Any]:
    """Return the filled part of a buffer and where it is written next."""
    size = len(buffer)
    return {
        "buffer": buffer.storage[:size].to_dict() if size else {},
        "buffer_cursor": int(buffer.writer.state_dict()["_cursor"]),
    }


def load_replay(buffer: TensorDictReplayBuffer, state: dict[str, Any]) -> None:
    """Fill a buffer that has stored nothing yet from `replay_state`."""
    if state["buffer"]:
        buffer.extend(TensorDict.from_dict(state["buffer"], auto_batch_size=True, batch_dims=1))
        buffer.writer.load_state_dict({"_cursor": state["buffer_cursor"]})
