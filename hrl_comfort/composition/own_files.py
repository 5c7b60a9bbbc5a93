"""Files of a user's own in the place of a choice of conf/, and checkpoints by their name."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from hrl_comfort.config import ConfigError
from hrl_comfort.config.overrides import choices, override
from hrl_comfort.files.documents import read_yaml
from hrl_comfort.files.provenance import policy_steps, step_files, step_path

POLICY = re.compile(r"\+*(policy|policies(\.\w+)?|beside|initial_policy|agent\.next_skill)=")
CHECKPOINT = re.compile(r"([^,:=\s'\"\[\]{}][^,:='\"\[\]{}]*)@(best|step=(\d+)|[\w=]*)(?=$|[,'\"\]}])")


def with_own_files(overrides: Iterable[str]) -> list[str]:
    """Return `overrides` with `cell=FILE.yaml` and `human=FILE.yaml` replaced by what the files hold.

    As a policy, `RUN@best` and `RUN@step=N` are replaced by the checkpoints' files.

    Raises:
      ConfigError: there is no such file, or it is damaged.
    """
    named = (CHECKPOINT.sub(_checkpoint, line) if POLICY.match(line) else line for line in overrides)
    return [each for line in named for each in _of_file(line)]


def _checkpoint(asked: re.Match[str]) -> str:
    """Return the file of a checkpoint `RUN@…`, or a path that is there as it is; raise ConfigError if there is none."""
    if Path(asked[0]).exists():
        return asked[0]
    folder = Path(asked[1]) / "checkpoints"
    file = folder / "best.pt" if asked[3] is None else step_path(folder, int(asked[3]))
    if not (asked[3] or asked[2] == "best") or not file.is_file():
        there = [f"step={policy_steps(each)}" for each in step_files(folder)]
        there += ["best"] * (folder / "best.pt").is_file()
        raise ConfigError(f"{asked[0]}: {folder} holds no such checkpoint; it has {', '.join(there) or 'none'}")
    return str(file)


def _of_file(line: str) -> list[str]:
    """Return the overrides that a user's own file stands for; `line` itself where it is none.

    A file of `human` has keys on top of the motion that it names, one of `cell` on top of a cell without obstacles.

    Raises:
      ConfigError: there is no such file, or it is damaged.
    """
    if (match := re.fullmatch(r"(cell|human)=(['\"]?)([^'\"]+\.ya?ml)\2", line)) is None:
        return [line]
    group, known, file = match[1], choices(match[1]), Path(match[3])
    if not file.is_file():
        raise ConfigError(f"{line}: there is no such file; give one, or choose one of {', '.join(known)}")
    content = read_yaml(file)[1]
    if group == "cell":
        content = {"stations_m": None, **content}  # those of the default cell are of no use elsewhere
    base = ["cell=paper"] if group == "cell" else []
    if group == "human" and content.get("motion") in known:
        base = [f"human={content.pop('motion')}"]
    # Without `++` a mapping is set as a whole; with it Hydra would add to the entries of the default.
    if isinstance(vary := content.get("vary"), dict):  # a section, of which each key is set
        content = {key: value for key, value in content.items() if key != "vary"}
        content |= {f"vary.{key}": value for key, value in vary.items()}
    return [*base, *(override(f"{group}.{key}", value).lstrip("+") for key, value in content.items())]
