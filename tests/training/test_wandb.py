"""Weights & Biases gets the rows of metrics.csv, offline too."""

from __future__ import annotations

import time
from pathlib import Path

from hrl_comfort.agents.sac import TERMS
from hrl_comfort.cli import first_checks
from hrl_comfort.cli.main import main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import TrainConfig
from hrl_comfort.training import logger
from hrl_comfort.training.logger import MetricsLog

TIMING = (1.0, 2.0, 3.0)


def metrics_log(folder: Path) -> MetricsLog:
    config = compose("train", ["task=reach", "logger=wandb"])
    assert isinstance(config, TrainConfig)
    return MetricsLog(folder, (), tuple(TERMS), config)


def test_without_the_extra_one_line_names_it(monkeypatch, capsys):
    monkeypatch.setattr(first_checks, "find_spec", lambda name: None)
    assert main(["train", "logger=wandb", "--dry-run"]) == 1
    assert "pip install 'hrl-comfort[wandb]'" in capsys.readouterr().err


def test_a_resumed_training_goes_on_in_its_run_with_the_rows_of_the_log(tmp_path, monkeypatch):
    rows, ids = [], []

    class Run:
        def log(self, scalars, step):
            rows.extend((name, value, step) for name, value in scalars.items())

        def finish(self):
            pass

    def begin(folder, run_id, config):
        ids.append(run_id)
        assert config["task"]["name"] == "reach"
        return Run()

    monkeypatch.setattr(logger, "wandb_run", begin)
    log = metrics_log(tmp_path)
    log.start(0)
    log.update(dict.fromkeys(TERMS, 0.5))
    log.write_row(100, "", 1, 0.1, TIMING)
    log.close()
    again = metrics_log(tmp_path)
    again.load_state_dict(log.state_dict())
    again.start(100)
    again.close()
    assert ids == [ids[0]] * 2 and metrics_log(tmp_path)._run_id != ids[0]
    assert ("precision_m", 0.1, 100) in rows and ("entropy", 0.5, 100) in rows


def test_an_offline_run_is_written_to_the_run_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    log = metrics_log(tmp_path)
    log.start(0)
    log.update(dict.fromkeys(TERMS, 0.5))
    log.write_row(100, "", 1, 0.1, TIMING)
    log.close()
    (file,) = tmp_path.glob("wandb/offline-run-*/run-*.wandb")
    assert log.state_dict()["run_id"] in file.name
    deadline = time.monotonic() + 180
    while b"precision_m" not in file.read_bytes():  # wandb's own process writes it, after the end of the run too
        assert time.monotonic() < deadline
        time.sleep(0.05)
