"""`benchmarks.tops`: rules, learned tops and flat policies in equal shifts of kitting, and the table of returns."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from hrl_comfort.benchmarks import sb3_tops
from hrl_comfort.benchmarks import tops as choice
from hrl_comfort.composition.compose import compose
from hrl_comfort.config import ConfigError, EvaluateConfig, MetaControllerTrainConfig, TrainConfig
from hrl_comfort.hierarchy import look_ahead as looking
from hrl_comfort.training.controller_trainer import train_meta_controller
from hrl_comfort.training.trainer import train


def trained(folder: Path, learner: str, seed: int) -> Path:
    """Return the run folder of a top that has learned from a few choices."""
    words = [word for word in choice.WORDS if not word.startswith(("split=", "meta_controller="))]
    agent = ["options=4", "warmup_options=0", f"name={learner}", "observation=jobs", "log_every=4"]
    config = compose("train_meta_controller", [
        *words, *(f"meta_controller_agent.{word}" for word in agent), "cell=bench", "disturbance=none",
        "engine.num_envs=2", f"train_seed={seed}", f"output={folder}",
    ])  # fmt: skip
    assert isinstance(config, MetaControllerTrainConfig)
    return train_meta_controller(config)


def trained_flat(folder: Path) -> Path:
    """Return the run folder of a policy that has hardly learned the whole task."""
    of_tops = ("split=", "meta_controller", "policies.")
    words = [word for word in choice.WORDS if not word.startswith(of_tops)]
    config = compose("train", [
        *words, "cell=bench", "curriculum=off", "agent.policy_steps=8", "agent.learning_starts=8", "agent.log_every=8",
        "engine.num_envs=2", f"output={folder}",
    ])  # fmt: skip
    assert isinstance(config, TrainConfig)
    return train(config)


def trained_elsewhere(folder: Path, learner: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a learner of another library that has hardly learned."""
    monkeypatch.setattr(sb3_tops, "CELLS", 2)
    monkeypatch.setitem(sb3_tops.OWN[learner], "n_steps", 4)
    return sb3_tops.train(learner, 8, 2, folder, kitting())


def kitting(*words: str) -> EvaluateConfig:
    """Return the configuration of an evaluation of the world of the tops."""
    found = compose("evaluate", [*choice.WORDS, "cell=bench", "robot=ur3e", "output=unused", *words])
    assert isinstance(found, EvaluateConfig)
    return found


def test_the_table_tells_the_best_fixed_order_and_how_far_it_is_from_a_rule_and_the_oracle() -> None:
    gained = {"random": 1.0, "due": 3.0, "fixed a b": 2.0, "fixed b a": 4.0, "oracle": 5.0}
    shifts = [(top, shift, mean + (shift - 1) / 10) for top, mean in gained.items() for shift in range(3)]
    same = {"place": 1.0, "missed": 0.0, "comfort": 0.0, "regret": 0.0}
    rows = pd.DataFrame([{"top": top, "return": paid, "shift": shift, "seed": None} for top, shift, paid in shifts])
    learned = pd.DataFrame([
        {"top": "dqn", "return": 4.5 + seed + (shift - 1) / 10, "shift": shift, "seed": seed}
        for seed in (0, 1) for shift in range(3)
    ])  # fmt: skip
    lines = choice.table(pd.concat([rows, learned]).assign(**same)).splitlines()
    assert [line.split("`")[1] for line in lines[2:]] == ["random", "due", "fixed b a", "dqn", "oracle"]
    assert lines[4].endswith("| 1.00 | -1.00 |") and "4.00 [3.75, 4.25]" in lines[4]
    assert "5.00 [-1.35, 11.35]" in lines[5], "over the training seeds"


def test_a_world_that_lookahead_would_know_ahead_is_refused_before_anything_works() -> None:
    with pytest.raises(ConfigError, match=r"^disturbance=drop: meta_controller=lookahead would know ahead"):
        next(choice.measure(kitting("disturbance=drop"), 2))


def test_all_that_work_but_fixed_orders_that_are_not_the_best_are_told_their_regret(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(looking, "HORIZON_S", 2.0)
    learned = [trained(tmp_path / f"{name}_{seed}", name, seed) for name, seed in (("dqn", 3), ("dqn", 4), ("ppo", 3))]
    learned += [trained_flat(tmp_path / "flat"), trained_elsewhere(tmp_path / "sb3", "MaskablePPO", monkeypatch)]
    path, here = tmp_path / "tops.csv", ["cell=bench", "robot=ur3e", "output=unused", "task.max_episode_steps=400"]
    stopped = next(choice.measure(kitting(*here[3:]), 2))
    stopped.to_csv(path, index=False)
    monkeypatch.setattr(choice, "_beside", lambda *_: pytest.fail("measured again"))
    with monkeypatch.context() as older:
        older.setattr(choice, "RULES", choice.RULES[:-1])
        choice.main([str(path), "2", f"learned={learned[0]}", *here])
    before = choice.read_rows(path)
    choice.main([str(path), "2", *(f"learned={folder}" for folder in learned), *here])
    everything = choice.read_rows(path)
    assert before is not None and everything is not None
    assert "due" not in set(stopped["top"])
    pd.testing.assert_frame_equal(*(rows[: len(stopped)].drop(columns="seed") for rows in (before, stopped)))
    pd.testing.assert_frame_equal(everything[: len(before)], before)
    rows = everything[everything["seed"].isna()]
    assert everything.groupby(["top", "seed"])["shift"].count().to_dict() == {
        ("dqn", 3): 2, ("dqn", 4): 2, ("ppo", 3): 2, ("flat sac", 0): 2, ("sb3 MaskablePPO", 2): 2
    }  # fmt: skip
    assert everything[everything["top"] == "flat sac"]["regret"].isna().all(), "it does not choose"
    best = max(
        (name for name in rows["top"] if "fixed" in name), key=lambda name: rows[rows["top"] == name]["return"].sum()
    )
    shown = ["idle", *choice.RULES, best, *choice.LOOKING]
    assert set(rows[rows["regret"].notna()]["top"]) == {*shown} - {"idle"} and not (everything["regret"] < 0).any()
    of = rows.set_index("top")
    assert (of.loc[shown[1:], "regret"] >= 0).all() and (of.loc["oracle", "regret"] == 0).all()
    assert (of.loc["idle", "place"] == 0).all() and of.loc["random", "regret"].max() > 0
    assert (rows.groupby("top")["shift"].nunique() == 2).all() and len(rows) == 2 * rows["top"].nunique()
    lines = choice.table(rows).splitlines()
    assert "regret" in lines[0] and {line.split("`")[1] for line in lines[2:]} == set(shown)
    for shifts, other, why in (("3", [], "of 2 shifts"), ("2", ["safety=none"], "due earned other returns there")):
        with pytest.raises(ConfigError, match=f"^the file is there already, .*{why}; choose another file$"):
            choice.main([str(path), shifts, *here, *other])
    with pytest.raises(ConfigError, match=r"sb3 is not empty; choose another folder$"):
        sb3_tops.train("PPO", 8, 2, learned[-1], kitting())
    pd.DataFrame({"top": ["due"]}).to_csv(path, index=False)
    with pytest.raises(ConfigError, match=r"tops.csv is there already, and has other columns; choose another file$"):
        choice.main([str(path), "2", *here])
