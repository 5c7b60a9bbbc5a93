"""Common settings: one thread, and the same generated examples and global draws in every run."""

from __future__ import annotations

import gc
import os
import signal

os.environ["OMP_NUM_THREADS"] = "1"

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import settings

from tests.generating import RAN
from tests.studio.browser import CHROMIUM, FLAGS, REASON

torch.set_num_threads(1)
# A shell's background job ignores SIGINT, and so would the commands that tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def same_draws() -> None:
    """Begin each test with the same state of the global generators of torch and numpy.

    Fixtures of a module or of the session are made before that.
    """
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], Path]:
    """Write bytes to a file that no other example has read."""
    folder, number = tmp_path_factory.mktemp("read"), count()

    def write(content: bytes) -> Path:
        for old in folder.iterdir():
            old.unlink()
        file = folder / f"{next(number)}.file"
        file.write_bytes(content)
        return file

    return write


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A running Chromium; skips without one."""
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install -e '.[test]'"
    )
    if CHROMIUM is None:
        pytest.skip(REASON)
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield launched
        launched.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest test, so that no worker is left alone with it at the end."""
    items.sort(key=lambda item: item.name != "test_every_command_of_the_readme_runs")


def pytest_collection_finish() -> None:
    """Leave what is imported out of all garbage collections, and collect seldom: they take a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the number of inputs generated in this process."""
    if RAN:
        refused = f"{RAN['refused']} refused in one line, the others finite"
        terminalreporter.write_line(f"{RAN['generated']} generated inputs: {refused}")
