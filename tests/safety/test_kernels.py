"""Compiled kernels and the numpy functions that define them agree in every bit."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.compiled import kernel, plain
from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.safety import drive_kernels, kernels
from hrl_comfort.safety.drive import SetPoints, make_drive
from hrl_comfort.safety.geometry import ArmPose, farthest, gaps
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.workcell import build_scene, scene_of
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.plan import capsules

Array = NDArray[np.float64]
RATED = ["task=pick", "robot.rating=collaborative", "safety=ssm", "human=mixture", "task.terminate_on=unsafe_contact"]


class Numpy(np.ndarray):  # type: ignore[type-arg]
    """An array that is not numpy's own, so that no kernel takes it."""


def both(function: Callable[..., Any], *arrays: Array) -> None:
    """Assert that `function` returns the same bits of arrays that kernels take and of those that they do not."""
    compiled, defined = function(*arrays), function(*(array.view(Numpy) for array in arrays))
    assert plain(*arrays) and not plain(arrays[0].view(Numpy))
    for mine, theirs in zip(*map(parts, (compiled, defined)), strict=True):
        np.testing.assert_array_equal(mine, np.asarray(theirs), strict=True)


def parts(found: Any) -> list[Array]:
    return [*vars(found).values()] if is_dataclass(found) else [*found] if isinstance(found, tuple) else [found]


@pytest.fixture(scope="module")
def separation() -> Separation:
    config = compose("train", ["task=pick"])
    return Separation(build_scene(config.robot, config.cell, config.engine.substeps))


@pytest.fixture(params=[1, 3, 64])
def rows(request) -> int:
    return request.param


def people(rng: np.random.Generator, rows: int) -> Array:
    limbs = rng.normal(size=(rows, 7, 7))
    limbs[..., 3:] /= np.linalg.norm(limbs[..., 3:], axis=-1, keepdims=True)
    return limbs


def test_poses_and_speeds_of_the_arm(separation: Separation, rows: int) -> None:
    rng = np.random.default_rng(rows)
    angles, velocity = rng.uniform(-4, 4, (2, rows, 6))
    for at in (angles, np.zeros_like(angles), np.full_like(angles, np.pi / 2)):
        both(separation.arm.pose, at)
        pose = separation.arm.pose(at)
        for moving in (velocity, np.zeros_like(velocity)):
            both(separation.arm.points, at, moving)
            both(separation.arm.bending, moving)
            both(lambda *given: separation.arm.speeds(ArmPose(*given[:3]), given[3]), *vars(pose).values(), moving)


def test_rows_and_capsules_bend_alike_at_once_and_one_by_one(separation: Separation, rows: int) -> None:
    velocity = np.random.default_rng(rows).uniform(-4, 4, (rows, 6))
    found, swept = drive_kernels.bends(velocity, separation.arm.lever), np.empty(6)
    np.testing.assert_allclose(found, separation.arm.bending(velocity), rtol=1e-13)
    for row in range(rows):
        drive_kernels.sweep(velocity, row, swept)
        each = [drive_kernels.bend(swept, separation.arm.lever, part) for part in range(len(found))]
        np.testing.assert_array_equal(found[:, row], each)


def test_arrays_in_another_order_are_the_same(separation: Separation) -> None:
    rng = np.random.default_rng(0)
    joints, limbs = rng.uniform(-3, 3, (12, 5)).T, people(rng, 10)[::2]
    assert not joints.flags.c_contiguous and not limbs.flags.c_contiguous
    both(separation.arm.pose, joints[:, :6])
    both(separation.person.ends, limbs)


def test_distances_of_capsules_that_cross_touch_lie_in_line_or_are_points(separation: Separation, rows: int) -> None:
    rng = np.random.default_rng(rows)
    ends, limbs = separation.arm.pose(rng.uniform(-3, 3, (rows, 6))).ends, separation.person.ends(people(rng, rows))
    both(separation.person.ends, people(rng, rows))

    def apart(first: Array, second: Array) -> Array:
        return gaps(separation.arm, first, separation.person, second)

    both(apart, ends, limbs)

    both(separation.pairs, rng.normal(size=(rows, 6)), rng.normal(size=(rows, 6)), people(rng, rows))
    both(farthest, limbs, rng.normal(size=limbs.shape))
    both(farthest, limbs, limbs)
    both(apart, ends, np.zeros_like(limbs))
    both(apart, np.zeros_like(ends), np.zeros_like(limbs))
    both(apart, ends, np.ascontiguousarray(ends[:, : limbs.shape[1]]))
    both(apart, ends, np.ascontiguousarray(ends[:, : limbs.shape[1]] + 1e-7))


def test_whom_people_meet_and_come_nearer_to(separation: Separation, rows: int) -> None:
    rng, arm, person = np.random.default_rng(rows), separation.arm, separation.person
    before = people(rng, rows)
    before[..., 1] += 0.5
    after, found = before + np.concatenate([rng.normal(0, 0.1, (rows, 7, 2)), np.zeros((rows, 7, 5))], axis=2), []
    now = separation.encounter(rng.uniform(-3, 3, (rows, 6)), before)
    ends = person.ends(after)
    then, way = gaps(arm, now.pose.ends, person, ends), farthest(ends, now.person)
    given = now.pose.ends, now.apart, now.person, ends, arm.radius, person.radius
    met = np.where(now.apart.min(axis=0) <= way, then.min(axis=0), np.inf)
    gap, touching, most_m = kernels.met(*given)
    np.testing.assert_array_equal(gap, met)
    assert touching == (met <= 0.0).any() and most_m == way.max()
    for most in (0.0, 0.05, 0.1, 0.2):
        nearer = (way > most) & ((now.apart - then).max(axis=0) > most)
        np.testing.assert_array_equal(kernels.approached(*given, most), nearer)
        found += [*nearer, *np.isfinite(met)]
    assert rows < 64 or len(set(found)) == 2


def test_capsules_one_after_the_other(rows: int) -> None:
    rng = np.random.default_rng(rows)
    ends, radius = rng.normal(size=(3, 5, 2, rows)), rng.random(5)
    both(capsules, ends, radius)
    both(capsules, ends, np.empty(0))
    np.testing.assert_array_equal(capsules(ends, radius)[:, 2, 3:6], ends[:, 2, 1].T)
    assert (capsules(ends, radius)[..., 6] == radius).all()


WORLDS = {
    "worst": RATED, "observed": [*RATED, "safety.bound=observed"], "late": [*RATED, "safety.latency_s=0.05"],
    "no shield": [*RATED[:2], "human=mixture"],
}  # fmt: skip


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("takes_back", [True, False])
def test_a_control_step_of_the_drive(world: str, takes_back: bool) -> None:
    config, rng, rows = compose_environment("train", WORLDS[world]), np.random.default_rng(0), 300
    scene = scene_of(config)
    separation = Separation(scene)
    compiled, defined = (make_drive(scene, separation, config, rows, takes_back=takes_back) for _ in range(2))
    assert compiled is not None and defined is not None
    walk = humans.begin(config.human, rng.uniform(-1, 1, (rows, 2)), rng.random((rows, humans.TRAITS)))
    limbs = limbs_of(scene, walk)
    for drive in (compiled, defined):
        drive.begin(np.arange(rows), limbs)
    angles = scene.home + rng.uniform(-1.5, 1.5, (rows, 6))
    points, found = SetPoints.unshielded(angles, np.zeros((rows, 6)), np.zeros(rows, np.int64)), []
    for scale in np.tile([0.0, 0.01, 0.1, 1.0], 10):
        joints = np.concatenate([points.angles, points.velocity], axis=1) + scale * rng.normal(0, 0.05, (rows, 12))
        joints[: rows // 3, :6] += rng.normal(0, 0.05, (rows // 3, 6))  # some do not follow
        limbs = limbs + np.concatenate([rng.normal(0, 0.01, (rows, 1, 2)), np.zeros((rows, 1, 5))], axis=2)
        now, asked = separation.encounter(joints[:, :6], limbs), rng.normal(0, 1.0, (rows, 6))
        asked[::7] = 0.0
        seen = limbs if scale < 0.05 else limbs + 0.001
        mine, theirs = compiled.step(points, asked, joints, now, seen), defined.step(
            points, asked, joints.view(Numpy), now, seen
        )  # fmt: skip
        for one, other in zip([mine[0], *parts(mine[1])], [theirs[0], *parts(theirs[1])], strict=True):
            np.testing.assert_allclose(one, np.asarray(other), rtol=0, atol=1e-12, strict=True)
        if compiled.shield is not None and defined.shield is not None:
            for one, other in zip(parts(compiled.shield.memory), parts(defined.shield.memory), strict=True):
                np.testing.assert_allclose(one, np.asarray(other), rtol=0, atol=1e-12, strict=True)
        points = mine[1]
        found.append([now.apart.min(axis=0) <= 0.0, points.braking, ~points.braking & (points.share < 0.9)])
    assert np.any(found, axis=(0, 2)).all(), "some touch, some brake, some are slowed"


@pytest.mark.parametrize("world", ["worst", "observed"])
@pytest.mark.parametrize("unknown", ["joints", "limbs"])
@pytest.mark.parametrize("kind", [np.ndarray, Numpy])
def test_an_arm_slows_down_where_something_is_unknown(world: str, unknown: str, kind: type[Array]) -> None:
    config = compose_environment("train", WORLDS[world])
    scene = scene_of(config)
    separation = Separation(scene)
    drive = make_drive(scene, separation, config, 2)
    assert drive is not None
    limbs = limbs_of(scene, humans.begin(config.human, np.array([[3.0, 0.0], [3.0, 0.0]])))
    drive.begin(np.arange(2), limbs)
    points = SetPoints.unshielded(np.tile(scene.home, (2, 1)), np.zeros((2, 6)), np.zeros(2, np.int64))
    for step in range(4):
        joints = np.concatenate([points.angles, points.velocity], axis=1)
        if step:
            (joints if unknown == "joints" else limbs)[0] = np.nan
        now = separation.encounter(joints[:, :6], limbs)
        points = drive.step(points, np.ones((2, 6)), joints.view(kind), now, limbs)[1]
    assert points.share[0] < 0.2 and points.share[1] == 1.0


def test_a_function_that_cannot_be_kept_is_compiled_all_the_same() -> None:
    found: dict[str, Any] = {}
    exec("def twice(value):\n    return 2 * value", found)  # from no file: there is no folder for its machine code
    assert kernel(found["twice"])(21.0) == 42.0


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    said = "from hrl_comfort.compiled import kernel\n"
    (tmp_path / "caller_of_kernel.py").write_text(
        f"{said}from called_kernel import change\n@kernel\ndef changed(value):\n    return change(value) + 1\n"
    )
    for body, found in (("2 * value", 43.0), ("value + 100", 122.0), ("value + 100", 122.0)):
        (tmp_path / "called_kernel.py").write_text(f"{said}@kernel\ndef change(value):\n    return {body}\n")
        for name in ("called_kernel", "caller_of_kernel"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        assert importlib.import_module("caller_of_kernel").changed(21.0) == found


def test_a_kernel_is_compiled_anew_when_a_constant_of_another_module_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "user_of_constant.py").write_text(
        "from hrl_comfort.compiled import kernel\nfrom constant_of_kernel import FACTOR\n"
        "@kernel\ndef scaled(value):\n    return FACTOR * value\n"
    )
    for factor, found in ((2.0, 42.0), (3.25, 68.25)):  # other lengths: Python's own cache looks at time and length
        (tmp_path / "constant_of_kernel.py").write_text(f"FACTOR = {factor}\n")
        for name in ("constant_of_kernel", "user_of_constant"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        assert importlib.import_module("user_of_constant").scaled(21.0) == found
