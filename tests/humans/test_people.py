"""Several people in a cell: each walks as they would alone, and everything that counts people counts all of them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from hrl_comfort import humans
from hrl_comfort.composition.compose import compose, compose_environment
from hrl_comfort.config import ConfigError, EnvConfig
from hrl_comfort.evaluation.rollout import rollout
from hrl_comfort.hierarchy.observation import nearness
from hrl_comfort.humans.retreat import RETREAT_STEPS
from hrl_comfort.policies.potential_field import PotentialField
from hrl_comfort.policies.scripted import nearest_person, standing_limbs
from hrl_comfort.safety.allowances import people_of
from hrl_comfort.safety.geometry import farthest
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.human import LIMBS
from hrl_comfort.scene.workcell import scene_of
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.people import OVERLAP_M, Crowd, stop_at_contact
from hrl_comfort.tasks.observations.standard import human, human_from_tool, nearest_alone
from tests.humans.around import around

SHIELDED = ("safety=ssm", "robot.rating=collaborative", "task.terminate_on=unsafe_contact")
SECOND = "+human.others.second="
PAGE = Path(__file__).parents[2] / "docs" / "bring_your_own.md"


def configured(*words: str) -> EnvConfig:
    return compose_environment("train", [*words])


def courses(engine: Engine, decisions: int, speed: float = 0.0) -> np.ndarray:
    """Return where the people (N, T, P, 2) m of some decisions are; the first joint moves at `speed`."""
    found, action = [], np.zeros((engine.num_envs, engine.episodes.action_dim))
    action[:, 0] = speed
    for _ in range(decisions):
        found.append(engine.step(action).instants.humans_pos.numpy())
    return np.concatenate(found, axis=1)


# ---- who is there --------------------------------------------------------------------------------------


def test_each_person_is_the_first_with_some_keys_replaced() -> None:
    config = configured("human=mixture", "human.speed_m_s=0.7", SECOND + "{motion: worker, stations_m: [[1.0, 0.0]]}")
    first, second = config.human.everyone
    assert (first.motion, second.motion, first.others, second.mixture) == ("mixture", "worker", {}, {})
    assert second.speed_m_s == 0.7 and second.stations_m == [[1.0, 0.0]] and first.stations_m is None
    assert config.human.motions == "mixture+worker"
    assert [each.motion for each in people_of(config.human)] == [*first.mixture, "worker"]


def test_a_mixture_may_be_among_the_others() -> None:
    words = "human=still", SECOND + "{motion: mixture, mixture: {patrol: {speed_m_s: 0.9}, arc: {}}}"
    config = configured(*words, "human.stations_m=[[1.0,0.0],[0.0,1.0]]")
    assert [each.speed_m_s for each in config.human.everyone[1].people] == [0.9, 0.5]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("human=pair", SECOND + "{}", "+human.others.third={}"), "are 4 people with the first; a cell has 3 at most"),
        (("human=none", SECOND + "{motion: still}"), "motion=none is nobody; choose a motion for the first"),
        (("human=pair", SECOND + "{motion: none}"), r"human.others.second.motion=none is nobody"),
        (("human=pair", SECOND + "{motion: live}"), r"human.others.second.file=null: only the first"),
        (("human=pair", SECOND + "{clipping: full}"), r"human.others.second.clipping cannot be changed"),
        (("human=pair", SECOND + "{colour: red}"), r"human.others.second.colour cannot be changed"),
        (("human=pair", SECOND + "{speed_m_s: 9}"), r"human.others.second: speed_m_s=9.0 is outside"),
        (("human=nobody.yaml",), r"human=nobody.yaml: there is no such file; give one, or choose one of "),
    ],
)  # fmt: skip
def test_people_who_cannot_be_are_refused(words: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        configured(*words)
    assert len(str(caught.value).splitlines()) == 1


def test_a_second_person_faster_than_the_shield_assumes_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"human.speed_m_s=2 is more than the shield assumes"):
        Engine(configured("human=pair", "human.others.passer_by.speed_m_s=2.0", *SHIELDED), 1, 0)


def test_a_second_person_works_while_the_first_walks_by_one_file(tmp_path: Path) -> None:
    text = re.search(r"```yaml\n(# shop_floor\.yaml\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert text is not None and len(text[1].splitlines()) <= 40
    (tmp_path / "shop_floor.yaml").write_text(text[1])
    config = configured(f"human='{tmp_path}/shop_floor.yaml'", "task=pick")
    assert config.human.motions == "patrol+worker"
    engine = Engine(config, 8, 0)
    engine.reset()
    walked = courses(engine, 150)
    way = np.linalg.norm(np.diff(walked, axis=1), axis=-1).sum(axis=1)
    assert (way[:, 0] > 1.0).all(), "the first walks"
    late = np.linalg.norm(walked[:, -1, 1] - walked[:, -100, 1], axis=-1)
    assert np.median(late) < 0.01, "the second is at a table"
    reaching = engine.episodes.people.now.walks[1].limbs
    assert np.isfinite(reaching[:, 2:]).all(), "and reaches into it"


# ---- bodies --------------------------------------------------------------------------------------------


def test_each_person_has_a_body_with_sensors_of_its_own() -> None:
    config = configured("human=pair", SECOND + "{motion: still}")
    scene = scene_of(config)
    assert scene.limbs[: len(LIMBS)] == LIMBS and scene.limbs[-1] == "right_forearm_3"
    assert scene.mocap[: len(scene.limbs)] == scene.limbs and scene.first_prop == 21 + len(scene.furniture)
    human_sensors = scene.sensors["human"]
    assert human_sensors.stop - human_sensors.start == 21
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.home
    mujoco.mj_forward(scene.model, data)
    tool = data.site("robot/tcp").xpos.copy()
    for index, limb in enumerate(scene.limbs):
        data.mocap_pos[: len(scene.limbs), 0] = 50.0
        data.mocap_pos[index] = tool
        mujoco.mj_forward(scene.model, data)
        assert np.flatnonzero(data.sensordata[human_sensors]).tolist() == [index], limb


def test_the_persons_of_the_shield_are_the_capsules_of_everybody() -> None:
    config = configured("human=pair")
    engine = Engine(config, 16, 0)
    engine.reset()
    separation, limbs = Separation(engine.scene), engine.episodes.people.now.limbs
    parts = np.split(limbs, 2, axis=1)
    ends = [person.ends(part) for person, part in zip(separation.each, parts, strict=True)]
    assert np.array_equal(separation.person.ends(limbs), np.concatenate(ends, axis=1))
    alone = Separation(scene_of(configured("human=worker")))
    angles = np.tile(engine.scene.home, (16, 1))
    apart = np.min([alone.gap(angles, np.ascontiguousarray(part)) for part in parts], axis=0)
    assert np.array_equal(separation.gap(angles, limbs), apart)


# ---- walks ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("split", [None, "paper", "test"])
@pytest.mark.parametrize("first", ["mixture", "random_walk"])
def test_the_first_person_is_the_same_with_and_without_others(first: str, split: str | None) -> None:
    entries = None if split is None else humans.split_set(split, 6)
    more = SECOND + "{motion: still}", "+human.others.third={motion: approach}"
    engines = [Engine(configured("task=pick", f"human={first}", *words), 6, 3, entries) for words in ((), more)]
    states = [engine.reset() for engine in engines]
    for name in ("joint_pos", "objects", "level", "points"):
        assert torch.equal(getattr(states[0], name), getattr(states[1], name)) or states[0].level.isnan().all()
    alone, among = (courses(engine, 12, 0.2) for engine in engines)
    assert alone.shape[2] == 1 and among.shape[2] == 3
    assert np.array_equal(alone[:, :, 0], among[:, :, 0])


def test_a_person_walks_beside_others_as_alone() -> None:
    """Made by hand of the same draws; a decision in which the arm is touched ends early."""
    config = configured("human=pair")
    engine = Engine(config, 8, 0)
    engine.reset()
    draw, second = engine.episodes.draw, config.human.everyone[1]
    walk = humans.begin(second, draw.spawn[:, 1], draw.traits[:, 1])
    discs = engine.episodes.sampler.keep_out(draw.points, draw.goals)
    going = np.ones(8, dtype=bool)
    for decision in range(20):
        tool = engine.episodes.state.tcp_pos.numpy()[:, :2]
        result = engine.step(np.zeros((8, 6)))
        going &= ~result.done.numpy()
        for step in range(5):
            walk = humans.advance(second, walk, draw.noise[:, 5 * decision + step, 1], around(tool, discs))
            passed = result.instants.humans_pos.numpy()[:, step, 1]
            np.testing.assert_allclose(passed[going], walk.position[going], atol=1e-9)
    assert going.sum() > 5


def test_people_begin_apart_and_by_draws_of_their_own() -> None:
    words = "task=pick", "human=mixture", SECOND + "{}", "+human.others.third={motion: patrol}"
    for split in (None, "validation", "test"):
        entries = None if split is None else humans.split_set(split, 150)
        state = Engine(configured(*words), 150, 0, entries).reset()
        places = state.humans_pos
        apart = torch.cdist(places, places) + 9 * torch.eye(3).double()
        assert apart.min() >= humans.APART_M[0]
        assert len(torch.unique(places.reshape(-1, 2), dim=0)) == 450, "everybody has draws of their own"


def test_a_ring_without_room_for_everybody_is_refused() -> None:
    words = "human=still", SECOND + "{}", "human.spawn=anywhere", "human.spawn_radius_m=[0.1,0.11]"
    keep = "human.held_out=[]", "human.keep_out_m=0.0", "human.partitioned=true"
    with pytest.raises(ConfigError, match=r"spawn_radius_m=\[0.1, 0.11\] has no room for 3 people 0.3 m apart; widen"):
        Engine(configured(*words, *keep, "+human.others.third={}"), 200, 0, humans.split_set("validation", 200)).reset()


def test_evaluations_repeat_the_motion_of_everybody_whatever_the_task() -> None:
    entries = humans.load_evaluation_set().part(0, 6)
    found = []
    for task in ("pick", "return"):
        engine = Engine(configured(f"task={task}", "human=random_walk", SECOND + "{}"), 6, 0, entries)
        engine.reset()
        found.append(np.diff(courses(engine, 2), axis=1))
    np.testing.assert_allclose(found[0][:, :, 1], found[1][:, :, 1], atol=0.03)
    free = (np.abs(found[0] - found[1]) < 1e-12).all(axis=-1)
    assert free[:, :, 1].mean() > 0.8, "steps differ at keep-out discs alone"


def test_who_touches_the_arm_stops_and_steps_back_alone() -> None:
    config = configured("human=random_walk", SECOND + "{}")
    engine = Engine(config, 1, 0)
    scene, separation = engine.scene, Separation(engine.scene)
    angles = scene.home[None]
    tool = separation.arm.tool(angles)[0]
    outwards = tool[:2] / np.linalg.norm(tool[:2])
    places = [1.2 * np.array([-outwards[1], outwards[0]])[None], (tool[:2] + 0.6 * outwards)[None]]
    walks = [humans.begin(each, place) for each, place in zip(config.human.everyone, places, strict=True)]
    crowd = engine.episodes.people.crowd(walks)
    for _ in range(100):
        now = separation.encounter(angles, crowd.limbs)
        ahead = [walk.rows(np.array([0])) for walk in crowd.walks]
        ahead = [humans.Walk(**{**vars(walk), "position": walk.position - 0.01 * outwards}) for walk in ahead]
        before = crowd
        leaves = [lambda walk: np.ones(len(walk.yaw), dtype=bool)] * 2
        crowd, way = stop_at_contact(scene, separation, now, before, ahead, leaves)
        assert way >= farthest(crowd.ends, before.ends).max()
        if crowd.walks[1].retreat[0]:
            break
    assert crowd.walks[1].retreat[0] == RETREAT_STEPS and crowd.walks[0].retreat[0] == 0
    gap = separation.gap(angles, crowd.limbs)[0]
    assert gap == pytest.approx(-OVERLAP_M, abs=1e-4) and (crowd.walks[1].velocity == 0).all()
    np.testing.assert_allclose(crowd.walks[0].position, before.walks[0].position - 0.01 * outwards)
    np.testing.assert_array_equal(crowd.limbs, np.concatenate([limbs_of(scene, walk) for walk in crowd.walks], axis=1))


def test_cells_of_two_people_go_on_exactly_where_they_were_saved() -> None:
    config = configured("task=shift", "human=pair", "randomise=sim_to_real", *SHIELDED, *ALLOWED)
    engines = [Engine(config, 6, 1) for _ in range(2)]
    for engine in engines:
        engine.reset()
    action = np.random.default_rng(0).uniform(-1, 1, (6, 6))
    for _ in range(5):
        engines[0].step(action)
    engines[1].load_state_dict(engines[0].state_dict())
    for _ in range(5):
        one, two = (engine.step(action).state for engine in engines)
        for name, value in one.fields().items():
            assert torch.equal(value.nan_to_num(), getattr(two, name).nan_to_num()), name


ALLOWED = (
    "safety.bound=worst", "safety.lag_s=0.23", "safety.latency_s=0.2", "safety.delay_s=0.3", "safety.margin_m=0.2",
)  # fmt: skip


def test_a_frame_of_the_tracker_holds_everybody() -> None:
    config = configured("human=pair", "randomise.person_noise_m=[0.02,0.02]", "randomise.person_rate_hz=[10,10]")
    engine = Engine(config, 8, 0)
    engine.reset()
    seen = np.concatenate([engine.step(np.zeros((8, 6))).instants.humans_seen.numpy() for _ in range(20)], axis=1)
    new = np.abs(np.diff(seen, axis=1)).max(axis=-1) > 0
    assert np.array_equal(new[..., 0], new[..., 1]) and 0.15 < new.mean() < 0.25
    state = engine.episodes.state
    assert (state.humans_seen - state.humans_pos).norm(dim=-1).max() < 0.06 + 0.1 * 1.2


def test_velocity_is_that_of_each_persons_axis() -> None:
    engine = Engine(configured("human=pair"), 8, 0)
    assert (engine.reset().humans_vel == 0).all()
    before = engine.episodes.state.humans_pos
    found = engine.step(np.zeros((8, 6))).instants
    places = torch.cat([before[:, None], found.humans_pos], dim=1)
    torch.testing.assert_close(found.humans_vel, places.diff(dim=1) / 0.02)
    assert found.humans_vel.norm(dim=-1).max() > 0.05


@pytest.mark.parametrize(("first", "then"), [("worker", "reactive"), ("fetcher", "patrol"), ("worker", "still")])
def test_who_goes_on_as_another_motion_has_the_memory_and_arms_of_its_beginning(first: str, then: str) -> None:
    config, other = configured("task=reach", f"human={first}"), configured(f"human={then}").human
    engine = Engine(config, 1, 0)
    engine.reset()
    people = engine.episodes.people
    memory = np.array([[3.76, 2.0, 1.0]])  # as of a cycle of reaching
    reaching = replace(people.now.walks[0], memory=memory, limbs=np.tile([0.0, 0.6, -0.8], (1, 6, 1)))
    people.stand(reaching)
    people.go_on_as(replace(config.human, stay_s=9.0))
    assert np.array_equal(people.now.walks[0].memory, memory), "the same motion goes on"
    people.go_on_as(other)
    walk = people.now.walks[0]
    np.testing.assert_array_equal(walk.memory, 0.0)
    np.testing.assert_array_equal(walk.limbs, humans.begin(other, walk.position).limbs)
    np.testing.assert_array_equal(walk.position, reaching.position)


def test_who_is_moved_by_hand_lowers_the_arms_that_they_have() -> None:
    engine = Engine(configured("task=reach", "human=worker"), 1, 0)
    engine.reset()
    people, limbs = engine.episodes.people, np.tile([0.0, 0.6, -0.8], (1, 6, 1))
    people.stand(replace(people.now.walks[0], limbs=limbs))
    people.go_on_as(configured("human=live").human)
    assert np.array_equal(people.now.walks[0].limbs, limbs)


# ---- what counts people --------------------------------------------------------------------------------


def test_distance_and_observation_are_of_the_nearest() -> None:
    engine = Engine(configured("task=pick", "human=pair", SECOND + "{motion: still}"), 32, 0)
    engine.reset()
    result = engine.step(np.zeros((32, 6)))
    state = result.state
    apart = (state.humans_pos - state.tcp_pos[:, None, :2]).norm(dim=-1)
    nearest = apart.argmin(dim=1)
    assert len(nearest.unique()) == 3
    torch.testing.assert_close(result.human_distance[:, -1], apart.amin(dim=1))
    alone = nearest_alone(state)
    assert torch.equal(alone.humans_pos[:, 0], state.humans_pos[torch.arange(32), nearest])
    for term in (human, human_from_tool, nearness):
        assert torch.equal(term(state), term(alone)), term.__name__
    place, yaw = nearest_person(state)
    np.testing.assert_array_equal(place, alone.humans_pos[:, 0].numpy())
    np.testing.assert_array_equal(yaw, alone.humans_yaw[:, 0].numpy())


def test_the_field_keeps_off_everybody() -> None:
    config = configured("task=pick", "human=still", SECOND + "{}")
    engine = Engine(config, 1, 0)
    state = engine.reset()
    policy = PotentialField(engine.scene, config, engine.episodes.subtask)
    far = torch.tensor([[2.0, 2.0]], dtype=torch.float64)
    beside = state.tcp_pos[:, :2] + torch.tensor([0.0, 0.3])
    actions = {}
    for name, pair in {"first": (beside, far), "second": (far, beside), "nobody": (far, far)}.items():
        actions[name] = policy.act(state.with_(humans_pos=torch.stack(pair, dim=1)))
    torch.testing.assert_close(actions["first"], actions["second"], atol=1e-6, rtol=0)
    assert not torch.allclose(actions["first"], actions["nobody"], atol=1e-3)
    assert standing_limbs(state, engine.scene.floor_z).shape == (1, 14, 7)


def test_tables_have_the_motions_of_all_and_the_distance_from_the_nearest() -> None:
    config = compose("evaluate", ["task=pick", "policy=random", "human=pair", "episodes=3", "record=true"])
    result = rollout(config)
    assert set(result.table["human"]) == {"worker+patrol"}
    distance = result.table["human_distance_min_m"].to_numpy(dtype=float)
    assert (distance < 3).all()


def test_crowds_of_some_rows_are_put_and_chosen() -> None:
    engine = Engine(configured("human=pair"), 4, 0)
    engine.reset()
    courses(engine, 1)
    people = engine.episodes.people
    last = np.array([0, 4, 2, 1])
    chosen = Crowd.chosen(people.course[1:], last)
    for row, k in enumerate(last):
        assert np.array_equal(chosen.places[row], people.course[1 + k].places[row])
        assert np.array_equal(chosen.limbs[row], people.course[1 + k].limbs[row])
        assert np.array_equal(chosen.ends[..., row], people.course[1 + k].ends[..., row])
    rows = np.array([1, 3])
    picked = Crowd(tuple(walk.rows(rows) for walk in chosen.walks), chosen.limbs[rows], chosen.ends[..., rows])
    put = people.course[0].put(rows, picked)
    assert np.array_equal(put.places[rows], chosen.places[rows])
    assert np.array_equal(put.ends, engine.episodes.separation.person.ends(put.limbs))
    assert np.array_equal(put.places[[0, 2]], people.course[0].places[[0, 2]])
