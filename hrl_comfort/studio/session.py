"""A session: one cell under one policy or chain, which can be paused, stepped, taken over and changed while it runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from hrl_comfort import humans
from hrl_comfort.comfort.sources import Floats, Live, Source
from hrl_comfort.comfort.terms import human_distance, present
from hrl_comfort.config import CONTROL_STEP_S, ComfortConfig, ConfigError, HumanConfig, StudioConfig
from hrl_comfort.files.run_config import environment
from hrl_comfort.hierarchy.controllers import make_executor
from hrl_comfort.hierarchy.executor import OptionRun
from hrl_comfort.plots.clip import Array, Clip
from hrl_comfort.policies.graph import inputs_of
from hrl_comfort.safety.geometry import gaps
from hrl_comfort.sim.controls import limbs_of
from hrl_comfort.sim.engine import Engine
from hrl_comfort.sim.step_result import StepResult
from hrl_comfort.studio.clip import decision_clip, still_clip
from hrl_comfort.tasks import State

FIRST_LEVEL = 5
"""Level of the slider where the configuration fixes none."""
APART_M, OUT_M = 0.05, np.arange(0.0, 2.0, 0.01)
"""Least distance between person and arm at the beginning of an episode, and how far a person is moved for it."""
ROW = torch.ones(1, dtype=torch.bool)


class Slider(Source):
    """A comfort level set by hand."""

    def __init__(self, config: ComfortConfig, rows: int) -> None:
        self.value = float(config.level or min(FIRST_LEVEL, config.levels))
        super().__init__(replace(config, source="fixed", level=int(self.value)), rows)
        self.levels = self._set

    def _set(self, time_s: Floats, draws: Floats) -> Floats:
        return np.full(len(time_s), self.value)


@dataclass(frozen=True)
class Step:
    """One decision of a session."""

    clip: Clip
    before: State
    """State in which the decision was made."""
    result: StepResult
    runs: list[OptionRun]
    """Option runs that ended with it, or by hand before it."""
    over: bool
    """The episode ended with it."""

    @property
    def tool(self) -> Array:
        """Places of the tool after each of its control steps, (K, 3) m."""
        kept = self.result.valid[0].numpy()
        return self.result.instants.tcp_pos.numpy()[0, kept]

    @property
    def outcome(self) -> str:
        """End of the episode in a word, empty where it goes on."""
        if not self.over:
            return ""
        if bool(self.result.success[0]):
            return "success"
        if not bool(self.result.terminated[0]):
            return "out of time"
        state = self.result.state
        for name, hit in (("person", state.touching), ("cell", state.table_collision)):
            if bool(hit[0]):
                return f"contact with the {name}"
        if bool(state.self_collision[0]):
            return "contact with itself"
        return "object lost" if "object_lost" in state.fields() and bool(state.object_lost[0]) else "out of time"


class Session:
    """One cell, stepped decision by decision.

    The action of the next decision is always there: it is made as soon as the state before it is known, and anew
    whenever the level or the option is changed by hand.

    Args:
      config: of the cell, the person, the comfort level and the policies.
      live: levels shared with other sessions; who opened them closes them.

    Raises:
      ConfigError: a policy is missing or does not fit.
    """

    def __init__(self, config: StudioConfig, live: Live | None = None) -> None:
        torch.set_num_threads(1)
        self.asked = config
        """Configuration as given; `config` is that in force, with a level."""
        self.config = with_level(config)
        env = environment(self.config)
        self.engine = Engine(env, 1, config.first_seed, measure_arm=True, disturbance=config.disturbance, live=live)
        self.slider = Slider(env.comfort, 1)
        self._configured = self.engine.episodes.source
        if env.comfort.source == "fixed":
            self.engine.episodes.take_levels(self.slider)
        self.keep_person = False
        """A new episode begins with the first person where they are."""
        self.seconds, self.decisions, self.contacts, self.unsafe_contacts = 0.0, 0, 0, 0
        """Simulated time, decisions, contacts with the person and unsafe ones since the session began."""
        self.successes, self.failures = 0, 0
        """Episodes that ended with and without success since the session began."""
        self.values: dict[str, float] = {}
        """Values by the top of the options that could start when the latest did; empty where it does not say."""
        self.over = False
        self._left: list[OptionRun] = []
        self.play(self.config)

    @property
    def state(self) -> State:
        """State in which the next decision is made."""
        assert self.engine.episodes.state is not None
        return self.engine.episodes.state

    @property
    def walk(self) -> humans.Walk:
        """The walk of the first person, whom a hand may move."""
        return self.engine.episodes.walk

    @property
    def decision_s(self) -> float:
        """Duration of a decision that nothing ends early, s."""
        return self.config.task.action_repeat * CONTROL_STEP_S

    @property
    def reach_m(self) -> float:
        """Way of the person until the arm is slow, m, as the shield counts; 0 where it is slow or unshielded."""
        drive, state = self.engine.episodes.drive, self.state
        if drive is None:
            return 0.0
        limbs = self.engine.episodes.people.now.limbs
        return float(drive.reach(state.joint_target.numpy(), state.target_vel.numpy(), limbs)[0])

    @property
    def distance_m(self) -> float | None:
        """Horizontal distance from the tool to the nearest person's axis, m; None without a person."""
        state = self.state
        return float(human_distance(state.tcp_pos, state.humans_pos)) if bool(present(state.humans_pos)) else None

    @property
    def stage(self) -> str:
        """Name of the stage in force."""
        stages = self.engine.episodes.subtask.stages
        return stages[int(self.state.stage) % len(stages)].name

    @property
    def option(self) -> str:
        """Name of the option in force."""
        return self.executor.table.names[int(self.executor.option)]

    @property
    def options(self) -> list[str]:
        """Names of all options."""
        return self.executor.table.names

    @property
    def quantity(self) -> str:
        """Meaning of `values`, such as value or probability."""
        return self._top.quantity

    def play(self, config: StudioConfig) -> None:
        """Begin an episode under the policies of `config`; its cell and person stay as they are.

        Raises:
          ConfigError: a policy is missing or does not fit; the session goes on as it was.
        """
        self.executor, self._top = make_executor(config, None, self.engine, config.first_seed)
        self.config = replace(
            self.config, policy=config.policy, policies=config.policies, meta_controller=config.meta_controller
        )
        self.reset()
        with torch.no_grad():
            read = [inputs_of(option.policy, self.state) for option in self.executor.table.options]
        self.observes_level = any("level" in names for names in read)
        """Whether a policy acts on the comfort level."""

    def repeat(self) -> None:
        """Begin the same episode again, with the same draws for cell, arm and person."""
        self.engine.episodes.again()
        self.reset()

    def reset(self) -> None:
        """Begin the next episode."""
        episodes, kept = self.engine.episodes, self.walk
        self.engine.reset()
        if self.keep_person:
            kept = self._beside_arm(kept)
            episodes.stand(replace(kept, spawn=kept.position.copy(), step=np.zeros_like(kept.step)))
        self.executor = self.executor.anew()
        self.over, self._left = False, []
        self._top.begin(ROW)
        self._begin()

    def _beside_arm(self, walk: humans.Walk) -> humans.Walk:
        """Return `walk` farther from the base, where the arm begins inside the person; MuJoCo would fling it."""
        outward = walk.position / max(float(np.linalg.norm(walk.position)), 1e-9)
        limbs = np.repeat(limbs_of(self.engine.scene, walk), len(OUT_M), axis=0)
        limbs[:, :, :2] += (OUT_M[:, None] * outward)[:, None]
        angles = np.repeat(self.state.joint_pos.numpy(), len(OUT_M), axis=0)
        separation = self.engine.episodes.separation
        arm, person = separation.arm, separation.each[0]
        free = gaps(arm, arm.pose(angles).ends, person, person.ends(limbs)).min(axis=0) >= APART_M
        return replace(walk, position=walk.position + OUT_M[free.argmax()] * outward)

    def step(self) -> Step:
        """Run the decision that has been made, then make the next one; begin a new episode where the last is over.

        Raises:
          RuntimeError: the policy returned an action that is not finite.
        """
        if self.over:
            self.reset()
        before = self.state
        result = self.engine.step(self.action.numpy())
        options = self.executor.ended(result)
        runs, self._left = self._left, []
        if bool(options.rows):
            runs.append(self.executor.run_of(0, options, int(result.state.steps)))
        self.over = bool(result.done | options.given_up)
        self.decisions += 1
        self.successes += int(self.over and bool(result.success[0]))
        self.failures += int(self.over and not bool(result.success[0]))
        self.contacts += int(result.state.touching & ~before.touching)
        self.unsafe_contacts += int(result.state.unsafe_contact & ~before.unsafe_contact)
        clip = decision_clip(self.engine, before, result)
        self.seconds += clip.duration_s
        if not self.over:
            if bool(options.deciding):
                runs += self._begin()
            else:
                self._decide()
        return Step(clip, before, result, runs, self.over)

    def still(self) -> Clip:
        """Return the picture of the state in which the next decision is made."""
        return still_clip(self.engine)

    def force(self, name: str) -> None:
        """Start the option `name` now, or let it go on.

        Raises:
          ConfigError: it is not an option, or cannot start in this state.
        """
        if name not in self.options:
            raise ConfigError(f"option={name!r} is not one of {', '.join(self.options)}")
        able = self.executor.available(self.state)[0]
        if self.over or not able[self.options.index(name)]:
            possible = [] if self.over else [each for each, can in zip(self.options, able.tolist(), strict=True) if can]
            raise ConfigError(f"option={name!r} cannot start now; {', '.join(possible) or 'none'} can")
        self.executor.interrupt()
        self._left += self._begin(torch.tensor([self.options.index(name)]))

    def set_level(self, level: float) -> None:
        """Set the level of the next decision, 1 to `comfort.levels`; a level from a stream is given up."""
        self.engine.episodes.take_levels(self.slider)
        self.slider.value = float(np.clip(level, 1, self.config.comfort.levels))
        self.slider.level[:] = self.slider.value
        self.engine.episodes.measured(level=self.slider.level)
        if not self.over:
            self._decide()

    def follow_source(self) -> None:
        """Take the level from the source of the configuration, from the end of the next decision on."""
        self.engine.episodes.take_levels(self._configured)

    @property
    def by_hand(self) -> bool:
        """Whether the level is set by hand."""
        return self.engine.episodes.source is self.slider

    def set_motion(self, human: HumanConfig) -> None:
        """Let the first person go on from where they are as `human` says."""
        self.engine.episodes.go_on_as(human)

    def close(self) -> None:
        """Stop the engine's threads, and listening to live levels of its own."""
        self.engine.close()
        self._configured.close()

    def _begin(self, chosen: Tensor | None = None) -> list[OptionRun]:
        """Start the option `chosen` (1,), by default that of the top; return the run that it interrupts, if any."""
        decision = self.executor.decision(self.state)
        chosen = self._top(decision) if chosen is None else chosen
        values = self._top.values(decision)
        told = [] if values is None else zip(self.options, values[0].tolist(), decision.mask[0].tolist(), strict=True)
        self.values = {name: value for name, value, able in told if able}
        left = self.executor.left_runs(ROW, chosen)
        self.executor.begin(ROW, chosen)
        self._decide()
        return left

    def _decide(self) -> None:
        with torch.no_grad():
            self.action = self.executor.act(self.state)
        if not bool(torch.isfinite(self.action).all()):
            raise RuntimeError(f"the policy of {self.option} returned an action that is not finite")


def with_level(config: StudioConfig) -> StudioConfig:
    """Return `config` with a level that can be set; without a source it is fixed, and F_comfort weighs nothing."""
    if config.comfort.source != "none":
        return config
    return replace(config, comfort=replace(config.comfort, source="fixed", level=FIRST_LEVEL, scale=0.0))
