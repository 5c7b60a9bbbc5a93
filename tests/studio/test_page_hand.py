"""The page's hand is that of Python: its fingers, what holds and loses an object, and what policies see of both."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, StudioConfig
from hrl_comfort.files.run_config import environment

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.policies.load import make_policy
from hrl_comfort.scene import build_scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.hand.fingers import Fingers
from hrl_comfort.sim.hand.sensors import HandSensors
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.web import content
from hrl_comfort.studio.web.hand import begun, hand
from hrl_comfort.tasks import State
from tests.studio.test_page_safety import drawn_policy, in_node, rows_of

EPISODES = 2
WORDS = ["task=cycle", "cell=grasp", "human=still", "task.max_step_deg=1", "task.object_jitter_m=0.07",
         "task.precision.place_tolerance_m=0.05", "robot.rating=collaborative", "safety=ssm",
         "task.terminate_on=unsafe_contact"]  # fmt: skip
WATCHED = ("ground", "aloft_steps", "free_steps", "pads", "objects_quat", "objects_vel", "grip", "grip_vel", "tcp_quat")


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> StudioConfig:
    """A studio of a policy of seven actions that has not learned."""
    file = tmp_path_factory.mktemp("hand") / "policy.pt"
    return drawn_policy(file, WORDS, seed=2, observation="default", gripper="two_finger")


@pytest.fixture(scope="module")
def page(config: StudioConfig) -> dict[str, Any]:
    """The content of its page."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(content, "EPISODES", EPISODES)
        patch.setattr(content, "RECORDED_S", 0.1)
        return content.content(config)


def test_joints_go_where_they_go_in_python_for_whole_episodes(config: StudioConfig, page: dict[str, Any]) -> None:
    session, shares = Session(config), list[float]()
    session.set_level(session.slider.value)
    for played in in_node(content=page, steps=250):
        session.reset()
        path = [session.still().joints]
        while not session.over and sum(map(len, path)) <= 250:
            path.append(session.step().clip.joints[1:])
        ours, theirs = np.concatenate(path)[:251], np.array(played["joints"])
        assert len(ours) == len(theirs) and np.ptp(ours, axis=0).max() > 0.3
        assert np.abs(ours - theirs).max() < 1e-6
        shares += played["shares"][20:]  # before, the rating alone passes less
    session.close()
    assert min(shares) < 0.9


def test_the_command_takes_a_hand(config: StudioConfig) -> None:
    asked = compose("studio", [*WORDS, "gripper=two_finger", f"policy='{config.policy}'", "export=page.html"])
    assert isinstance(asked, StudioConfig) and asked.robot.gripper.holds and asked.export == "page.html"


def test_fingers_and_objects_are_drawn(config: StudioConfig, page: dict[str, Any]) -> None:
    scene = build_scene(config.robot, config.cell, environment(config).substeps)
    drawn = {scene.model.body(look["body"]).name for look in page["looks"]}
    assert scene.gripper is not None
    assert drawn >= {*scene.loose, *(f"robot/{pad}" for pad in scene.gripper.pads)}


class Shown(SimpleNamespace):
    """An episode of an expert: actions as the page takes them, states of every control step, success."""

    actions: list[list[float]]
    states: list[State]
    success: bool

    @property
    def touch(self) -> int:
        """Control step in which a finger touches the object first."""
        return next(k for k, state in enumerate(self.states) if bool(state.pads.any()))

    def path(self, name: str) -> np.ndarray:
        """Return a field of the states (K, ...)."""
        return np.concatenate([getattr(state, name).numpy() for state in self.states])


@pytest.fixture(scope="module")
def shown(config: StudioConfig) -> list[Shown]:
    """Whole cycles of the scripted expert."""
    env, found = environment(config), []
    session = Session(config)
    scale = np.append(np.full(6, np.radians(env.task.max_step_deg)), 1.0)
    for _ in range(EPISODES):
        session.reset()
        engine, done = session.engine, False
        act = make_policy("expert", engine.episodes.subtask, engine.scene, env, 0)
        one = Shown(actions=[], states=[session.state], success=False)
        while not done:
            action = act(session.state).numpy().clip(-1, 1)
            one.actions.append((action[0] * scale).tolist())
            result = engine.step(action)
            one.states += result.steps[: int(result.decision_steps)]
            done, one.success = bool(result.done), bool(result.success)
        found.append(one)
    session.close()
    return found


def test_a_cycle_with_a_grasp_goes_on_the_page_as_in_python(page: dict[str, Any], shown: list[Shown]) -> None:
    played = in_node(content=page, steps=1000, actions=[each.actions for each in shown])
    for ours, theirs in zip(shown, played, strict=True):
        assert ours.success and theirs["outcome"] == "success"
        assert theirs["held"] == ours.touch
        upto = slice(ours.touch + 1)
        assert np.abs(np.array(theirs["joints"])[upto] - ours.path("joint_pos")[upto]).max() < 1e-6
        assert np.abs(np.array(theirs["objects"])[upto] - ours.path("objects")[upto, 0]).max() < 1e-6
        assert np.abs(np.array(theirs["grips"])[upto] - ours.path("grip")[upto]).max() < 1e-6
        # A contact may magnify rounding.
        assert abs(len(theirs["joints"]) - len(ours.states)) <= 25
        assert np.abs(np.array(theirs["objects"])[-1] - ours.path("objects")[-1, 0]).max() < 0.01


def test_a_policy_sees_and_does_on_the_page_what_it_does_in_python(
    config: StudioConfig, page: dict[str, Any], shown: list[Shown]
) -> None:
    env, (option,) = environment(config), page["options"]
    engine = Engine(env, 1, 0)
    act = make_policy(str(config.policy), engine.episodes.subtask, engine.scene, env, 0)
    engine.close()
    names = option["graph"]["inputs"].values()
    states = [state for each in shown for state in each.states[::7]]
    assert any(bool(state.pads.all()) for state in states)
    rows = [
        row for state in states for row in rows_of(**{name: getattr(state, name)[:, None].numpy() for name in names})
    ]
    made = np.array([row["made"] for row in in_node(graph=option["graph"], rows=rows)])
    made[:, :6] /= np.radians(env.task.max_step_deg)
    assert np.abs(made - np.concatenate([act(state).numpy() for state in states])).max() < 1e-5


def test_fingers_follow_commands_as_in_python(config: StudioConfig) -> None:
    env, rng = environment(config), np.random.default_rng(0)
    scene = build_scene(env.robot, env.cell, env.substeps)
    fingers, before, command = Fingers(scene), rng.random(50), rng.uniform(-1, 1, 50)
    after, graph = fingers.follow(before, command), hand(scene, env)["fingers"]
    made = in_node(graph=graph, rows=rows_of(grip_target=before[:, None], command=command[:, None]))
    assert np.abs([row["grip_target"][0] for row in made] - after).max() < 1e-12
    ramp = fingers.ramp(before, after, env.substeps)
    assert np.abs([row["control"] for row in made] - ramp[..., 0]).max() < 1e-12


def test_the_page_watches_an_object_as_the_sensors_do_whatever_they_read(config: StudioConfig) -> None:
    rows, steps, rng = 60, 80, np.random.default_rng(0)
    engine = Engine(environment(config), rows, 0)
    before, scene = engine.reset(), engine.scene
    engine.close()
    at, kinds = scene.sensors, len(scene.cell.objects)
    sensed = rng.normal(size=(rows, steps, scene.model.nsensordata))
    sensed[..., at["time"]] = (np.arange(1, steps + 1) * CONTROL_STEP_S)[:, None]
    sensed[0, 30:, at["time"]] -= 31 * CONTROL_STEP_S  # the physics begins again
    lasting = np.cumsum(rng.random((rows, steps, 1, 2)) < 0.15, axis=1) % 2
    touches = np.repeat(lasting, kinds, axis=2)
    sensed[..., at["pads"]] = touches.reshape(rows, steps, -1)
    height = np.array([0.0, 0.01, 0.05, 0.12, 0.2, -0.6])
    level = np.repeat(rng.choice(6, (rows, steps // 8), p=[0.2, 0.2, 0.2, 0.2, 0.18, 0.02]), 8, axis=1)
    place = np.repeat(before.objects.numpy(), steps, axis=1)
    place[..., 2] += height[level]
    place[: rows // 3, :, 0] += 0.1 * np.arange(steps)  # out of reach, carried or not
    place[1, 20, 1] += 2.0  # flung
    sensed[..., at["object_pos"]] = np.repeat(place[:, :, None], kinds, axis=2).reshape(rows, steps, -1)
    ours = HandSensors(scene).decision(sensed, before)
    names = ("time", "hand_pos", "hand_vel", "tcp_quat", "object_pos", "object_quat", "object_vel", "pads")
    played = in_node(
        hand=hand(scene, environment(config)),
        step=CONTROL_STEP_S,
        episodes=[
            {
                "begun": {**begun(before.rows(torch.tensor([row]))), "kind": int(before.kinds[row, 0])},
                "place": before.objects[row, 0].tolist(),
                "readings": [{name: reading[at[name]].tolist() for name in names} for reading in sensed[row]],
            }
            for row in range(rows)
        ],
    )
    ends = set()
    for row, theirs in enumerate(played):
        lost = ours["object_lost"][row]
        until = int(lost.argmax()) if lost.any() else steps
        assert theirs["lost"] == lost[: until + 1].tolist()
        ends.add((bool(lost.any()), bool(ours["diverged"][row].any())))
        for name in WATCHED:
            made = np.array([fields[name]["data"] for fields in theirs["fields"][:until]], dtype=float)
            assert np.abs(made - ours[name][row, :until].reshape(until, -1)).max() < 1e-12, name
    assert ends == {(False, False), (True, False), (True, True)}
    assert ours["aloft_steps"].max() > 9 and ours["carried"].any() and not ours["carried"].all()
