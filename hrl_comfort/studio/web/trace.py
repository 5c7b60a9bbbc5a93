"""Functions of `State` as plain data: graphs traced by `torch.export`, which the page evaluates in float64."""

from __future__ import annotations

import base64
import operator
import warnings
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, fx, nn

from hrl_comfort.config import ConfigError
from hrl_comfort.policies.graph import state_of
from hrl_comfort.tasks import State, Subtask

OPS = {
    "abs", "add", "addmm", "amax", "any", "arange", "argmin", "bitwise_and", "bitwise_not", "bitwise_or", "cat",
    "clamp", "cos", "div", "eq", "expand", "full", "full_like", "gather", "ge", "gt", "index", "index_select", "le",
    "linalg_vector_norm", "logical_and", "logical_not", "logical_or", "lt", "maximum", "min", "minimum", "mul", "ne",
    "neg", "permute", "relu", "remainder", "scalar_tensor", "select", "sin", "slice", "sort", "split_with_sizes",
    "sqrt", "squeeze", "sub", "sum", "tanh", "unsqueeze", "view", "where",
}  # fmt: skip
"""Operations of `src/graph.js`; one whose arguments it would not understand is refused too."""
PLAIN = {"_to_copy", "alias", "clone"}
"""Operations that change neither values nor shape where all numbers are float64."""
CHECKS = {"_assert_async", "_assert_tensor_metadata"}
KINDS = {"dtype", "layout", "device", "pin_memory", "memory_format"}


class StageGraph(nn.Module):
    """The stage in force after an instant, from named fields of State."""

    def __init__(self, task: Subtask, inputs: Sequence[str]) -> None:
        super().__init__()
        self._task, self._inputs = task, tuple(inputs)

    def forward(self, *values: Tensor) -> Tensor:
        """Return the stages (N,) int64 for the inputs, in the order of `inputs`."""
        return self._task.next_stage(state_of(self._inputs, values))


def traced(graph: nn.Module, state: State, inputs: Sequence[str]) -> dict[str, Any]:
    """Return the nodes and constants of `graph`, a function of the fields `inputs` of one row of `state`.

    A string argument that begins with % is the value of that name; values are row-major.

    Raises:
      ConfigError: it has an operation that the page does not know.
    """
    given = tuple(getattr(state, name) for name in inputs)
    with warnings.catch_warnings(action="ignore", category=FutureWarning):  # of torch about itself
        program = torch.export.export(graph.eval(), given).run_decompositions()
    tensors = {**program.state_dict, **program.constants}
    signature, constants, nodes = program.graph_signature, {}, []
    known = {**signature.inputs_to_parameters, **signature.inputs_to_buffers}
    known |= signature.inputs_to_lifted_tensor_constants
    for node in program.graph.nodes:
        if node.op == "placeholder" and node.name in known and node.users:
            constants[node.name] = constant(tensors[known[node.name]])
        elif node.op == "call_function":
            name = "getitem" if node.target is operator.getitem else str(node.target).split(".")[1]
            if name not in CHECKS:
                nodes.append([node.name, *_call(name, node)])
    (output,) = next(node for node in program.graph.nodes if node.op == "output").args[0]
    names = [f"%{name}" for name in signature.user_inputs]
    return {
        "inputs": dict(zip(names, inputs, strict=True)),
        "shapes": {name: list(value.shape) for name, value in zip(inputs, given, strict=True)},
        "constants": constants,
        "nodes": nodes,
        "outputs": {"made": f"%{output}"},
    }


def constant(tensor: Tensor) -> dict[str, Any]:
    """Return a tensor as its shape and its values, little-endian in base64: float64, or float32 of any other type."""
    kind, form = ("float64", "<f8") if tensor.dtype == torch.float64 else ("float32", "<f4")
    values = tensor.detach().contiguous().numpy().astype(form).tobytes()
    return {"shape": list(tensor.shape), kind: base64.b64encode(values).decode()}


def _call(name: str, node: fx.Node) -> tuple[str, list[Any]]:
    """Return the operation and the arguments of a node."""
    if name in PLAIN and not _narrows(node):
        return "same", [_argument(node.args[0])]
    if name == "_to_copy" and node.kwargs.get("dtype") == torch.bool:
        return "ne", [_argument(node.args[0]), 0]
    if (name != "getitem" and name not in OPS) or node.kwargs.keys() - KINDS or _unlike_the_page(name, node.args):
        raise ConfigError(
            f"the page cannot compute {node.target} of a policy; export= takes the project's observations"
        )
    return name, [_argument(each) for each in node.args]


def _narrows(node: fx.Node) -> bool:
    """Return whether a cast changes values: to an integer or a bool."""
    source, target = node.args[0], node.kwargs.get("dtype")
    assert isinstance(source, fx.Node)
    return isinstance(target, torch.dtype) and not torch.can_cast(source.meta["val"].dtype, target)


def _unlike_the_page(name: str, args: tuple[Any, ...]) -> bool:
    """Return whether the page's operation of this name computes something else for these arguments."""
    if name == "linalg_vector_norm":
        return args[1:2] not in ((), (2,))
    if name == "index":
        *before, last = args[1]
        return any(each is not None for each in before) or last.meta["val"].dtype == torch.bool
    if name == "min":
        return len(args) == 1
    return name == "sort" and any(args[2:])


def _argument(value: Any) -> Any:
    if isinstance(value, fx.Node):
        return f"%{value.name}"
    return [_argument(each) for each in value] if isinstance(value, list | tuple) else value
