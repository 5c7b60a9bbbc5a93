"""Recordings of people: units are known or refused, joints found by name, folders read whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hrl_comfort.config import ConfigError
from hrl_comfort.humans.recordings import HANDS, HEADER, Recording, read_recording, read_recordings

REACH = Path(__file__).with_name("reach.bvh").read_text()


def read(folder: Path, name: str, text: str) -> Recording:
    (folder / name).write_text(text)
    return read_recording(folder / name)


def walking(unit: float, **renamed: str) -> str:
    """Return a BVH file of a walk of 2 m in 2 s, in a unit of so many to a metre, with other names of joints."""
    bones = [("Neck", 0, 0.5, 0)]
    bones += [(f"{side}{part}", x, y, 0) for side, sign in (("Left", 1), ("Right", -1))
              for part, x, y in (("Arm", sign * 0.18, 0), ("ForeArm", 0, -0.32), ("Hand", 0, -0.25))]  # fmt: skip
    turns = "Zrotation Xrotation Yrotation"
    lines = ["HIERARCHY", "ROOT Hips {", "OFFSET 0 0 0", f"CHANNELS 6 Xposition Yposition Zposition {turns}"]
    for name, *offset in bones:
        lines += [f"JOINT {renamed.get(name, name)} {{", f"OFFSET {' '.join(f'{value * unit:g}' for value in offset)}"]
        lines += [f"CHANNELS 3 {turns}", *["}"] * (3 if name.endswith("Hand") else 0)]
    lines += ["}", "}", "MOTION", "Frames: 41", "Frame Time: 0.05"]
    lines += [f"0 {unit:g} {frame / 20 * unit:g}" + " 0" * 24 for frame in range(41)]
    return "\n".join(lines).replace(" {", "\n{") + "\n"


@pytest.mark.parametrize("unit", [1000.0, 100.0, 1.0, 1 / 0.0254, 0.45 / 0.0254], ids=["mm", "cm", "m", "inch", "cmu"])
def test_a_walk_of_two_metres_is_one_in_every_unit(tmp_path: Path, unit: float) -> None:
    walk = read(tmp_path, "walk.bvh", walking(unit)).position
    np.testing.assert_allclose(np.linalg.norm(walk[-1] - walk[0]), 2.0, atol=1e-3)


@pytest.mark.parametrize("unit", [3e-3, 4.0, 7.0, 300.0, 4000.0])
def test_a_person_of_no_human_size_is_refused(tmp_path: Path, unit: float) -> None:
    with pytest.raises(ConfigError, match=r"arms are \S+ long, which is an adult's length in none of mm, cm, inches"):
        read(tmp_path, "walk.bvh", walking(unit))


@pytest.mark.parametrize(
    "names", ["Arm ForeArm Hand", "UpperArm LowerArm Wrist", "Shoulder Elbow Wrist", "_Shldr _Forearm _Hand"]
)
@pytest.mark.parametrize("sides", [("Left", "Right"), ("L", "R"), ("mixamorig:Left", "mixamorig:Right")])
def test_joints_are_found_by_name_wherever_they_stand(tmp_path: Path, names: str, sides: tuple[str, str]) -> None:
    parts = dict(zip(("Arm", "ForeArm", "Hand"), names.split(), strict=True))
    renamed = {
        f"{old}{part}": new + parts[part] for old, new in zip(("Left", "Right"), sides, strict=True) for part in parts
    }
    expected = read(tmp_path, "walk.bvh", walking(100.0))
    text = walking(100.0, **renamed).replace(
        "ROOT Hips\n{", "ROOT Reference\n{\nOFFSET 0 0 0\nCHANNELS 0\nJOINT Pelvis\n{"
    )
    found = read(tmp_path, "renamed.bvh", text.replace("MOTION", "}\nMOTION").replace("Zposition", "zPosition"))
    np.testing.assert_array_equal(found.position, expected.position)
    np.testing.assert_array_equal(found.limbs, expected.limbs)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("Frame Time: 0.04", "Frame Time: x", "Frame Time: 0.01"),
        ("Frame Time: 0.04", "Frame Time: 40", "Frame Time: 40 is not from 0.0001 to 1 s"),
        ("Frame Time: 0.04", "Frame Time: 0", "Frame Time: 0 is not"),
        ("Frames: 51", "Frames: 52", "not 52 frames"),
        ("Frames: 51", "Frames: 0", "not 0 frames"),
        ("MOTION", "", "after MOTION come"),
        ("RightHand", "RightToe", "no joint for the right hand, only hips, neck, leftarm"),
        ("ROOT Hips", "ROOT Reference", "no joint for hips or pelvis, only reference, neck"),
        ("OFFSET 0 500 0", "OFFSET 0 -500 0", "shoulders are not above its hips; export it with y up"),
        ("OFFSET 0 -320 0", "OFFSET 0 0 0", "in the same place"),
    ],
)
def test_a_damaged_bvh_file_is_refused_in_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError, match=rf"bad\.bvh' is not a BVH file of a whole person: .*{says}"):
        read(tmp_path, "bad.bvh", REACH.replace(old, new))


STROLL = [(0.02 * k, 0.5 + 0.02 * k, 1.0, 1.6 * np.sin(0.02 * k)) for k in range(100)]
REACHING = [(*line, line[1] + 0.3, 1.2, 1.1, line[1] + 0.3, 0.8, 1.1) for line in STROLL]


@pytest.mark.parametrize(
    ("lines", "scales", "says"),
    [
        (STROLL, {0: 1000}, "column t lets the person move at .* it must be in s"),
        (STROLL, {0: 50}, "column t"),
        (STROLL, {1: 100, 2: 100}, "columns x, y never come within 10 of the robot; they must be in m"),
        (STROLL, {1: 18}, "columns x, y change by 18 within a second; they must be in m"),
        (STROLL, {3: 180 / np.pi}, "column yaw begins beyond ±2π or spins; it must be in rad"),
        ([(0, 1, 0, 170)], {}, "column yaw"),
        ([(0, 1, 0, 0), (5, 1, 0, 0), (15, 1, 0, 90), (60, 1, 0, 90)], {}, "column yaw"),
        (REACHING, dict.fromkeys(range(4, 10), 100), "columns left_x … right_z are out of the person's reach"),
        (REACHING, dict.fromkeys((6, 9), 100), "columns left_x … right_z are out of the person's reach"),
        (REACHING, dict.fromkeys((1, 2, 4, 5, 6, 7, 8, 9), 1000), r"line 2 has a value beyond ±1000 \(m, rad\)"),
    ],
)  # fmt: skip
def test_a_column_in_another_unit_is_refused_and_named(tmp_path: Path, lines: list, scales: dict, says: str) -> None:
    def text(scales: dict[int, float]) -> str:
        rows = (",".join(str(value * scales.get(k, 1)) for k, value in enumerate(line)) for line in lines)
        return "\n".join([",".join((HEADER + HANDS)[: len(lines[0])]), *rows, " ", ""])

    if scales:
        assert read(tmp_path, "right.csv", text({})).placed  # blank lines at the end say nothing
    with pytest.raises(ConfigError, match=rf"wrong\.csv': {says}"):
        read(tmp_path, "wrong.csv", text(scales))


@pytest.mark.parametrize("last_s", [-1.0, 2.0])
def test_a_negative_time_is_refused(tmp_path: Path, last_s: float) -> None:
    with pytest.raises(ConfigError, match=r"line 2 has t=-2; times must be 0 or more: subtract the first time"):
        read(tmp_path, "early.csv", f"t,x,y,yaw\n-2,1,0,0\n{last_s},1,0.5,0\n")


def test_turns_jumps_and_wraps_of_people_are_taken(tmp_path: Path) -> None:
    lines = [(0.02 * k, 3.0 * (k >= 30), 1.0, (0.1 * k + 3.0) % (2 * np.pi) - np.pi) for k in range(1000)]
    text = "t,x,y,yaw\n" + "\n".join(",".join(map(str, line)) for line in lines)
    recording = read(tmp_path, "spin.csv", text.replace("\n", "\r\n"))
    assert recording.yaw[-1] - recording.yaw[0] == pytest.approx(99.9)


def test_a_folder_gives_its_recordings_and_nothing_hidden(tmp_path: Path) -> None:
    for index, name in enumerate(["A.CSV", "b.csv", "sub/d.Csv"]):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(f"t,x,y,yaw\n0,{index},0,0\n")
    (tmp_path / "C.BVH").write_text(REACH)
    for name in ("._b.csv", ".ipynb_checkpoints/b.csv", "sub/.trash/x.bvh", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"\0\5\x16\7\0")
    found = read_recordings(str(tmp_path))
    assert [each.placed for each in found] == [True, False, True, True]
    assert [each.position[0, 0] for each in found if each.placed] == [0.0, 1.0, 2.0]
