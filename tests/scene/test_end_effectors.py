"""An end effector of a user's own: it reaches, collides and counts for the shield; arms with their own refuse one."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from hrl_comfort.composition.compose import compose_environment
from hrl_comfort.config import ConfigError
from hrl_comfort.policies.load import make_policy
from hrl_comfort.safety.separation import Separation
from hrl_comfort.scene.layout import reach
from hrl_comfort.scene.workcell import build_scene, tool_at
from hrl_comfort.sim.engine import Engine

PAGE = Path(__file__).parents[2] / "docs" / "bring_your_own.md"
SNIPPETS = dict(re.findall(r"```python\n# (\w+)\.py\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))


@pytest.fixture(autouse=True)
def importable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("suction", "watching"):
        assert len(SNIPPETS[name].splitlines()) <= 40
        (tmp_path / f"{name}.py").write_text(SNIPPETS[name], encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))


def test_the_tool_of_an_end_effector_is_where_it_says_and_its_capsules_count_for_the_shield() -> None:
    own = compose_environment("train", ["robot.end_effector=suction:CUP", "human=none"])
    usual = compose_environment("train", ["human=none"])
    cup, gripper = (build_scene(each.robot, each.cell, each.engine.substeps) for each in (own, usual))
    assert np.linalg.norm(tool_at(cup, cup.home) - tool_at(gripper, gripper.home)) == pytest.approx(0.04, abs=1e-9)
    arms = Separation(cup).arm, Separation(gripper).arm
    assert len(arms[1].radius) - len(arms[0].radius) == 1  # two capsules in the place of three
    assert mujoco.mj_name2id(cup.model, mujoco.mjtObj.mjOBJ_BODY, "robot/cup") > 0
    assert reach("ur3e")[1] - reach("ur3e", "suction:CUP")[1] == pytest.approx(0.04, abs=0.01)


def test_the_expert_picks_with_it() -> None:
    config = compose_environment("train", ["robot.end_effector=suction:CUP", "task=pick", "human=none"])
    engine = Engine(config, 4, 0)
    state, expert = engine.reset(), make_policy("expert", engine.episodes.subtask, engine.scene, config, 0)
    done = np.zeros(4, dtype=bool)
    for _ in range(60):
        result = engine.step(expert(state).numpy())
        done |= result.success.numpy()
        state = engine.reset(np.flatnonzero(result.done.numpy()))
    assert done.all()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["robot=jaco", "robot.end_effector=rg2"], r"robot\.end_effector=rg2: robot\.name=jaco has its own"),
        (["robot.end_effector=spoon"], r"robot\.end_effector='spoon' .*rg2"),
        (["robot.end_effector=suction:SuctionCup.name"], r"robot\.end_effector"),
    ],
)
def test_what_is_no_end_effector_is_refused_in_one_line(words: list[str], says: str) -> None:
    config = compose_environment("train", [*words, "human=none"])
    with pytest.raises(ConfigError, match=says):
        build_scene(config.robot, config.cell, config.engine.substeps)


def test_a_motion_looks_at_what_the_robot_holds() -> None:
    config = compose_environment("train", ["task=place", "human=watching:watch"])
    engine = Engine(config, 3, 0)
    before = engine.reset()
    after = engine.step(np.zeros((3, 6))).state
    place = before.humans_pos[:, 0]
    to_tool = before.tcp_pos[:, :2] - place
    facing = np.arctan2(to_tool[:, 1].numpy(), to_tool[:, 0].numpy())
    assert np.abs(np.angle(np.exp(1j * (after.humans_yaw[:, 0].numpy() - facing)))).max() < 1e-9
