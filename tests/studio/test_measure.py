"""The benchmark of the live view: every row is there, measured over moments."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.files.tables import read_table

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.studio import measure


def test_a_viewer_is_counted_and_a_key_reaches_the_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, few in {"MEASURED_S": 0.5, "SETTLE_S": 0.2, "PRESSES": 1, "first_sight": list}.items():
        monkeypatch.setattr(measure, name, few)
    config = compose("studio", ["task=cycle", "policy=expert", "human=still", "episodes=1", f"output={tmp_path}"])
    assert isinstance(config, StudioConfig)
    table = read_table(measure.bench_studio(config))
    assert table is not None
    measured = dict(zip(table["what"], table["measured"], strict=True))
    assert float(measured["frames/s at a viewer"]) > 0
    assert float(measured["share of one core, %"]) > 0
    assert next(value for what, value in measured.items() if what.endswith("errors")) == "0"
    hand_ms = float(measured["from hand to the policy's action, ms, median (most)"].split()[0])
    assert 0 < hand_ms < 1000 * measure.PATIENCE_S
    assert int(measured["from hand to the policy's observation, decisions, median (most)"].split()[0]) >= 1


def test_what_trainings_need_alone_is_not_imported_before_the_first_picture() -> None:
    code = (
        "import sys, hrl_comfort.studio.server; hrl_comfort.load_policy('runs/reference/pick');"
        "print(*sorted({'torchrl', 'tensordict', 'torch._dynamo', 'scipy.stats', 'matplotlib'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_a_replay_is_not_measured() -> None:
    config = compose("studio", ["replay=runs/nowhere"])
    assert isinstance(config, StudioConfig)
    with pytest.raises(ConfigError, match="a live studio is measured"):
        measure.bench_studio(config)
