"""Files that commands write and the columns of their tables, with units and sources.

`docs/metrics.md` is generated from this module. A new column needs a line here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table that a command writes."""

    file: str
    """Name, with its folder inside the run folder."""
    about: str
    columns: dict[str, str]
    """Meaning by column, with its unit. A name may stand for several columns, such as `reward/NAME`."""


FILES = {
    "config.yaml": "configuration, as it was at the training; `hierarchy.yaml` of a `train hierarchy`",
    "provenance.json": "whether the training is finished, its length, seeds, commit (`+`: uncommitted changes), "
    "versions and machine",
    "policy.pt": "actor, critics, normaliser and the environment of the training; loads with `weights_only=True`",
    "meta_controller.pt": "network, options and levels of a learned controller",
    "metrics.csv": "learning curve",
    "timing.csv": "speed, row for row of metrics.csv",
    "meta_controller_metrics.csv": "learning curve of a controller",
    "events.out.tfevents.*, wandb/": "the learning curve for TensorBoard, and for Weights & Biases (`logger=wandb`)",
    "checkpoints/step_*.pt": "the newest `agent.keep_checkpoints` policies",
    "checkpoints/best.pt": "the policy with the best training success at the tightest precision, over at least 20 "
    "episodes",
    "checkpoints/latest.pt, previous.pt": "what `resume=` needs; deleted when the training is finished",
    "terminal_states.npz": "by `terminal_states=`: arrays `orange` and `pink` (M, 21), the joint angles, joint "
    "velocities and servo targets, the person's position (x, y) and the level at the end of M successful episodes; "
    "(M, 18) without a person",
    "eval/, eval_SPLIT/": "an evaluation on the split `paper`, and on another one: config.yaml, episodes.csv, "
    "options.csv and summary.json; paths.csv with `record=true`; checkpoints.csv and `checkpoints/` with "
    "`checkpoints=all`",
    "report.html, eval/failure.mp4, eval/video.mp4": "the page of `report`, and videos of the first recorded failure "
    "and success",
    "report.csv, report.md, report.png": "table and figure of a sweep's report",
    "job.json": "overrides and state of a job of a sweep: `running`, `done`, `stopped` or `failed`",
    "NAME.png, NAME.json": "a figure and its numbers",
    "setpoints.parquet": "`deploy`: every set-point with its time, and the joint angles measured then",
    "identify.json": "`identify`: lag and latency of each joint with intervals, s; remaining error, rad; overrides",
}
"""Content of each file or folder of a run folder."""

METRICS = Table(
    "metrics.csv",
    "A row every `agent.log_every` decisions. Means are over the episodes that ended, or the updates made, since the "
    "row before. Actions are sampled, so success is below that of `evaluate`, which takes the most likely action. "
    "There is no column of time: the same training gives the same file, bit for bit.",
    {
        "stage": "Curriculum stage.",
        "policy_steps": "Decisions so far, over all cells.",
        "updates": "Gradient steps so far.",
        "episodes": "Episodes that have ended so far.",
        "precision_m": "Tolerance in force, m.",
        "success": "Share of episodes that succeeded, each at the tolerance with which it began.",
        "return": "Mean sum of rewards, without discount.",
        "steps": "Mean control steps of all episodes, failures included.",
        "contact, unsafe_contact, other_collision": "Share of episodes with one; see episodes.csv.",
        "shield_share_mean, protective_stops": "Mean over the episodes; 1 and 0 without a shield.",
        "reward/NAME": "Mean sum of a weighted reward term; the terms add up to `return`.",
        "critic_loss": "Mean squared temporal difference, summed over both critics (Haarnoja et al. 2018, eq. 5).",
        "actor_loss": "Mean of α log π − min Q (eq. 7).",
        "alpha_loss": "Loss of the entropy coefficient: log α (entropy − target) (eq. 18).",
        "alpha": "Entropy coefficient.",
        "entropy": "Mean of −log π of sampled actions, nats.",
        "q_mean": "Mean value of both critics.",
    },
)
TIMING = Table(
    "timing.csv",
    "A row for each row of metrics.csv.",
    {
        "policy_steps": "Decisions so far.",
        "seconds": "Time of training so far, s, without pauses.",
        "policy_steps_per_s, updates_per_s": "Rates since the row before, 1/s.",
    },
)
CONTROLLER_METRICS = Table(
    "meta_controller_metrics.csv",
    "A row every `meta_controller_agent.log_every` options. Means are over the episodes that ended since the row "
    "before.",
    {
        "options, updates": "Options that have ended, and updates of the network, so far.",
        "episodes": "Episodes that ended since the row before.",
        "success": "Share of episodes in which every ball was placed.",
        "placed": "Balls placed in an episode.",
        "return": "Sum of rewards, without discount.",
        "steps": "Control steps.",
        "exploration": "Probability of a random option.",
        "loss": "Q-learning loss, mean over the updates.",
    },
)
EPISODES = Table(
    "eval/episodes.csv",
    "A row for each episode, in the order of the split. Means and shares are over control steps. *Human distance* is "
    "horizontal, from the tool to the person's vertical axis; *arm distance* is the smallest distance between any link "
    "and any part of the body, in three dimensions. Columns of the person are empty where nobody is there.",
    {
        "task": "Subtask.",
        "policy": "Policy that acted: a path, a name, or the meta-controller of a chain.",
        "train_seed": "Training seed of the policy (of a chain: of its first policy); empty if nothing was trained.",
        "split": "`train`, `validation`, `test` or `paper`.",
        "episode_seed": "Seed of colour and start.",
        "episode": "Number in the split.",
        "colour": "Colour of the ball: `orange` or `pink`.",
        "spawn_id": "Index into `human.spawns_m`; empty where the person started elsewhere.",
        "motion_id": "Seed of the person's motion.",
        "seen": "Whether training may start the person there.",
        "comfort_level": "Level of the whole episode; empty without a level, or where it changed.",
        "human": "Motion of the person.",
        "precision_m": "`task.precision.grasp_tolerance_m`, m.",
        "success": "Every stage is done, and nothing is touched in the last step. A shift succeeds when its time is "
        "up.",
        "steps": "Control steps of 20 ms.",
        "policy_steps": "Decisions.",
        "return": "Sum of rewards, without discount.",
        "contact": "The arm and the person touched.",
        "unsafe_contact": "When a contact began, the arm's nearest point moved towards the person faster than 0.25 "
        "m/s (ISO 10218-1:2011, 5.6.2; ISO 10218-2:2025, 5.5.6.1). The person's own speed does not count.",
        "other_collision": "What else the arm touched: `none`, `table` (any table, the pedestal, the floor) or `self`.",
        "truncated": "Neither success nor failure: the time was up, or a controller had no further option.",
        "balls_placed": "Balls at the drop point of their colour.",
        "comfort_level_mean": "Mean level.",
        "shield_share_mean": "Mean share of the speed asked for that rating and shield passed; empty without a shield.",
        "protective_stops": "How often the shield began to brake (ISO/TS 15066:2016, 5.5.4), or to take set-points "
        "back to an arm that did not follow them; empty without a shield.",
        "human_beyond_bound": "Control steps in which the person came nearer to a link of the arm, at its place, than "
        "`safety.human_speed_m_s` allows, which the shield does not answer for; empty without a shield.",
        "discomfort_per_min": "Time in which the arm was nearer or faster than the level allows, weighted by how much, "
        "s a minute: the integral of min(1, ((θ − d)/(d_max − d_min))^`comfort.power`) where d < θ, plus "
        "((Δα − Δα_thr)/Δα_max)² where Δα > Δα_thr; d is the arm distance (docs/comfort.md).",
        "person_level_mean": "Mean level of the simulated person of `comfort.source=frightened` beside this arm, "
        "whatever level the policy observed.",
        "balls_lost": "Shift: balls lost from the gripper.",
        "balls_per_min, protective_stops_per_min": "Shift: the columns above, 1/min.",
        "contacts_per_h, unsafe_contacts_per_h, other_collisions_per_h": "Shift: how many began, 1/h.",
        "tool_path_m": "Length of the tool's path, m.",
        "waiting_share": "Share of steps in which the tool was slower than 0.01 m/s.",
        "joint_increment_mean_deg, joint_increment_max_deg": "Mean and maximum of the largest change of a joint's "
        "target in a control step, degrees (Eq. 3 of the paper).",
        "log_dimensionless_jerk": "Smoothness of the tool's motion, −ln[(T³/v_peak²) ∫‖v̈‖² dt]; higher is smoother "
        "(Balasubramanian et al. 2015). Empty for fewer than 3 steps or no motion.",
        "human_distance_mean_m, human_distance_min_m": "Mean and minimum of the human distance, m.",
        "human_distance_by_path_m": "Mean human distance weighted by the tool's motion, so that waiting far away does "
        "not raise it, m.",
        "arm_distance_mean_m, arm_distance_min_m": "Mean and minimum of the arm distance, m; negative at an overlap.",
        "zone_intimate, zone_personal, zone_social": "Share of steps with an arm distance below 0.45 m, from there to "
        "1.2 m, and from there to 3.6 m (Hall 1966).",
        "tool_speed_near_m_s, tool_speed_beside_m_s": "Mean speed of the tool while the arm distance is below 0.45 m, "
        "and below 1 m; m/s.",
        "time_to_contact_min_s": "Minimum of arm distance over the speed at which it falls (mean over 0.2 s), s.",
        "time_to_contact_short": "Share of steps with a time to contact below 0.5 s.",
        "separation_margin_min_m": "Minimum of arm distance minus the protective distance S_p for a person who may "
        "walk at 1.6 m/s, m (ISO/TS 15066, ISO 10218-2:2025). S_p = v_h (T_r + T_s) + v_r T_r + v_r²/2a with "
        "T_s = v_r/a, reaction time T_r = 0.1 s and braking a = 5 m/s²: assumptions of this simulation, so margins "
        "compare runs and certify nothing.",
        "separation_margin_negative": "Share of steps in which that margin is negative.",
        "separation_margin_observed_min_m, separation_margin_observed_negative": "The same with the person's observed "
        "speed (mean over 0.2 s).",
    },
)
OPTIONS = Table(
    "eval/options.csv",
    "A row for each option that ran (Sutton, Precup and Singh 1999). A single policy is one option.",
    {
        "episode, comfort_level": "As in episodes.csv.",
        "option": "Name of the option.",
        "attempt": "Attempt at this option, from 1.",
        "start_step, end_step": "Control steps of the episode.",
        "termination": "`success`; `failure`: a contact or collision; `preempted`: its time was up, or its ball lost.",
    },
)
PATHS = Table(
    "eval/paths.csv",
    "With `record=true`: a row for each control step, the start being step 0.",
    {
        "episode, step": "Number of the episode, and control step.",
        "stage": "Stage in force after the step; one past the last when all are done.",
        "level": "Comfort level in force; empty without one.",
        "q0, q1, …": "Joint angles, rad.",
        "tcp_x, tcp_y, tcp_z": "Tool centre point in the cell's frame, m.",
        "human_x, human_y, human_yaw": "Axis and facing of the person, m, m, rad.",
        "human_distance_m": "Human distance, m.",
        "shield_share, protective_stops": "Share passed in this step, and stops of the episode so far.",
    },
)
CHECKPOINTS = Table(
    "eval/checkpoints.csv",
    "With `checkpoints=all`: a row for each checkpoint, and for each of `levels`. The episodes of each checkpoint are "
    "in `checkpoints/` beside the table. In a chain, each checkpoint of the part that has most is joined by those of "
    "the other parts that are nearest in fraction of their own training.",
    {
        "task, human, split, precision_m, comfort_level": "Those of all episodes of the row.",
        "episodes": "Number of episodes.",
        "policy_steps": "Decisions of training until the checkpoint; of a chain, those of all its parts.",
        "success, contact, unsafe_contact": "Shares of the episodes; `…_low` and `…_high` are their 95 % intervals.",
        "pick, place, …": "Of a chain: decisions of training of each part.",
    },
)
HANDOVER = Table(
    "handover.csv",
    "Of `evaluate handover`: success of a subtask by where it starts.",
    {
        "subtask": "Subtask that takes over.",
        "start": "`own`: a start of its training. `previous`, `expert`: where the policy before it, or the expert, "
        "ends.",
        "episodes": "Number of episodes.",
        "success, success_low, success_high": "Share of successful episodes, and its 95 % interval.",
    },
)
HANDOVER_EPISODES = Table(
    "handover_episodes.csv",
    "Each of those episodes.",
    {
        "subtask, start": "As in handover.csv.",
        "episode, spawn_id, success": "As in episodes.csv.",
    },
)
SEAMS = Table(
    "seams.csv",
    "How far the first observations of a subtask lie from those of its training.",
    {
        "subtask, start": "As in handover.csv.",
        "observation, component": "Term of the observation, and its component from 0.",
        "largest_deviation": "Largest deviation from the training mean, standard deviations.",
        "share_far": "Share of episodes beyond three standard deviations.",
    },
)
CHAIN = Table(
    "chain.csv",
    "How many options in a row succeed.",
    {
        "options": "Number of options in a row.",
        "success, success_low, success_high": "Share of episodes in which that many succeed, and its 95 % interval.",
    },
)
BENCH = Table(
    "env.csv, safety.csv, update.csv, train.csv",
    "Of `bench`: a row for each measurement. Measurements of one round were made one after the other.",
    {
        "num_envs, batch, task": "Cells at once; transitions in a batch; subtask.",
        "loop, learner": "What was measured.",
        "round, seed": "Round from 0; training seed.",
        "policy_steps_per_s, updates_per_s": "Rate, 1/s.",
        "reached": "Whether the training reached 95 % success in two checks in a row.",
        "policy_steps, seconds": "Decisions, and time of training without the checks, until then or until it gave up.",
    },
)
TABLES = (
    METRICS, TIMING, EPISODES, OPTIONS, PATHS, CHECKPOINTS, CONTROLLER_METRICS, HANDOVER, HANDOVER_EPISODES, SEAMS,
    CHAIN, BENCH,
)  # fmt: skip

FIGURES = {
    "entries": "`levels`, `speed`, `plane`: number of (training seed, episode) pairs; every level runs the same ones",
    "levels": "for each level, under `rates`, `pairs` and `all`: name → `mean`, `ci95`, `episodes`. `rates` are over "
    "all episodes; `pairs` over those that succeed at every level; `all` counts a failure at its time limit",
    "first_to_last": "change from the first to the last level: name → means `from` and `to`, `percent`, its `ci95`, "
    "`episodes`",
    "neighbours, monotone": "the same for each level and the next; whether the distance rises at no step",
    "jump_s, after_s": "`jump`: time of the change of the level, and from there to the measurement, s",
    "human_distance_m, tool_speed_m_s": "`jump`: means `without` and `with` the change, their `difference`, its `ci95`",
}
"""Keys of the JSON files of figures."""
SUMMARY = {
    "success, contact, unsafe_contact, truncated, other_collision, table_collision, self_collision": "all episodes, as "
    "shares",
    "return": "all episodes",
    "steps, policy_steps, human_distance_…, arm_distance_…": "successful episodes",
    "steps_all": "all episodes, a failure counted at the time limit in force when it ended",
    "human_distance_…_all, arm_distance_…_all": "all episodes, as measured",
    "comfort_level_mean and the other measures": "all episodes that have them",
}
"""Episodes over which each metric of summary.json is averaged."""


def names(table: Table) -> tuple[str, ...]:
    """Return the columns of a table one by one, in order."""
    return tuple(name for entry in table.columns for name in entry.split(", "))
