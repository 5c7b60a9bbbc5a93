"""Episodes of an evaluation split, run side by side under one policy or chain."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pandas import DataFrame

from hrl_comfort.analysis.summary import summarise
from hrl_comfort.comfort.fitted import mean_rating
from hrl_comfort.comfort.frightened import mean_level
from hrl_comfort.comfort.trajectory import metrics
from hrl_comfort.config import CONTROL_STEP_S, EvaluateConfig, MetaControllerTrainConfig, TrainConfig
from hrl_comfort.config.hydra_conf import run_folder
from hrl_comfort.evaluation.episode import COLUMNS, Episode
from hrl_comfort.evaluation.ledger import open_split
from hrl_comfort.evaluation.rates import MINUTE_S, Course, discomforts, newly_lost, shift_rates
from hrl_comfort.files.atomic import all_or_none, write_json
from hrl_comfort.files.run_config import environment, load_config, save_config
from hrl_comfort.files.tables import records_of, write_table
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import OptionRun, execute
from hrl_comfort.hierarchy.look_ahead import Judged, LookAhead
from hrl_comfort.humans import EvaluationSet
from hrl_comfort.policies.load import Source, name_of
from hrl_comfort.progress import Show, progress, success_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.hand.sensors import Losses
from hrl_comfort.sim.processes.engine import make_engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.tasks import State
from hrl_comfort.tasks.kitting import missed

BATCH = 250
"""Episodes simulated side by side."""
STALE = ("summary.json", "episodes.parquet", "options.csv", "paths.csv", "video.mp4", "failure.mp4")
"""Files of an earlier evaluation, deleted when a new one is written."""
SEEN = ("tcp_pos", "humans_pos")
COURSE = (
    "joint_target", "arm_distance", "home_distance", "level", "stage", "touching", "unsafe_contact", "table_collision",
    "self_collision",
)  # fmt: skip
"""Fields of `State` that are kept of every instant, those of `Course` among them."""


@dataclass
class Result:
    """Rows of episodes.csv, options.csv and paths.csv."""

    episodes: list[Episode]
    options: list[dict[str, Any]]
    paths: list[list[Any]]

    @property
    def table(self) -> DataFrame:
        """The episodes, as read from episodes.csv."""
        return records_of((episode.row() for episode in self.episodes), "episodes")

    def write(self, output: Path, config: EvaluateConfig) -> dict[str, Any]:
        """Write the tables, config.yaml and summary.json in place of earlier ones; return the last."""
        limits = [episode.max_episode_steps for episode in self.episodes]
        summary = summarise(self.table, config.group_by, limits)
        with all_or_none(*(output / name for name in STALE)):
            save_config(config, output / "config.yaml")
            write_table(output / "episodes.csv", COLUMNS, (row.row().values() for row in self.episodes))
            if self.options:
                write_table(output / "options.csv", list(self.options[0]), (row.values() for row in self.options))
            if self.paths:
                write_table(output / "paths.csv", path_columns(len(self.paths[0])), self.paths)
            write_json(output / "summary.json", summary)
        return summary


def rollout(config: EvaluateConfig, policy: Source | None = None) -> Result:
    """Run the first `config.episodes` episodes of the split; `policy` stands in for the config's."""
    look = open_split(config, policy)
    result = Result([], [], [])
    with progress(f"evaluate {config.task.name}", config.episodes * max(1, len(config.levels))) as show:
        for at_level in at_each_level(config):
            for start in range(0, config.episodes, BATCH):
                _run_batch(at_level, policy, look.entries.part(start, start + BATCH), result, show)
    look.completed(result.table)
    return result


def at_each_level(config: EvaluateConfig) -> list[EvaluateConfig]:
    """Return the configuration fixed at each of `config.levels`; itself if there are none."""
    if not config.levels:
        return [config]
    return [replace(config, comfort=replace(config.comfort, source="fixed", level=level)) for level in config.levels]


def _run_batch(
    config: EvaluateConfig, policy: Source | None, entries: EvaluationSet, result: Result, show: Show
) -> None:
    """Run episodes side by side, one a row, to their ends; append them to `result`."""
    env, rows = environment(config), len(entries.episode)
    engine = make_engine(env, rows, 0, entries, measure_arm=True, disturbance=config.disturbance)
    executor, top = make_executor(config, policy, engine, config.first_seed)
    judged = Judged(top, LookAhead(engine, executor)) if config.regret else None
    recorder = EpisodeRecorder(config, policy, engine, entries, result)
    before = [episode.success for episode in result.episodes]
    recorder.begin(engine.reset())
    due = time.monotonic()
    for executed in execute(engine, executor, judged or top):
        if config.realtime:
            steps = int((executed.result.valid & executed.active[:, None]).sum(dim=1).max())
            due = max(due + steps * CONTROL_STEP_S, time.monotonic())  # what is late is not made up for
            time.sleep(max(0.0, due - time.monotonic()))
        runs = executed.runs
        if judged is not None:
            runs = [replace(run, regret=rounded(judged.regret(run))) for run in runs]
        recorder.add(executed.result, executed.active, executed.ended, runs)
        ended = [*before, *recorder.outcomes]
        show(len(ended), success_of(ended))
    engine.close()
    recorder.finish()


class EpisodeRecorder:
    """Rows of the tables about an episode in each row of an engine, whoever steps it."""

    def __init__(
        self, config: EvaluateConfig, policy: Source | None, engine: Engine, entries: EvaluationSet, result: Result
    ) -> None:
        self.config, self.engine, self.entries, self.result = config, engine, entries, result
        acting = config.policy if policy is None else policy
        self.label = f"meta_controller={config.meta_controller.name}" if acting is None else name_of(acting)
        if acting is None:
            acting = config.policies.get("meta_controller") or next(iter(config.policies.values()), None)
        self.train_seed = train_seed(acting) if isinstance(acting, str) else None
        self._losses = Losses(engine.scene)

    def begin(self, state: State) -> None:
        """Begin with the first state of every row."""
        rows = len(self.entries.episode)
        self.totals = {name: np.zeros(rows) for name in ("policy_steps", "return", "steps", "level", "missed", "lost")}
        self.seen: list[tuple[dict[str, torch.Tensor], torch.Tensor]] = []
        self._keep(state.instants(), torch.ones(rows, 1, dtype=torch.bool))
        self._found: dict[int, Episode] = {}
        self._runs: list[OptionRun] = []
        if self.config.record:
            self._record(state, torch.ones(rows, dtype=torch.bool))

    def add(self, result: StepResult, active: torch.Tensor, ended: torch.Tensor, runs: list[OptionRun]) -> None:
        """Add a decision: rows (N,) bool that took part, and whose episode ended with it, and options that ended."""
        valid = result.valid & active[:, None]
        steps = valid.numpy().sum(axis=1)
        self.totals["policy_steps"] += active.numpy()
        self.totals["return"] += np.where(active.numpy(), result.reward.numpy(), 0.0)
        self.totals["steps"] += steps
        self.totals["level"] += result.level.numpy() * steps
        self.totals["missed"] += np.where(active.numpy(), missed(result.before, result.state).numpy(), 0.0)
        if self.config.robot.gripper.holds:
            self.totals["lost"] += np.where(active.numpy(), newly_lost(self._losses, result), 0)
        self._keep(result.instants, valid)
        if self.config.record:
            for k, instant in enumerate(result.steps):
                self._record(instant, valid[:, k])
        for row in torch.nonzero(ended).squeeze(-1).tolist():
            self._found[row] = self._episode(row, result)
        self._runs += runs

    def cut(self, latest: StepResult) -> None:
        """End every episode after the decision `latest`, as one that was stopped."""
        every = torch.ones(len(self.entries.episode), dtype=torch.bool)
        self.add(replace(latest, decision_steps=torch.zeros_like(latest.decision_steps)), ~every, every, [])

    @property
    def outcomes(self) -> list[bool]:
        """Success of the episodes that have ended."""
        return [episode.success for episode in self._found.values()]

    def finish(self) -> None:
        """Append the rows to the result, once every episode has ended."""
        self.result.episodes += self._measured()
        self.result.options += [self._option(run) for run in sorted(self._runs, key=lambda r: (r.row, r.start_step))]

    def _keep(self, instants: State, valid: torch.Tensor) -> None:
        kept = {name: getattr(instants, name) for name in (*SEEN, *COURSE)}
        self.seen.append(({name: v.expand(*valid.shape, *v.shape[2:]) for name, v in kept.items()}, valid))

    def _measured(self) -> list[Episode]:
        """Return the episode of each row with the measures of `comfort.trajectory` and `evaluation.rates`."""
        rows = len(self.entries.episode)
        valid = torch.cat([kept for _, kept in self.seen], dim=1).numpy()

        def column(name: str) -> NDArray[Any]:
            return np.asarray(torch.cat([fields[name] for fields, _ in self.seen], dim=1).numpy())

        columns = {name: column(name) for name in (*SEEN, *COURSE)}
        here, shielded = self.config.human.motion != "none", self.config.safety.kind != "none"
        found = []
        for row in range(rows):
            tool, people, *course = (values[row][valid[row]] for values in columns.values())
            episode = self._found[row]
            stops = episode.protective_stops or 0
            kept = dict(zip(COURSE, course, strict=True), human_here=here, objects_placed=episode.objects_placed)
            late = int(self.totals["missed"][row]) if self.engine.episodes.subtask.orders else None
            fallen = int(self.totals["lost"][row]) if self.config.robot.gripper.holds else None
            through = Course(
                tool=tool, people=people, **kept, protective_stops=stops, orders_missed=late, objects_lost=fallen
            )
            values = metrics(through)
            values |= discomforts(through, self.config)
            arm, person = through.arm_distance, episode.person_id
            values["person_level_mean"] = mean_level(arm, tool, self.config.comfort) if here else None
            values["person_rating_mean"] = None if person is None else mean_rating(arm, tool, person)
            if self.config.regret:
                lost = sum(run.regret or 0.0 for run in self._runs if run.row == row)
                values["regret_per_min"] = lost * MINUTE_S / (episode.steps * CONTROL_STEP_S)
            if self.engine.episodes.subtask.repeats:
                values |= shift_rates(through, shielded)
            measures = {name: None if value is None else rounded(value) for name, value in values.items()}
            found.append(replace(episode, **through.touched(), measures=measures))
        return found

    def _record(self, state: State, rows: torch.Tensor) -> None:
        """Append a line of paths.csv for each of the rows (N,) bool."""
        for row in torch.nonzero(rows).squeeze(-1).tolist():
            tcp, people = state.tcp_pos[row].numpy(), state.humans_pos[row].numpy()
            distance = float(np.linalg.norm(tcp[:2] - people, axis=-1).min())
            level = float(state.level[row])
            instant = [int(each[row]) for each in (self.entries.episode, state.steps, state.stage)]
            place = (*tcp, *people[0], state.humans_yaw[row, 0], distance, state.share[row])
            numbers = map(rounded, (*state.joint_pos[row].tolist(), *place))
            stops = int(state.protective_stops[row])
            self.result.paths.append([*instant, None if np.isnan(level) else round(level), *numbers, stops])

    def _episode(self, row: int, step: StepResult) -> Episode:
        config, state, entries = self.config, step.state, self.entries
        subtask = self.engine.episodes.subtask
        # A shift is over, and done, when its time is up.
        success = bool(step.truncated[row] if subtask.repeats else step.success[row])
        kind = config.cell.kinds[int(state.kinds[row, 0])]
        episodes, shielded = self.engine.episodes, config.safety.kind != "none"
        held = config.robot.gripper.holds
        return Episode(
            task=config.task.name,
            policy=self.label,
            train_seed=self.train_seed,
            split=config.split,
            episode_seed=int(entries.episode_seed[row]),
            episode=int(entries.episode[row]),
            object=kind,
            spawn_id=None if episodes.draw.spawn_id[row] < 0 else int(episodes.draw.spawn_id[row]),
            motion_id=int(episodes.draw.motion_id[row]),
            person_id=None if config.human.motion == "none" else int(episodes.draw.person[row]),
            seen=None if entries.drawn else bool(entries.seen[row]),
            comfort_level=self._level(row, config),
            human=config.human.motions,
            precision_m=config.task.precision.grasp_tolerance_m,
            success=success,
            steps=int(state.steps[row]),
            policy_steps=int(self.totals["policy_steps"][row]),
            return_=rounded(self.totals["return"][row]),
            contact=False,
            unsafe_contact=False,
            other_collision="none",
            truncated=not success and not bool(step.terminated[row]),
            objects_placed=int(subtask.released(state.stage)[row]),
            comfort_level_mean=None if config.comfort.source == "none" else rounded(self._mean_level(row)),
            shield_share_mean=rounded(float(state.share_sum[row] / state.steps[row])) if shielded else None,
            protective_stops=int(state.protective_stops[row]) if shielded else None,
            human_beyond_bound=int(state.human_beyond_bound[row]) if shielded else None,
            drops=int(state.drops[row]) if held else None,
            slip_mm=1000 * float(state.slip[row]) if held else None,
            object_lost=bool(self.totals["lost"][row] or state.object_lost[row]) if held else None,
            diverged=bool(state.diverged[row]) if held else None,
            measures={},
            max_episode_steps=self._limit(row, step),
        )

    def _mean_level(self, row: int) -> float:
        return float(self.totals["level"][row] / self.totals["steps"][row])

    def _level(self, row: int, config: EvaluateConfig) -> int | None:
        """Return the level of the row's whole episode; None without one, or if it may change."""
        if config.comfort.source not in ("fixed", "random"):
            return None
        return round(self._mean_level(row))

    def _limit(self, row: int, step: StepResult) -> int:
        """Return the time limit in force at the end of the row's episode, control steps.

        A level that rises may lower the limit below the steps already taken; these are then the limit.
        """
        limit = self.engine.episodes.max_episode_steps(step.level)[row]
        return max(int(limit), int(step.state.steps[row]))

    def _option(self, run: OptionRun) -> dict[str, Any]:
        line = asdict(run)
        row = line.pop("row")
        level = self._level(row, self.config)
        return {"episode": int(self.entries.episode[row]), "comfort_level": level, **line}


PATH_INSTANT = ("episode", "step", "stage", "level")
PATH_PLACES = (
    *("tcp_x", "tcp_y", "tcp_z", "human_x", "human_y", "human_yaw"),
    *("human_distance_m", "shield_share", "protective_stops"),
)


def path_columns(cells: int) -> list[str]:
    """Return the columns of paths.csv for rows of `cells` cells, between PATH_INSTANT and PATH_PLACES a joint each."""
    joints = cells - len(PATH_INSTANT) - len(PATH_PLACES)
    return [*PATH_INSTANT, *(f"q{joint}" for joint in range(joints)), *PATH_PLACES]


def rounded(value: float) -> float:
    """Return a number as the tables hold it, to six decimals."""
    return round(float(value), 6)


def train_seed(source: str) -> int | None:
    """Return the training seed of the run that a policy belongs to; None if it was not trained."""
    folder = run_folder(source)
    if folder is None:
        return None
    trained = load_config(folder)
    return trained.train_seed if isinstance(trained, TrainConfig | MetaControllerTrainConfig) else None
