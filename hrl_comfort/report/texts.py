"""Sentences of a report: what an evaluation came to, and what is missing with the command that writes it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hrl_comfort.analysis.summary import with_totals
from hrl_comfort.analysis.tables import cell
from hrl_comfort.config import CONTROL_STEP_S, HIERARCHY
from hrl_comfort.config.overrides import override
from hrl_comfort.files.run_folder import Run

TASK = "cycle"
"""Task of the chain of a hierarchy's options."""
PARTS = ("groups", "paths", "checkpoints")
"""Fields of `Run` that an evaluation may lack."""


def summary(run: Run) -> str:
    """Return what an evaluation came to in a sentence, of several levels in one each for the first and the last."""
    every = with_totals(run.groups or [], run.episodes)
    groups = [each for each in every if each.get("seen") in (None, "all")] or every
    people = "with nobody in the cell" if groups[0]["human"] == "none" else f"beside people ({groups[0]['human']})"
    sentences = []
    for group in groups[:1] + groups[1:][-1:]:
        found = group["metrics"]
        of = f"{group['task']}{f' at level {level}' if (level := group.get('comfort_level')) else ''} {people}"
        text = f"{of} succeeds in {_percent(found['success'])} of {group['episodes']} episodes"
        if steps := found.get("steps"):
            text += f", after {steps['mean']:.0f} control steps ({steps['mean'] * CONTROL_STEP_S:.1f} s) on average"
        if "objects_per_min" in found:
            text = (
                f"{of} places {cell(found['objects_per_min'], 1, 2)} objects a minute in {group['episodes']} episodes"
            )
        if group["human"] != "none" and "contact" in found:
            text += f"; the arm touches the person in {_percent(found['contact'])}"
            text += f" and unsafely in {_percent(found['unsafe_contact'])}" if "unsafe_contact" in found else ""
        sentences.append(f"{text[0].upper()}{text[1:]}.")
    return " ".join(sentences)


def _percent(share: Mapping[str, Any]) -> str:
    """Return a share with its interval, %."""
    mean, _, interval = cell(share, 100).partition(" ")
    return f"{mean} % {interval}".strip()


def missing(folder: Path, runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Return what the page about `folder` lacks, each with the command that writes it, empty where there is none."""
    found = []
    trained = [run for run in runs if run.metrics is not None or "training" in run.configs]
    subjects = [(run.name, run.folder, _policy(run), run.folder.glob("checkpoints/step_*.pt")) for run in trained]
    for run in trained:
        if run.metrics is None or len(run.metrics) < 2:
            found.append((f"{run.name}: no learning curve, no metrics.csv of two rows or more", ""))
    if trained and (folder / HIERARCHY).is_file() and TASK not in [run.name for run in trained]:
        policy = [override("policy", folder), *_levels(trained[0])] if all(map(_policy, trained)) else []
        subjects.append((f"{TASK}, the chain", folder / TASK, policy, folder.glob("*/checkpoints/step_*.pt")))
    for name, place, policy, checkpoints in subjects:
        every = [each for each in runs if each.evaluation and place in (each.evaluation.parent, _controller(each))]
        lacks = {part: all(getattr(each, part) is None for each in every) for part in PARTS}
        if lacks["groups"] or lacks["paths"]:
            files = "eval/summary.json and eval/episodes.csv" if lacks["groups"] else "eval/paths.csv"
            what = "not evaluated" if lacks["groups"] else "no paths"
            found.append((f"{name}: {what}, no {files}", _evaluate(policy, "record=true")))
        if lacks["checkpoints"] and len(list(checkpoints)) > 1:
            what = "no success by checkpoint, no eval/checkpoints.csv"
            found.append((f"{name}: {what}", _evaluate(policy, "checkpoints=all")))
    return found


def _policy(run: Run) -> list[str]:
    """Return the overrides of an evaluation of a training; none where it has not written its policy."""
    if (run.folder / "meta_controller.pt").is_file():
        named = {**(run.config.get("policies") or {}), "meta_controller": run.folder}
        skills = [override(f"policies.{name}", source) for name, source in named.items()]
        return ["meta_controller=learned", *skills, override("output", run.folder / "eval_validation")]
    if not (run.folder / "policy.pt").is_file():
        return []
    return [override("policy", run.folder), *_levels(run)]


def _controller(run: Run) -> Path | None:
    """Return the run of the controller that an evaluation is of."""
    found = (run.config.get("policies") or {}).get("meta_controller")
    return Path(found) if found else None


def _levels(run: Run) -> list[str]:
    """Return the overrides that evaluate a policy of all levels at the first and the last."""
    comfort = run.config.get("comfort", {})
    last = comfort.get("levels") if comfort.get("source") == "random" else None
    return [override("levels", [1, last])] if last else []


def _evaluate(policy: Sequence[str], last: str) -> str:
    """Return the command of an evaluation that is for choosing, as it is pasted into a shell."""
    return shlex.join(["hrl-comfort", "evaluate", *policy, "split=validation", last]) if policy else ""
