"""Sizes that a file or a command line asks for are bounded before they are allocated."""

from __future__ import annotations

import io
import os
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import torch

from hrl_comfort import humans
from hrl_comfort.agents import checkpoint
from hrl_comfort.agents.sac import SAC
from hrl_comfort.cli.main import main
from hrl_comfort.comfort.streams import read_recording
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ComfortConfig, ConfigError, TrainConfig
from hrl_comfort.config.overrides import check_overrides
from hrl_comfort.files.documents import read_json, read_yaml
from hrl_comfort.files.output import output_file
from hrl_comfort.files.run_config import load_config
from hrl_comfort.files.state_file import FORMAT
from hrl_comfort.files.sweep_record import planned
from hrl_comfort.files.tables import GrowingTable, read_table
from hrl_comfort.scene.calibration import read_deltas
from hrl_comfort.sim.starts import recorded

KINDS = ("orange", "pink")
ALIASES = "a: &a [x, x]\nb: [*a, *a]\n"


def zipped(path: Path, name: str, size: int, put: bytes = b"") -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(name, "w") as file:
        file.write(put)
        for _ in range(size // 10**6):
            file.write(bytes(10**6))
    return path


def test_an_archive_is_not_unpacked_beyond_its_bound(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"policy\.pt: cut short .*unpacks to 300 MB"):
        checkpoint.load(zipped(tmp_path / "policy.pt", "archive/data.pkl", 3 * 10**8))
    with pytest.raises(ConfigError, match=r"must hold an array of shape .* for each of orange, pink"):
        recorded(str(zipped(tmp_path / "starts.npz", "orange.npy", 3 * 10**8)), 10, 6, KINDS)


def test_an_array_that_claims_more_than_its_file_holds_is_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 21)}
    np.lib.format.write_array_header_1_0(header, about)
    with pytest.raises(ConfigError, match="must hold an array of shape"):
        recorded(str(zipped(tmp_path / "starts.npz", "orange.npy", 10**6, header.getvalue())), 10, 6, KINDS)


def test_a_table_of_holes_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    table, most = tmp_path / "episodes.csv", 3 * 10**8
    table.write_text("episode,success\n")
    os.truncate(table, most)
    tracemalloc.start()
    with pytest.raises(ConfigError, match=r"line 2: byte 0x00 is not text"):
        read_table(table)
    assert tracemalloc.get_traced_memory()[1] < 1.2 * most
    tracemalloc.stop()


@pytest.mark.parametrize(
    "tensor",
    [
        torch.zeros(1).expand(10**5, 10**5),
        torch.sparse_coo_tensor(torch.zeros(2, 1, dtype=torch.int64), torch.ones(1), (9, 9), check_invariants=True),
        torch.empty(7, device="meta"),
        torch.nested.nested_tensor([torch.zeros(2), torch.zeros(3)]),
    ],
)
def test_a_tensor_without_its_numbers_is_refused(tensor: torch.Tensor, tmp_path: Path) -> None:
    torch.save({"format": FORMAT, "networks": [tensor]}, tmp_path / "policy.pt")
    with pytest.raises(ConfigError, match="its networks 0 is not a dense tensor"):
        checkpoint.load(tmp_path / "policy.pt")


def test_a_table_that_unpacks_to_more_than_memory_holds_is_refused(tmp_path: Path) -> None:
    zeros = pa.array(np.zeros(3 * 10**7, dtype=np.int8))
    pa.parquet.write_table(pa.table({"episode": zeros, "success": zeros}), tmp_path / "episodes.parquet")
    with pytest.raises(ConfigError, match="unpacks to 60000000 cells"):
        read_table(tmp_path / "episodes.csv")


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_table_of_too_many_columns_is_refused(kind: str, tmp_path: Path) -> None:
    file = tmp_path / f"episodes.{kind}"
    if kind == "csv":
        file.write_text("episode" + ",x" * 10**6 + "\n" + "0" + ",1" * 10**6 + "\n")
    else:
        pa.parquet.write_table(pa.table({f"x{k}": [0] for k in range(5001)}), file)
    with pytest.raises(ConfigError, match=r"is damaged: it has (1000001|5001) columns; at most 5000 are read"):
        read_table(tmp_path / "episodes.csv")


def sparse(path: Path) -> Path:
    path.touch()
    os.truncate(path, 3 * 10**9)
    return path


READERS: dict[str, Callable[[Path], object]] = {
    "metrics.csv": read_table,
    "timing.csv": lambda path: GrowingTable(path, ["a"]).begin(2),
    "summary.json": lambda path: read_json(path, dict),
    "config.yaml": read_yaml,
    "walk.csv": humans.recordings.read_recording,
    "walk.bvh": humans.recordings.read_recording,
    "calibration.conf": lambda path: read_deltas(str(path)),
    "levels.csv": lambda path: read_recording(
        compose("train", ["comfort=conditioned", "comfort.source=file", f"comfort.file={path}"]).comfort
    ),
}


@pytest.mark.parametrize("name", READERS)
def test_a_file_larger_than_memory_is_refused_before_it_is_read(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=rf"{name}.* is of 3000 MB; at most [\d.]+ MB are read"):
        READERS[name](sparse(tmp_path / name))


def test_the_beginning_of_a_large_file_tells_whether_it_is_ours(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is there already"), output_file(sparse(tmp_path / "page.html")):
        pass


def test_what_memory_does_not_hold_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def full(words: list[str]) -> None:
        raise MemoryError

    monkeypatch.setattr("hrl_comfort.cli.main.execute", full)
    assert main(["report"]) == 1 and capsys.readouterr().err == "hrl-comfort: out of memory\n"


def test_an_exported_policy_is_told_apart_from_a_damaged_one(tmp_path: Path) -> None:
    (tmp_path / "x.onnx").write_bytes(b"\x08\x0a\x12")
    with pytest.raises(ConfigError, match=r"x\.onnx: ONNX files are for other programs; give the policy\.pt"):
        checkpoint.load(tmp_path / "x.onnx")


def test_a_cell_of_any_size_is_a_number_or_one_line(tmp_path: Path) -> None:
    (tmp_path / "episodes.csv").write_text('episode,success\n"' + "9" * 200_000 + '",1\n')
    with pytest.raises(ConfigError, match=r"episodes\.csv is damaged: field larger than field limit"):
        read_table(tmp_path / "episodes.csv")


def test_a_recorded_coordinate_that_cannot_be_drawn_is_named(tmp_path: Path) -> None:
    header = "episode,step,tcp_x,tcp_y,tcp_z,human_x,human_y,human_distance_m"
    (tmp_path / "paths.csv").write_text(f"{header}\n0,0,1e308,0,0,,,\n")
    with pytest.raises(ConfigError, match=r"paths\.csv is damaged: line 2: tcp_x=1e\+308 is beyond ±1000"):
        read_table(tmp_path / "paths.csv")


def test_yaml_of_another_kind_than_a_mapping_is_refused(tmp_path: Path) -> None:
    for text, kind in {"5": "int", "[1]": "list", "null": "NoneType"}.items():
        (tmp_path / "config.yaml").write_text(text)
        with pytest.raises(ConfigError, match=f"config.yaml is damaged: it holds a {kind}, not a mapping"):
            load_config(tmp_path)


@pytest.mark.parametrize("read", [load_config, read_yaml])
def test_yaml_with_aliases_is_refused(read: Callable[[Path], object], tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(ALIASES)
    with pytest.raises(ConfigError, match=r"line 2 has an alias, \*a"):
        read(tmp_path / "config.yaml")


@pytest.mark.parametrize("value", ["!!int ''", "!!float ''", "!!timestamp foo", "!!bool foo", "[" * 2000])
def test_yaml_that_python_cannot_make_a_value_of_is_one_line(value: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(f"task: {value}")
    for read in (load_config, read_yaml):
        with pytest.raises(ConfigError, match=r"config\.yaml is damaged: "):
            read(tmp_path / "config.yaml")


def test_a_sweep_has_a_bounded_number_of_jobs(tmp_path: Path) -> None:
    assert len(check_overrides("train", ["train_seed=range(0,100)", "agent.gamma=0.9,0.99"], sweep=True)) == 2
    for much in (["train_seed=range(0,1000000000)"], ["train_seed=range(0,300)"] * 3, ["train_seed=range(0,1,0)"]):
        with pytest.raises(ConfigError, match="at most 10000 are allowed"):
            check_overrides("train", much, sweep=True)
    with pytest.raises(ConfigError, match=r"task=glob\(\*\) is a pattern; list the choices: task=cycle,kitting"):
        check_overrides("train", ["task=glob(*)"], sweep=True)
    (tmp_path / "multirun.yaml").write_text("hydra: {overrides: {task: ['a=range(0,1000000000)']}}")
    with pytest.raises(ConfigError, match=r"multirun\.yaml is damaged: the sweep has 1e\+09 jobs"):
        planned(tmp_path)


def test_networks_beyond_memory_are_refused_before_they_are_made() -> None:
    with pytest.raises(ConfigError, match=r"hidden.* at most 64"):
        compose("train", [f"agent.hidden=[{','.join(['8'] * 5000)}]"])
    config = compose("train", [f"agent.hidden=[{','.join(['8192'] * 64)}]", "agent.buffer_size=1000"])
    assert isinstance(config, TrainConfig)
    with pytest.raises(ConfigError, match=r"agent\.hidden=.* takes 25\d GB; this machine has"):
        SAC(config.agent, 30, 6)


def test_a_fifo_is_no_file(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    config = compose("train", ["comfort=conditioned", "comfort.source=file", f"comfort.file={fifo}"])
    assert isinstance(config.comfort, ComfortConfig)
    reads: list[Callable[[], object]] = [
        lambda: checkpoint.load(fifo), lambda: load_config(fifo), lambda: read_yaml(fifo),
        lambda: read_json(fifo, dict), lambda: GrowingTable(fifo, ["a"]).begin(1),
        lambda: recorded(str(fifo), 10, 6, KINDS), lambda: read_recording(config.comfort),
    ]  # fmt: skip
    for read in reads:
        with pytest.raises(ConfigError):
            read()
