"""A subtask and a comfort form of one's own: `python examples/own_task.py`.

`hrl-comfort train task=own_task:HOVER comfort=conditioned comfort.form=own_task:hinge` trains it in this folder.
"""

import torch

import hrl_comfort
from hrl_comfort.tasks.standard import standard_subtask
from hrl_comfort.tasks.subtask import ObjectAt, Stage, tool_distance


def above(state):
    """Return the point (N, 3) 20 cm above the object, m."""
    return state.target_object + torch.tensor([0.0, 0.0, 0.2], dtype=state.target_object.dtype)


def done(state):
    """Return (N,) bool: the tool is within its tolerance of the point."""
    return tool_distance(above)(state) < state.grasp_tolerance


def hinge(distance, theta, config):
    """Return the distance term (N,) of the comfort reward: a cost nearer than theta, nothing beyond."""
    return -(theta - distance).clamp(min=0) / config.max_m


STAGE = Stage("hover", above, tool_distance(above), done, bonus="pick", object=ObjectAt.ARRIVAL)
HOVER = standard_subtask("hover", (STAGE,))

if __name__ == "__main__":
    choices = {"comfort": "conditioned", "comfort.form": "own_task:hinge"}
    episodes = hrl_comfort.evaluate("expert", task="own_task:HOVER", episodes=20, levels=[1, 10], **choices)
    print(episodes.groupby("comfort_level")[["success", "steps", "return", "human_distance_mean_m"]].mean())
