"""A wrong word is answered before anything heavy is imported, and a word alone is what it stands for."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hrl_comfort.cli.first_checks import check
from hrl_comfort.cli.main import configuration, main
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, TrainConfig

WRONG = {
    "": "",
    "evalute": "evalute is not a verb, did you mean evaluate?; choose one of train, evaluate",
    "train hierachy": "train hierachy is not known, did you mean hierarchy?; choose one of hierarchy",
    "bench trian": "bench trian is not known, did you mean train?; choose one of env",
    "train taks=pick": "did you mean task?",
    "train seed=3": "did you mean train_seed?",
    "evaluate seed=3": "did you mean episode_seed?",
    "train gamma=0.9": "did you mean agent.gamma?",
    "train task=pik": "did you mean pick?",
    "train task.name=pik": "task.name='pik' is not allowed",
    "train human.motion=run": "human.motion='run' is not allowed",
    "train robot.name=arm": "robot.name='arm' is not allowed",
    "train agent.policy_steps=-1": "outside its range",
    "train agent.policy_steps=1.5": "agent.policy_steps=1.5",
    "train initial_policy=runs/none": "initial_policy='runs/none' is not there",
    "train agent.next_skill_reward=2": "agent.next_skill_reward=2 is for ends where agent.next_skill begins, and there",
    "train curriculum.stages=[{name:a,policy_steps:9,set:{agent:{next_skill_reward:2}}}]": "give agent.next_skill=RUN",
    "train hierarchy agent.next_skill_reward=2": "hierarchy.refinement=[] refines none: choose experiment=t_star, or",
    "train task=cycle agent=end_to_end": "give initial_policy=FOLDER with the runs pick, place, return (agent.own.skil",
    "train task=cycle agent=end_to_end initial_policy=.": "initial_policy='.' has no pick, which is one of agent.own.",
    "train hierarchy agent=end_to_end": "agent=end_to_end does not go with train hierarchy, whose options are trained",
    "train task=place task.start=none.npz": "task.start='none.npz' is neither",
    "train --fast": "'--fast' is not an override",
    "train -m task=pik,pick": "did you mean pick?",
    "train hierarchy task.name=place": "leave it out",
    "evaluate policy=runs/none": "policy='runs/none' is not there",
    "evaluate runs/none": "policy='runs/none' is not there",
    "evaluate sb3:none.zip": "policy='sb3:none.zip' is not there",
    "evaluate expert group_by=[sen]": "group_by='sen' is not allowed",
    "studio runs/none": "policy='runs/none' is not there",
    "report runs/none": "run='runs/none' is not a folder",
    "figure kind=level evaluations=[a] output=a.png": "kind='level' is not allowed",
    "figure kind=levels evaluations=[none] output=a.png": "evaluations='none' is not the folder",
}
HEAVY = ("torch", "mujoco", "pandas", "matplotlib", "viser", "joblib")
PROGRAM = """
import json, sys
from hrl_comfort.cli.main import main
lines = json.load(sys.stdin)
codes = [main(line.split()) for line in lines]
print(json.dumps([codes, [name for name in HEAVY if name in sys.modules]]))
"""


def test_a_wrong_word_gets_one_line_before_anything_heavy_is_imported(tmp_path):
    program = PROGRAM.replace("HEAVY", repr(HEAVY))
    done = subprocess.run(
        [sys.executable, "-c", program], input=json.dumps(list(WRONG)), capture_output=True, text=True, cwd=tmp_path
    )
    codes, imported = json.loads(done.stdout.splitlines()[-1])
    assert codes == [0] + [1] * (len(WRONG) - 1)
    assert not imported
    said = done.stderr.splitlines()
    for line, (words, says) in zip(said, list(WRONG.items())[1:], strict=True):
        assert says in line, words


def test_a_word_alone_is_a_policy_or_a_run(tmp_path):
    run = tmp_path / "my run"
    run.mkdir()
    assert configuration("evaluate", [str(run)]) == configuration("evaluate", [f"policy='{run}'"])
    assert configuration("report", [str(run)]) == configuration("report", [f"run='{run}'"])
    config = configuration("evaluate", ["expert", "episodes=2"])
    assert isinstance(config, EvaluateConfig) and config.policy == "expert"


def test_a_folder_of_options_is_evaluated_as_their_chain(tmp_path):
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.pt").touch()
    config = configuration("evaluate", [str(tmp_path), "episodes=2"])
    assert isinstance(config, EvaluateConfig)
    assert config.policies == {name: str(tmp_path / name) for name in ("pick", "place", "return")}
    assert (config.task.name, config.meta_controller.name, config.policy) == ("cycle", "nearest", None)


def test_a_whole_number_may_be_written_as_a_power_of_ten():
    config = compose("train", ["agent.policy_steps=1e4", "agent.gamma=1", "curriculum.start_m=5e-1"])
    assert isinstance(config, TrainConfig)
    assert config.agent.policy_steps == 10_000 and isinstance(config.agent.policy_steps, int)
    assert config.agent.gamma == 1.0 and isinstance(config.agent.gamma, float)
    for value in ("1e-1", "1e300", "'1e4'", "true"):
        with pytest.raises(ConfigError, match=r"agent\.policy_steps"):
            compose("train", [f"agent.policy_steps={value}"])


def test_an_error_about_a_long_word_is_short(capsys):
    assert main(["train", "task=" + "[" * 3000]) == 1
    assert len(capsys.readouterr().err) < 1100
    assert main(["studio", "[" * 3000]) == 1
    assert len(capsys.readouterr().err) < 1100


def test_trainings_that_have_the_skills_they_name_pass(tmp_path: Path) -> None:
    for name in ("pick", "place", "return"):
        (tmp_path / name).mkdir()
    whole = f"initial_policy='{tmp_path}'"
    check(compose("train", ["task=cycle", "agent=end_to_end", whole]))
    check(compose("train", ["task=pick", f"agent.next_skill='{tmp_path}/place'", "agent.next_skill_reward=2"]))
    check(compose("train_hierarchy", ["experiment=t_star"]))
    check(compose("train", ["agent.next_skill_reward=2", f"resume='{tmp_path}'"]))
