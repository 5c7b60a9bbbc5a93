"""The exported page, opened from disk without a network, computes what Python computes, and obeys its user."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, StudioConfig
from hrl_comfort.files.run_config import environment

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.policies.actor import load_policy
from hrl_comfort.policies.graph import inputs_of
from hrl_comfort.policies.load import observed_by
from hrl_comfort.scene import build_scene
from hrl_comfort.scene.human import LIMBS, limb_poses
from hrl_comfort.scene.looks import dressed
from hrl_comfort.sim.engine import Engine
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.view import body_meshes
from hrl_comfort.studio.web import content, page
from hrl_comfort.studio.web.trace import traced
from tests.studio.browser import opened, until

CHAIN = {"pick_place": "runs/reference/comfort/stages/seed0", "return": "runs/reference/return"}
"""A policy with levels, and one without."""
WORDS = [
    *(f"policies.{name}={folder}" for name, folder in CHAIN.items()), "task=cycle", "meta_controller=nearest",
    "division=two", "task.precision.grasp_tolerance_m=0.3", "task.precision.place_tolerance_m=0.3",
]  # fmt: skip
SORTING = [
    *(f"policies.{name}=runs/reference/{name}" for name in ("pick", "place", "return")),
    "meta_controller=nearest",
]
WEB = Path("hrl_comfort/studio/web")
EPISODES = 2
SIZE = {"width": 700, "height": 560}
SMALL = {"width": 80, "height": 60}
"""Of a page whose picture is not looked at: while a page is open, software draws it, and a small one costs less
time."""


def configured(*words: str) -> StudioConfig:
    config = compose("studio", [*WORDS, *words])
    assert isinstance(config, StudioConfig)
    return config


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page of the reference chain with levels."""
    if subprocess.run(["make", "--question", "page"], capture_output=True).returncode:
        pytest.skip("the page's program is not built, or of older sources: make page")
    path = tmp_path_factory.mktemp("page") / "page.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(content, "EPISODES", EPISODES)
        patch.setattr(content, "RECORDED_S", 5.0)
        return page.export_page(configured(f"export={path}"))


@pytest.fixture(scope="module")
def shown(browser: Any, file: Path) -> Iterator[tuple[Any, list[str]]]:
    with opened(browser, file.resolve().as_uri(), viewport=SIZE) as (tab, wrong):
        tab.context.set_offline(True)
        tab.wait_for_function("window.player")
        yield tab, wrong


@pytest.fixture
def tab(shown: tuple[Any, list[str]]) -> Iterator[Any]:
    """The page at the beginning of its first episode, paused, at level 5, nobody held."""
    tab, wrong = shown
    tab.set_viewport_size(SIZE)
    tab.evaluate(
        """() => { player.running = false; player.speed = 1; player.cell.person.letGo(); player.cell.level = 5;
                   player.cell.episode = -1; player.reset(); }"""
    )
    yield tab
    tab.set_viewport_size(SMALL)
    assert wrong == []


def place(tab: Any) -> list[float]:
    """Return where the person is (x, y), m."""
    return tab.evaluate("player.cell.person.walk.place")


def walk(tab: Any, where: list[float]) -> None:
    """Take the person to a place (x, y), m."""
    tab.evaluate(
        """(where) => { player.running = false; const { person } = player.cell; person.goTo(where);
                        for (let k = 0; k < 150; k++) person.advance();
                        player.view.show(player.after, player.after, 1); }""",
        where,
    )


def pixel(tab: Any, x: float, y: float) -> tuple[float, float]:
    """Return where on the page the middle of a person at (x, y) m is seen."""
    return tab.evaluate(
        """([x, y]) => { const { camera, world } = player.view; camera.updateMatrixWorld();
             const seen = world.localToWorld(camera.position.clone().set(x, y, 0.2)).project(camera);
             return [(innerWidth * (1 + seen.x)) / 2, (innerHeight * (1 - seen.y)) / 2]; }""",
        [x, y],
    )


def test_a_whole_cycle_is_played_in_real_time_without_a_network(tab: Any) -> None:
    tab.evaluate("() => { player.cell.counts.success = 0; player.speed = 4; player.running = true; }")
    until(lambda: tab.evaluate("player.cell.counts.success") > 0, "a cycle is done")
    assert tab.evaluate("player.cell.counts.contact + player.cell.counts.other") == 0


@pytest.mark.parametrize("option", CHAIN)
def test_the_page_acts_as_python_does_in_states_of_real_episodes(tab: Any, option: str) -> None:
    config = compose("evaluate", [f"policy={CHAIN[option]}", "comfort.source=random", "task.start=ik"])
    env = environment(config)
    policy, engine = load_policy(Path(CHAIN[option])), Engine(env, 50, 0)
    task = observed_by(policy, CHAIN[option], engine.episodes.subtask, env)
    names, states, actions, state = inputs_of(task.observe, engine.reset()), [], [], engine.reset()
    for _ in range(20):
        acted = policy(task.observe(state)).double()
        for row in range(50):
            states.append({name: getattr(state, name)[row].tolist() for name in names})
        actions.append(acted.numpy())
        state = engine.step(acted.numpy()).state
    engine.close()
    given = tab.evaluate(
        """([option, states]) => states.map((state) => {
             const shape = (value) => Array.isArray(value) ? [value.length, ...shape(value[0])] : [];
             const row = (value) => ({ shape: [1, ...shape(value)], data: [value].flat(2) });
             const fields = Object.fromEntries(Object.entries(state).map(([name, value]) => [name, row(value)]));
             return Array.from(player.cell.options.find(({ name }) => name === option).act(fields).made);
           })""",
        [option, states],
    )
    assert len(given) == 1000
    assert np.abs(np.array(given) / np.radians(env.task.max_step_deg) - np.concatenate(actions)).max() < 1e-5


@pytest.mark.parametrize("level", [1, 10])
def test_joints_go_where_they_go_in_python_for_whole_episodes(tab: Any, level: int) -> None:
    session = Session(configured("comfort.source=fixed", f"comfort.level={level}"))
    joints = []
    for _ in range(EPISODES):
        session.reset()
        path = [session.still().joints]
        while not session.over:
            path.append(session.step().clip.joints[1:])
        joints.append(np.concatenate(path))
    session.close()
    played = tab.evaluate(
        """([level, episodes]) => episodes.map((episode) => {
             const { cell } = player;
             cell.level = level;
             cell.reset(episode);
             const path = [cell.state.joint_pos];
             while (!cell.outcome) { cell.step(); path.push(cell.state.joint_pos); }
             return path;
           })""",
        [level, list(range(EPISODES))],
    )
    for ours, theirs in zip(joints, played, strict=True):
        assert np.abs(ours - np.array(theirs)).max() < 1e-6


def test_limbs_are_posed_as_in_python(tab: Any) -> None:
    generator = np.random.default_rng(0)
    for given in (False, True):
        down = generator.normal(size=(6, 3))
        down /= np.linalg.norm(down, axis=1, keepdims=True)
        down[:2] = np.nan
        x, y, yaw, phase = generator.uniform(-3, 3, 4)
        directions = down if given else np.full((6, 3), np.nan)
        ours = limb_poses(x, y, yaw, phase, 0.4, -0.75, directions)
        limbs = [None if np.isnan(value) else value for value in directions.ravel()]
        theirs = tab.evaluate(
            """([x, y, yaw, phase, limbs]) => player.limbPoses({ place: [x, y], yaw, phase, swing: 0.4,
                 limbs: limbs.map((value) => value ?? NaN) }, player.cell.content.body, -0.75)""",
            [x, y, yaw, phase, limbs],
        )
        np.testing.assert_allclose(theirs, ours, atol=1e-9)


def test_the_page_draws_the_looks_and_simulates_none(tab: Any) -> None:
    config = configured()
    model = dressed(build_scene(config.robot, config.cell, 2)).model
    drawn = tab.evaluate(
        """() => player.view.bodies.map((group) => group.children.map(({ geometry }) => {
             geometry.computeBoundingBox(); return geometry.boundingBox.min.toArray(); }))"""
    )
    for body, meshes in body_meshes(model).items():
        if body and model.body_mocapid[body] < len(LIMBS):
            np.testing.assert_allclose(drawn[body], [mesh.bounds[0] for _, mesh in meshes], atol=1e-4)
    assert tab.evaluate("player.cell.model.nmesh") == 0


def test_the_slider_sets_the_level_that_the_policy_sees(tab: Any) -> None:
    seen, acts = [], []
    tab.evaluate(
        "() => { player.cell.person.goTo([-0.3, -0.4]); for (let k = 0; k < 60; k++) player.cell.person.advance(); }"
    )
    for key in ("Home", "End"):
        tab.locator("#level").press(key)
        tab.locator("#one").click()
        seen.append(tab.evaluate("player.cell.state.level"))
        tab.locator("#reset").click()
        acts.append(tab.evaluate("() => { player.cell.state.level = player.cell.level; return player.cell.act(); }"))
    assert seen == [1, 10]
    assert np.abs(np.subtract(*acts)).max() > 0.1 * np.radians(2.0)


def test_a_person_dragged_to_the_arm_is_nearer_and_the_arm_responds(tab: Any) -> None:
    walk(tab, [0.2, -0.9])
    far, action = tab.evaluate("[player.cell.distance, player.cell.act()]")
    start, end = pixel(tab, 0.2, -0.9), pixel(tab, -0.1, -0.35)
    tab.mouse.move(*start)
    tab.mouse.down()
    tab.mouse.move(*end, steps=4)
    until(lambda: np.hypot(*tab.evaluate("player.cell.person.target.place")) < 0.45, "the person is dragged")
    tab.mouse.up()
    tab.evaluate("() => { for (let k = 0; k < 50; k++) player.cell.person.advance(); player.reset(); }")
    assert np.hypot(*place(tab)) < 0.45
    assert tab.evaluate("player.cell.distance") < far - 0.2
    assert np.abs(np.subtract(action, tab.evaluate("player.cell.act()"))).max() > 0.1 * np.radians(2.0)


def test_the_person_is_in_the_next_observation(tab: Any) -> None:
    tab.evaluate("() => player.decide()")
    walk(tab, [-0.5, -0.5])
    assert tab.evaluate("player.cell.fields(0, 5).humans_seen.data") == place(tab)
    assert tab.evaluate("player.cell.decision") is None  # the next step asks the policy


def test_an_episode_waits_for_a_person_in_the_arms_way(tab: Any) -> None:
    walk(tab, [0.0, 0.0])
    run = "() => { for (let k = 0; k < 10; k++) player.step(); return player.cell.state.steps; }"
    tab.evaluate("() => player.reset()")
    assert tab.evaluate(run) == 0
    walk(tab, [1.2, -1.0])
    assert tab.evaluate(run) in (9, 10)
    assert tab.evaluate("player.cell.outcome") is None


def test_keys_and_the_left_stick_of_a_gamepad_walk_the_person(tab: Any) -> None:
    walk(tab, [-0.6, -0.9])
    tab.evaluate("() => { player.running = true; }")
    tab.keyboard.down("s")
    until(lambda: np.hypot(*place(tab)) > 1.3, "the person walks backwards")
    tab.keyboard.up("s")
    before = np.array(place(tab))
    tab.evaluate(
        """() => { navigator.getGamepads = () => [{ mapping: "standard", axes: [0, -1, 0, 0],
                   buttons: Array.from({ length: 17 }, (_, button) => ({ pressed: button === 5 })) }]; }"""
    )
    until(lambda: np.linalg.norm(np.array(place(tab)) - before) > 0.3, "the person walks away from the camera")
    tab.evaluate("() => { navigator.getGamepads = () => []; }")
    assert place(tab)[1] > before[1] + 0.1
    assert tab.evaluate("player.cell.level") == 6


def test_a_finger_drags_the_person(browser: Any, file: Path) -> None:
    with opened(browser, file.resolve().as_uri(), has_touch=True, viewport=SIZE) as (tab, wrong):
        tab.wait_for_function("window.player")
        walk(tab, [0.2, -0.9])
        touch = tab.context.new_cdp_session(tab)
        start, end = np.array(pixel(tab, 0.2, -0.9)), np.array(pixel(tab, -0.1, -0.4))
        for kind, share in (("touchStart", 0.0), ("touchMove", 0.5), ("touchMove", 1.0)):
            x, y = start + share * (end - start)
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}]})
        until(lambda: np.hypot(*tab.evaluate("player.cell.person.target.place")) < 0.6, "the finger drags the person")
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        assert wrong == []


def test_head_and_hands_of_a_headset_are_the_persons(browser: Any, file: Path) -> None:
    emulator = (WEB / "node_modules/iwer/build/iwer.min.js").read_text(encoding="utf-8")
    script = emulator + (
        ";window.device = new IWER.XRDevice(IWER.metaQuest3); device.installRuntime({ forceInstall: true });"
        "console.warn = () => {};"
    )
    with opened(browser, file.resolve().as_uri(), script, viewport=SMALL) as (tab, wrong):
        tab.wait_for_function("window.player")
        tab.evaluate("() => { player.running = true; player.view.renderer.shadowMap.autoUpdate = false; }")
        tab.locator("#vr").click()
        tab.wait_for_function("player.view.renderer.xr.isPresenting")
        tab.wait_for_function("player.cell.person.byHand && player.cell.person.target.limbs[6] !== null")
        began = place(tab)
        tab.evaluate("() => device.position.set(0.4, 1.7, 0.3)")
        until(lambda: np.linalg.norm(np.subtract(place(tab), began)) > 0.4, "the person goes where the head goes")
        down = "player.cell.person.walk.limbs[14]"  # z of the left forearm
        until(lambda: tab.evaluate(f"Number.isFinite({down})"), "the hands are tracked")
        for height, sign in ((0.8, -1), (1.8, 1)):
            tab.evaluate("height => device.controllers.left.position.set(0.3, height, 0.1)", height)
            tab.wait_for_function(f"{sign} * {down} > 0.2")
        for button, level in (("a-button", 6), ("b-button", 5)):
            tab.evaluate("button => device.controllers.right.updateButtonValue(button, 1)", button)
            tab.wait_for_function(f"player.cell.level === {level}")
            tab.evaluate("button => device.controllers.right.updateButtonValue(button, 0)", button)
        assert tab.locator("#level").input_value() == "5"
        bearing = "player.view.rig.rotation.y"
        faced = tab.evaluate(bearing)
        tab.evaluate("() => device.controllers.right.updateAxes('thumbstick', 1, 0)")
        tab.wait_for_function(f"{bearing} < {faced} - 0.5")
        stood = place(tab)
        tab.evaluate("() => device.controllers.left.updateAxes('thumbstick', 0, -1)")
        until(lambda: np.linalg.norm(np.subtract(place(tab), stood)) > 0.2, "the left stick walks")
        tab.evaluate("() => player.view.renderer.xr.getSession().end()")
        tab.wait_for_function("!player.view.renderer.xr.isPresenting")
        assert wrong == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["policies.return=expert"], r"policy='expert': export= takes a run folder"),
        (["human=pair"], r"human.others=passer_by: a page of export= has human.others=\{\} alone"),
        (["cell=varied"], r"cell.vary.layouts=\d+: a page of export= has cell.vary.layouts=0 alone"),
        (["human.clipping=full"], r"human.clipping=full: a page of export= has human.clipping=off alone"),
        ([*SORTING, "task=shift"], r"task=shift: a page of export= shows one policy"),
        ([*SORTING, "task=sort"], r"task=sort: a page of export= shows one policy"),
        (
            [*SORTING, "task=sort", "meta_controller=cautious"],
            r"meta_controller=cautious: a page of export= runs options in order",
        ),
    ],
)
def test_what_a_page_cannot_show_is_refused(words: list[str], message: str) -> None:
    config = compose("studio", words if words[0] in SORTING else [*WORDS, *words])
    assert isinstance(config, StudioConfig)
    with pytest.raises(ConfigError, match=message):
        content.refuse(config)


def test_the_page_holds_the_licences_of_the_software_inside(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert "Apache License" in text and "three.js authors" in text and "Qhull" in text
    assert "Andreas Verleysen" in text and "ROS Industrial Consortium" in text  # of the meshes of the arm


def test_a_page_without_its_program_says_how_to_build_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "BUNDLE", ("missing.js", "missing.wasm", "missing.txt"))
    with pytest.raises(ConfigError, match=r"the page's program is not built; run make page"):
        page.export_page(configured(f"export={tmp_path / 'page.html'}"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "function",
    [
        lambda x: x.long() + 1,
        lambda x: torch.linalg.vector_norm(x, 1.0, dim=-1),
        lambda x: x[torch.tensor([0]), torch.tensor([1])],
        lambda x: x.cumsum(0),
        lambda x: x.sort(descending=True).values,
        lambda x: x[None][:, torch.tensor([0]), torch.tensor([1])],
        lambda x: x.min(),
    ],
)
def test_what_the_page_would_compute_otherwise_is_refused(function: Callable[[torch.Tensor], torch.Tensor]) -> None:
    class Graph(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            return function(x)

    with pytest.raises(ConfigError, match="the page cannot compute"):
        traced(Graph(), SimpleNamespace(tcp_pos=torch.ones(1, 3)), ["tcp_pos"])  # type: ignore[arg-type]
