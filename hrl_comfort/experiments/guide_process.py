"""The process of a guide: a configuration comes in, then states; for each, actions (N, 6) go out."""

from __future__ import annotations

import os
import pickle
import sys
import traceback


def main() -> None:
    """Act for the process that started this one, until nothing more comes."""
    asked, told = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else is printed
    import torch

    from hrl_comfort.experiments.guide import acting
    from hrl_comfort.scene.workcell import build_scene
    from hrl_comfort.tasks import State

    torch.set_num_threads(1)
    config = pickle.load(asked)
    act = acting(config, build_scene(config.robot, config.cell, config.engine.substeps, config.task.balls))
    while True:
        try:
            state = pickle.load(asked)
        except EOFError:
            return
        answer: object
        try:
            answer = act(State(**{name: torch.from_numpy(value) for name, value in state.items()})).numpy()
        except Exception as error:  # noqa: BLE001  it is raised where the actions are waited for
            error.add_note(traceback.format_exc())  # tracebacks cannot be sent
            answer = error
        pickle.dump(answer, told)
        told.flush()


if __name__ == "__main__":
    main()
