"""Damage of every kind to files of every kind."""

from __future__ import annotations

import csv
import io
import json
import os
import random
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
import yaml

from tests.artefacts import zero
from tests.generating import FOREIGN, ODD

BOMB = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n".encode() for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
VALUES: list[Any] = [
    None, True, 0, -1, 10**12, 1e308, float("nan"), float("inf"), "", "x", "x" * 2 * 10**5, [], [1], {}, {"a": 1},
    "0,1", "ü\0\n", [[[]]], "range(1000000000)", "a=range(0,1000000000)", "${a}", "<script>", "../../x", 2**70, "1e999",
]  # fmt: skip


def damage(path: Path, rng: random.Random) -> str:
    """Damage a file in place; return how."""
    any_file = [flipped, flipped, cut, line_cut, gone, foreign, special, huge]
    typed = {".pt": tensors, ".npz": arrays, ".json": values, ".yaml": values, ".csv": cells}.get(path.suffix)
    kind = typed if typed and rng.random() < 0.5 else rng.choice(any_file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kind(path, rng)
    return kind.__name__


def flipped(path: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(rng.choice([1, 1, 3, 30])):
        content[rng.randrange(len(content))] = rng.randrange(256)
    path.write_bytes(content)


def cut(path: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(len(content))])


def line_cut(path: Path, rng: random.Random) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    at = rng.randrange(len(lines))
    lines[at : at + rng.choice([1, 1, 5])] = [lines[at][: rng.randrange(len(lines[at]))]] if rng.random() < 0.5 else []
    path.write_bytes(b"".join(lines))


def gone(path: Path, rng: random.Random) -> None:
    path.unlink()
    if rng.random() < 0.5:
        path.mkdir()


def foreign(path: Path, rng: random.Random) -> None:
    """Put another text, or the content of another artefact in its place."""
    others = [each.read_bytes() for each in sorted(Path().rglob("*.*")) if each.is_file()]
    path.write_bytes(
        rng.choice([rng.choice([*FOREIGN, b"null", b"5", b"a,b\n", b"[" * 9000, BOMB]), rng.choice(others)])
    )


def special(path: Path, rng: random.Random) -> None:
    path.unlink()
    kind = rng.choice(["fifo", "device", "link", "loop"])
    if kind == "device" and os.getuid() == 0:
        zero(path)
    elif kind in ("link", "loop"):
        path.symlink_to("/dev/zero" if kind == "link" else path.name)
    else:
        os.mkfifo(path)


def huge(path: Path, rng: random.Random) -> None:
    """Let the file claim, or unpack to, more than memory holds."""
    match path.suffix:
        case ".csv":
            kind = rng.choice(["cell", "columns", "sparse"])
            if kind == "cell":
                path.write_bytes(path.read_bytes() + b'"' + b"9" * rng.choice([10**5, 2 * 10**5, 10**7]) + b'"\n')
            elif kind == "columns":
                path.write_text("".join(line + ",x" * 10**6 + "\n" for line in path.read_text().splitlines()[:2]))
            else:
                os.truncate(path, rng.choice([3 * 10**8, 3 * 10**9]))
        case ".npz" | ".pt":
            bomb = zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED)
            with bomb, bomb.open(rng.choice(["orange.npy", "archive/data.pkl", "x"]), "w", force_zip64=True) as file:
                for _ in range(rng.choice([100, 3000])):
                    file.write(bytes(10**6))
        case ".parquet":
            zeros = pa.array(np.zeros(3 * 10**7, dtype=np.int8))
            pq.write_table(pa.table({"episode": zeros, "success": zeros}), path)
        case _:
            path.write_bytes(path.read_bytes() + b"\n" + BOMB + b"x: range(1000000000)\n")


def places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container of nested dicts and lists with each of its keys."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], (dict, list)):
            yield from places(tree[key])


def values(path: Path, rng: random.Random) -> None:
    reads, writes = (json.loads, json.dumps) if path.suffix == ".json" else (yaml.safe_load, yaml.safe_dump)
    content = reads(path.read_text())
    tree, key = rng.choice([*places(content)])
    if rng.random() < 0.2:
        del tree[key]
    else:
        tree[key] = rng.choice(VALUES)
    path.write_text(writes(content), encoding="utf-8", errors="replace")


def cells(path: Path, rng: random.Random) -> None:
    rows = [*csv.reader(path.read_text().splitlines())]
    row = rng.choice([rows[0], *rows])
    row[rng.randrange(len(row))] = rng.choice([*map(str, VALUES), *ODD[:20]])
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8", errors="replace")


TENSORS: list[Callable[[], Any]] = [
    lambda: torch.zeros(1).expand(10**5, 10**5),
    lambda: torch.zeros(1).expand(10**9, 10**9),
    lambda: torch.sparse_coo_tensor(torch.zeros(2, 1, dtype=torch.int64), torch.ones(1), (10**9, 10**9)),
    lambda: torch.full((16,), float("nan")),
    lambda: torch.full((16, 5), 1e38),
    lambda: torch.zeros(3, dtype=torch.complex64),
    lambda: torch.zeros(0),
    lambda: torch.empty(7, device="meta"),
    lambda: torch.zeros(16, dtype=torch.int8),
    lambda: torch.nested.nested_tensor([torch.zeros(2), torch.zeros(3)]),
    lambda: torch.quantize_per_tensor(torch.ones(4), 0.1, 0, torch.qint8),
]


def tensors(path: Path, rng: random.Random) -> None:
    state = torch.load(path, weights_only=True)
    tree, key = rng.choice([*places(state)])
    if rng.random() < 0.15:
        del tree[key]
    elif isinstance(tree[key], torch.Tensor) and rng.random() < 0.3:
        tree[key] = tree[key].T if rng.random() < 0.5 else tree[key] * rng.choice([1e20, float("inf")])
    else:
        tree[key] = rng.choice(TENSORS)() if rng.random() < 0.5 else rng.choice(VALUES)
    torch.save(state, path)


def arrays(path: Path, rng: random.Random) -> None:
    banks = dict(np.load(path))
    wrong: list[Any] = [
        np.zeros(0), np.zeros((1, 18)) * np.nan, np.array("text"), np.array([None, 1], dtype=object),
        np.zeros((2, 17)), np.full((1, 21), 1e300), np.zeros((1, 18), dtype=complex), np.zeros((3, 3, 3)),
        np.zeros(3, dtype=[("a", "f8")]), np.zeros((1, 18), dtype=np.int8),
    ]  # fmt: skip
    banks[rng.choice([*banks])] = rng.choice(wrong)
    np.savez(path, **banks)
    if rng.random() < 0.3:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 21)})
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("orange.npy", header.getvalue())
            archive.writestr("pink.npy", header.getvalue())
