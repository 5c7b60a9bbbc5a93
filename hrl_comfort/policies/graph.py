"""A trained policy as one graph, from named quantities of the cell to what it commands, and its ONNX file."""

from __future__ import annotations

import ast
import inspect
import json
import logging
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import torch
from torch import Tensor, nn

from hrl_comfort.config import CONTROL_STEP_S, ConfigError, EnvConfig, GripperConfig
from hrl_comfort.files.atomic import write_atomically
from hrl_comfort.files.versions import INPUTS, ONE_PERSON
from hrl_comfort.policies.actor import Policy
from hrl_comfort.tasks import State, Subtask
from hrl_comfort.tasks.observations.standard import nearest_alone
from hrl_comfort.tasks.state import ABSENT
from hrl_comfort.tasks.subtask import StateFunction

ONNX = "onnx:"
"""Prefix of a file that `hrl-comfort export` wrote."""
OUTPUT = "joint_increment"
NO_GRIPPER = GripperConfig().name
"""Of policies that do not say what their gripper was, too."""
INCREMENTS = "(N, joints) rad, added to the joint targets in each control step of a decision"
FINGERS = "; a last number is the target of the fingers, from -1, open, to 1, closed"
DERIVED = tuple(name for name, each in vars(State).items() if isinstance(each, cached_property))
"""Values that a state derives from its fields: for one target, not for all objects."""
NAMES = (*(field.name for field in fields(State)), *DERIVED)


def inputs_of(function: StateFunction, state: State) -> tuple[str, ...]:
    """Return the fields of `state` that `function` reads, and what it reads of DERIVED, in the order of NAMES."""
    read: set[str] = set()
    function(cast(State, _Read(state, read)))
    return tuple(name for name in NAMES if name in read)


class _Read:
    """A state that adds to `names` which of NAMES are read of it, but for those `replaced` and absent."""

    def __init__(self, state: State, names: set[str], replaced: frozenset[str] = frozenset()) -> None:
        self._state, self._names, self._replaced = state, names, replaced

    def __getattr__(self, name: str) -> Tensor:
        value: Tensor = getattr(self._state, name)
        absent = isinstance(value, Tensor) and value.shape == ABSENT.shape
        if name not in self._replaced and not absent:
            self._names.add(name)
        return value

    def with_(self, **changes: Tensor) -> _Read:
        """Return a copy with the given fields replaced."""
        return _Read(self._state.with_(**changes), self._names, self._replaced | changes.keys())


class PolicyGraph(nn.Module):
    """Observation terms, module and scale of a policy: named fields of State to joint increments, rad.

    Floating-point inputs are float32. The output (N, joints) is what the joint targets move by in each control
    step of the decision; with a hand a last number is the target of its fingers, from -1, open, to 1, closed.
    """

    def __init__(self, policy: Policy, task: Subtask, inputs: Sequence[str], max_step_rad: float) -> None:
        super().__init__()
        self.policy, self._hand = policy.module, has_hand(policy.spec)
        self._task, self._inputs, self._max_step_rad = task, tuple(inputs), max_step_rad

    def forward(self, *values: Tensor) -> Tensor:
        """Return the increments (N, joints), and perhaps fingers, for the inputs, in the order of `inputs`."""
        observation = self._task.observe(state_of(self._inputs, values)).float()
        action = self.policy(observation)
        if not self._hand:
            return self._max_step_rad * action
        return torch.cat([self._max_step_rad * action[:, :-1], action[:, -1:]], dim=-1)


def has_hand(spec: dict[str, Any]) -> bool:
    """Return whether the last number of the actions of a policy of this description is the target of fingers."""
    return bool(spec["environment"].get("gripper", NO_GRIPPER) != NO_GRIPPER)


def state_of(inputs: Sequence[str], values: Sequence[Tensor]) -> State:
    """Return a state that knows `values` as its `inputs`, of NAMES, and no other."""
    return State.of(**dict(zip(inputs, values, strict=True)))


def arguments(state: State, inputs: Sequence[str]) -> tuple[Tensor, ...]:
    """Return the inputs of a graph from a state, of this version's names or earlier ones: real numbers as float32."""
    known = {name: getattr(state, INPUTS.get(name, name)) for name in inputs}
    values = (value[:, 0] if name in ONE_PERSON else value for name, value in known.items())
    return tuple(value.float() if value.is_floating_point() else value for value in values)


def description(task: Subtask, inputs: Sequence[str], config: EnvConfig, spec: dict[str, Any]) -> dict[str, Any]:
    """Return what a user of the file needs to know, as plain values."""
    meanings = field_meanings()
    return {
        "task": task.name,
        "robot": config.robot.name,
        "joints": spec["action_dim"] - has_hand(spec),
        "gripper": spec["environment"].get("gripper", NO_GRIPPER),
        "inputs": {name: meanings[name] for name in inputs},
        "output": {OUTPUT: INCREMENTS + FINGERS * has_hand(spec)},
        "frame": "cell: origin in the robot's base, z up",
        "stages": [stage.name for stage in task.stages],
        "control_step_s": CONTROL_STEP_S,
        "action_repeat": config.task.action_repeat,
        "max_step_deg": config.task.max_step_deg,
        "levels": spec["environment"].get("levels"),
    }


def field_meanings() -> dict[str, str]:
    """Return shape, unit and meaning of each of NAMES, from its docstring."""
    (state,) = ast.parse(textwrap.dedent(inspect.getsource(State))).body
    assert isinstance(state, ast.ClassDef)
    said = {
        each.target.id: ast.literal_eval(text.value)
        for each, text in pairwise(state.body)
        if isinstance(each, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(each.target, ast.Name)
    }
    said |= {each.name: ast.get_docstring(each) for each in state.body if isinstance(each, ast.FunctionDef)}
    return {name: " ".join(said[name].split()) for name in NAMES}


def write_onnx(graph: PolicyGraph, example: State, inputs: Sequence[str], about: dict[str, Any], path: Path) -> None:
    """Write the graph to an ONNX file with any number of rows, and to a `torch.export` archive (.pt2) beside it.

    Raises:
      ConfigError: the packages of the extra `export` are not installed.
    """
    need("onnx")
    need("onnxscript")
    rows = torch.export.Dim("rows", min=1)
    given = arguments(example.rows(torch.tensor([0, 0])), inputs)
    program = torch.export.export(graph.eval(), given, dynamic_shapes=(tuple({0: rows} for _ in given),))
    write_atomically(path.with_suffix(".pt2"), lambda file: torch.export.save(program, file))
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it reports on torchvision, which is not needed
    with warnings.catch_warnings(action="ignore", category=FutureWarning):
        made = torch.onnx.export(program, input_names=list(inputs), output_names=[OUTPUT], verbose=False, dynamo=True)
    assert made is not None
    model = made.model_proto
    entry = model.metadata_props.add()
    entry.key, entry.value = "hrl_comfort", json.dumps(about)
    write_atomically(path, lambda file: file.write(model.SerializeToString()))


@dataclass(frozen=True, eq=False)
class OnnxPolicy:
    """A policy from a file that `write_onnx` wrote, run by ONNX Runtime on one thread.

    One that was exported beside one person sees the nearest of several.
    """

    session: Any
    about: dict[str, Any]

    def __call__(self, state: State) -> Tensor:
        """Return actions (N, joints), or (N, joints + 1) with fingers, in [-1, 1], float64.

        Raises:
          ConfigError: it sees several people, and there are others.
        """
        names = tuple(self.about["inputs"])
        counts = {each.name: each.shape[1:2] for each in self.session.get_inputs() if each.name.startswith("humans_")}
        counts |= {ONE_PERSON[name]: [1] for name in names if name in ONE_PERSON}
        for people in (state, nearest_alone(state)):
            if all(list(getattr(people, name).shape[1:2]) == count for name, count in counts.items()):
                break
        else:
            many = state.humans_pos.shape[1]
            raise ConfigError(f"human.others makes {many} people; the policy was exported beside several others")
        state = people
        given = {name: value.numpy() for name, value in zip(names, arguments(state, names), strict=True)}
        increment = torch.from_numpy(self.session.run([OUTPUT], given)[0]).double()
        joints = self.about["joints"]
        increment[:, :joints] /= torch.deg2rad(torch.tensor(self.about["max_step_deg"]).double())
        return increment.clamp(-1.0, 1.0)


def read_onnx(source: str) -> OnnxPolicy:
    """Return the policy `onnx:FILE`.

    Raises:
      ConfigError: there is no such file, it is damaged, `hrl-comfort export` did not write it, or ONNX Runtime is
        not installed.
    """
    runtime = need("onnxruntime")
    path = Path(source.removeprefix(ONNX))
    if not path.is_file():
        raise ConfigError(f"policy={source!r}: there is no file {path}")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        about = json.loads(session.get_modelmeta().custom_metadata_map["hrl_comfort"])
    except KeyError:
        raise ConfigError(f"policy={source!r} was not written by hrl-comfort export") from None
    except Exception as error:  # ONNX Runtime's errors share no other class
        raise ConfigError(f"policy={source!r} is not an ONNX file: {' '.join(str(error).split()):.200}") from error
    return OnnxPolicy(session, about)


def need(name: str) -> ModuleType:
    """Return a package of the extra `export`.

    Raises:
      ConfigError: it is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise ConfigError(f"{name} is not installed: pip install 'hrl-comfort[export]'") from error
