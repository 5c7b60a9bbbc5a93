"""The page's rated drive, shield and contacts are those of Python, and so is what policies with sight see."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import CONTROL_STEP_S, ConfigError, StudioConfig
from hrl_comfort.files.run_config import environment

pytest.importorskip("viser", reason="the extra [studio] is not installed")

from hrl_comfort.agents.networks import Actor, Normaliser
from hrl_comfort.policies.actor import save_policy
from hrl_comfort.policies.load import make_policy
from hrl_comfort.safety.clearance import Clearance
from hrl_comfort.safety.drive import SetPoints, make_drive
from hrl_comfort.safety.separation import Separation
from hrl_comfort.safety.shield import Memory
from hrl_comfort.scene.human import limb_poses
from hrl_comfort.scene.workcell import build_scene
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.people import share_walked
from hrl_comfort.sim.variation.layouts import tops
from hrl_comfort.studio.session import Session
from hrl_comfort.studio.web import content
from hrl_comfort.studio.web.arrays import recorded
from hrl_comfort.studio.web.safety import safety

REFERENCE = Path("runs/reference/comfort_shift/levels0")
SHIELDED = ["robot.rating=collaborative", "safety=ssm", "task.terminate_on=unsafe_contact"]
CHAIN = [*(f"policies.{name}={REFERENCE / name}" for name in ("pick", "place", "return")), "meta_controller=nearest"]
SEEING = [
    *SHIELDED, "task=cycle", "task.observation=sight", "safety.clearance_m=0.01", "task.arrival_speed_rad_s=0.5",
    "human=mixture",
]  # fmt: skip
"""World for which the released skills are made."""
HERE = Path(__file__).parent
STEPS = 200
"""Control steps, of 20 ms, of the episode that is played."""
SPEEDING_UP = 20
"""Control steps at its beginning in which the rating alone passes less than the whole speed."""


def in_node(**given: Any) -> Any:
    """Return what `play.mjs` makes of `given`."""
    if shutil.which("node") is None or not Path("hrl_comfort/studio/web/node_modules/@mujoco").exists():
        pytest.skip("the page's packages are not installed: make page")
    done = subprocess.run(
        ["node", str(HERE / "play.mjs")], input=json.dumps(given, allow_nan=False), capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def rows_of(**fields: NDArray[np.float64]) -> list[dict[str, Any]]:
    """Return the states of fields (N, ...) as the page has them."""
    return [
        {name: {"shape": value.shape[1:], "data": value[row].ravel().tolist()} for name, value in fields.items()}
        for row in range(len(next(iter(fields.values()))))
    ]


@pytest.mark.parametrize(("bound", "clearance", "states"), [("observed", "null", 1000), ("worst", "0.02", 200)])
def test_drive_and_contacts_of_the_page_are_those_of_python_in_random_states(
    bound: str, clearance: str, states: int
) -> None:
    safe = [f"safety.bound={bound}", f"safety.clearance_m={clearance}"]
    env = environment(compose("evaluate", ["task=cycle", "policy=expert", *SHIELDED, *safe]))
    scene = build_scene(env.robot, env.cell, env.engine.substeps, env.task.objects)
    graphs = safety(scene, env, humans.begin(env.human, np.array([[0.8, 0.2]])))
    separation = Separation(scene)
    drive = make_drive(scene, separation, env, states)
    assert drive is not None and drive.shield is not None
    rng, (low, high) = np.random.default_rng(0), scene.joint_range.T
    angles = np.clip(scene.home + 0.8 * rng.normal(size=(states, len(low))), low + 0.05, high - 0.05)
    velocity, asked = 0.5 * rng.normal(size=angles.shape), rng.normal(size=angles.shape)
    radius, bearing, yaw, phase = rng.uniform([[0.2], [-3], [-3], [-3]], [[1.2], [3], [3], [3]], (4, states))
    x, y = radius * np.cos(bearing), radius * np.sin(bearing)
    swing = np.full(states, 0.3)
    limbs = limb_poses(x, y, yaw, phase, swing, scene.floor_z)
    earlier = limb_poses(x + 0.02 * rng.normal(size=states), y, yaw, phase, swing, scene.floor_z)
    trail = rng.uniform(0, 0.6, (states, len(separation.arm.radius), 1))
    behind = np.where(rng.random((states, 1)) < 0.1, 0.3, 0.03) * rng.normal(size=angles.shape)
    measured = np.concatenate([angles - behind, velocity - rng.normal(size=angles.shape) * 0.1], axis=1)

    now = separation.encounter(measured[:, :6], limbs)
    drive.shield.memory = Memory(separation.person.ends(earlier), trail.transpose(1, 2, 0).copy())
    reach = drive.shield.reach(now, velocity)
    before = SetPoints.unshielded(angles, velocity, np.zeros(states, np.int64))
    standing = np.tile(tops(env.cell, *np.split(scene.layout, [len(env.cell.places)])), (states, 1, 1))
    begin, after = drive.step(before, asked, measured, now, tops=standing)
    room, gap = separation.gap(measured[:, :6], earlier), now.apart.min(axis=0)
    assert after.braking.any() and (gap < 0).any() and ((after.share > 0) & (after.share < 1)).any()
    assert (begin != angles).any() and (begin == angles).all(axis=1).any()
    apart, speed = separation.pairs(measured[:, :6], measured[:, 6:], limbs)
    fields = {"joint_target": angles, "target_vel": velocity, "asked": asked, "limbs": limbs, "limbs_before": earlier}
    fields |= {"joint_pos": measured[:, :6], "joint_vel": measured[:, 6:]}
    rows = rows_of(**{name: value[:, None] for name, value in fields.items()}, trail=trail[..., None])
    wanted = {
        "drive": {
            "begin": begin, "joint_target": after.angles, "target_vel": after.velocity, "share": after.share,
            "reach": reach, "braking": after.braking, "trail": drive.shield.memory.trail.transpose(2, 0, 1),
        },
        "gap": {"gap": gap},
        "walked": {"share": share_walked(room, gap)},
        "pairs": {"apart": apart.transpose(2, 0, 1), "speed": speed.transpose(2, 0, 1)},
    }  # fmt: skip
    for graph, outputs in wanted.items():
        made = in_node(graph=graphs[graph], rows=rows)
        for name, value in outputs.items():
            theirs = np.array([row[name] for row in made], dtype=float)
            assert np.abs(theirs - value.reshape(states, -1)).max() < 1e-9, (graph, name)


@pytest.fixture(scope="module")
def config() -> StudioConfig:
    made = compose("studio", [*CHAIN, "task=cycle", "human=mixture", *SHIELDED])
    assert isinstance(made, StudioConfig)
    return made


@pytest.fixture(scope="module")
def page(config: StudioConfig) -> dict[str, Any]:
    """The content of a page with an episode of which STEPS control steps are recorded."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(content, "EPISODES", 1)
        patch.setattr(content, "RECORDED_S", STEPS * CONTROL_STEP_S)
        return content.content(config)


def test_joints_go_behind_the_shield_where_they_go_in_python(config: StudioConfig, page: dict[str, Any]) -> None:
    (theirs,) = in_node(content=page, steps=STEPS)
    session = Session(config)
    session.set_level(session.slider.value)
    session.reset()
    path = [session.still().joints]
    while sum(map(len, path)) <= STEPS:
        step = session.step()
        assert not step.over and not bool(step.result.state.contact)  # they step back in Python alone
        path.append(step.clip.joints[1:])
    session.close()
    assert min(theirs["shares"][SPEEDING_UP:]) < 0.9 and theirs["touched"] is None
    assert len(theirs["joints"]) == STEPS + 1
    assert np.abs(np.concatenate(path)[: STEPS + 1] - np.array(theirs["joints"])).max() < 1e-6


def test_an_arm_slows_beside_a_person_by_hand_and_is_touched_slowly(page: dict[str, Any]) -> None:
    (episode,) = in_node(content=page, steps=STEPS, hand=[0.05, -0.3])
    assert min(episode["shares"][SPEEDING_UP:]) < 0.5 and episode["touched"] is not None
    assert not episode["unsafe"] and episode["outcome"] is None


@pytest.fixture(scope="module")
def seeing(tmp_path_factory: pytest.TempPathFactory) -> StudioConfig:
    """A studio of a policy with sight that has not learned, drawn so that the arm comes near tables and people."""
    file = tmp_path_factory.mktemp("seeing") / "policy.pt"
    return drawn_policy(file, [*SEEING, "task.max_episode_steps=150"], seed=12, observation="sight")


def drawn_policy(file: Path, words: list[str], seed: int, **trained: Any) -> StudioConfig:
    """Write a policy of a shielded cycle with random weights, in the environment `trained`; return a studio of it."""
    made, rng = compose("studio", [*words, f"policy={file}"]), np.random.default_rng(seed)
    assert isinstance(made, StudioConfig)
    engine = Engine(environment(made), 1, 0)
    engine.reset()
    size, actions = engine.episodes.observe().shape[1], engine.episodes.action_dim
    engine.close()
    actor, normaliser = Actor(size, actions, [16]), Normaliser(size, False)
    for weights in actor.parameters():
        drawn = rng.normal(size=weights.shape) / np.sqrt(weights.shape[-1])
        weights.data = torch.from_numpy(drawn).float()
    env = {"action_repeat": 5, "action": "joint", "robot": "ur3e", "shield": True, **trained}
    spec = {"task": "cycle", "observation_dim": size, "action_dim": actions, "hidden": [16], "normalise": False}
    networks = {"actor": actor.state_dict(), "normaliser": normaliser.state_dict()}
    save_policy(file, networks, {**spec, "environment": env}, critics=False)
    return made


@pytest.fixture(scope="module")
def seeing_page(seeing: StudioConfig) -> dict[str, Any]:
    """The content of its page, of two episodes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(content, "EPISODES", 2)
        patch.setattr(content, "RECORDED_S", 150 * CONTROL_STEP_S)
        return content.content(seeing)


def test_joints_of_a_policy_with_sight_go_where_they_go_in_python_for_whole_episodes(
    seeing: StudioConfig, seeing_page: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    slides, damped = list[bool](), Clearance.damped

    def watched(clearance: Clearance, *given: NDArray[np.float64]) -> NDArray[np.float64]:
        passed = damped(clearance, *given)
        slides.append(bool(np.abs(passed - given[1]).max() > 1e-3))
        return passed

    monkeypatch.setattr(Clearance, "damped", watched)
    session, shares = Session(seeing), list[float]()
    session.set_level(session.slider.value)
    for played in in_node(content=seeing_page, steps=STEPS):
        session.reset()
        path = [session.still().joints]
        while not session.over:
            step = session.step()
            assert not bool(step.result.state.contact)  # they step back in Python alone
            path.append(step.clip.joints[1:])
        ours, theirs = np.concatenate(path), np.array(played["joints"])
        assert len(ours) == 151 and played["outcome"] == step.outcome == "out of time"
        assert np.ptp(ours, axis=0).max() > 0.5
        assert np.abs(ours - theirs).max() < 1e-6
        shares += played["shares"][SPEEDING_UP:]
    session.close()
    assert any(slides) and min(shares) < 0.8


def test_a_policy_with_sight_sees_and_does_on_the_page_what_it_does_in_python(
    seeing: StudioConfig, seeing_page: dict[str, Any]
) -> None:
    rows, rng = 40, np.random.default_rng(0)
    engine = Engine(environment(seeing), rows, 0)
    act = make_policy(str(seeing.policy), engine.episodes.subtask, engine.scene, environment(seeing), 0)
    state, (option,) = engine.reset(), seeing_page["options"]
    names = option["graph"]["inputs"].values()
    for _ in range(3):
        before = engine.episodes.people.now.limbs
        result = engine.step(rng.uniform(-1, 1, (rows, 6)))
        state = result.state.with_(stage=torch.from_numpy(rng.integers(0, 5, rows)))
        since = result.decision_steps.numpy() * CONTROL_STEP_S
        limbs = {"limbs": engine.episodes.people.now.limbs, "limbs_before": before}
        given = {"joint_pos": state.joint_pos.numpy(), **limbs}
        seen = in_node(
            graph=seeing_page["safety"]["bodies"],
            rows=rows_of(**{name: value[:, None] for name, value in given.items()}, since=since[:, None]),
        )
        for name in ("arm_body", "humans_body", "humans_body_vel"):
            theirs = np.array([row[name] for row in seen])
            assert np.abs(theirs - getattr(state, name).numpy().reshape(rows, -1)).max() < 1e-9, name
        acted = in_node(
            graph=option["graph"], rows=rows_of(**{name: getattr(state, name)[:, None].numpy() for name in names})
        )
        made = np.array([row["made"] for row in acted]) / np.radians(seeing.task.max_step_deg)
        assert np.abs(made - act(state).numpy()).max() < 1e-5
    engine.close()


def test_a_function_that_the_page_does_not_know_is_refused() -> None:
    example = {"x": np.ones(3)}
    for function in (np.arctan2, np.median):
        with pytest.raises(ConfigError, match=f"the page cannot compute numpy's {function.__name__}"):
            recorded(lambda x, function=function: {"y": function(x, x)}, example)
