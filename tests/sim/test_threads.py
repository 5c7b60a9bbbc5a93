"""Threads that roll physics out are those of the process that uses them."""

from __future__ import annotations

import os
import select
import signal

import numpy as np

from hrl_comfort.composition.compose import compose
from hrl_comfort.files.run_config import environment
from hrl_comfort.sim.engine import Engine


def test_a_forked_process_steps_with_threads_of_its_own() -> None:
    config = environment(compose("train", ["task=reach", "human=none", "engine.threads=2"]))
    engine, action = Engine(config, 4, seed=0), np.zeros((4, 6))
    engine.reset()
    engine.step(action)
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.write(write, engine.step(action).state.joint_pos.numpy().tobytes())
        engine.close()
        os._exit(0)
    os.close(write)
    ready = select.select([read], [], [], 180.0)[0]
    if not ready:
        os.kill(child, signal.SIGKILL)
    assert ready and os.waitpid(child, 0)[1] == 0
    expected = engine.step(action).state.joint_pos.numpy()
    found = np.frombuffer(os.read(read, 10**6), dtype=expected.dtype)
    np.testing.assert_array_equal(found.reshape(expected.shape), expected)
    os.close(read)
    engine.close()
