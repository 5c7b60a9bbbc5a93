"""Functions of numpy arrays as plain data: graphs like those of `trace`, recorded through numpy's own protocols.

`torch.export` traces numpy's functions too, but into some thousand operations, in minutes. A graph is one of the shapes
of its example: the page refuses others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partialmethod
from typing import Any

import numpy as np
import torch
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from hrl_comfort.config import ConfigError
from hrl_comfort.studio.web.trace import constant

Array = NDArray[Any]

UFUNCS = {
    "absolute": "abs", "add": "add", "bitwise_and": "logical_and", "bitwise_or": "logical_or", "cos": "cos",
    "divide": "div", "equal": "eq", "exp": "exp", "floor": "floor", "greater": "gt", "greater_equal": "ge",
    "invert": "logical_not", "less": "lt", "less_equal": "le", "logical_or": "logical_or", "maximum": "maximum",
    "minimum": "minimum", "multiply": "mul", "negative": "neg", "not_equal": "ne", "sin": "sin", "sqrt": "sqrt",
    "subtract": "sub",
}  # fmt: skip
"""Operations of `src/graph.js` by the name of numpy's function."""
MOVES = {np.broadcast_to, np.concatenate, np.repeat, np.stack, np.tile}
"""Functions of numpy that move elements and change none."""


class Recorder:
    """The nodes of a graph under way."""

    def __init__(self) -> None:
        self.nodes: dict[str, tuple[str, list[Any]]] = {}
        self.constants: dict[str, Array] = {}

    def add(self, op: str, args: list[Any], value: Array) -> Traced:
        """Return the result of an operation; `value` is what it is of the example."""
        name = f"v{len(self.nodes)}"
        self.nodes[name] = (op, args)
        return Traced(self, name, np.asarray(value))

    def name(self, value: Any) -> Any:
        """Return how an argument is written."""
        if isinstance(value, Traced):
            return f"%{value.name}"
        if np.ndim(value) == 0 and np.isfinite(value):  # JSON has no other numbers
            return float(value)
        key = f"c{len(self.constants)}"
        self.constants[key] = np.asarray(value, dtype=np.float64)
        return f"%{key}"

    def moved(self, parts: list[Any], places: Array, value: Array) -> Traced:
        """Return the elements at `places` of the concatenated elements of `parts`; `value` is what they are."""
        op, args = self.nodes.get(getattr(parts[0], "name", ""), ("", []))
        taken = places.ravel()
        if len(parts) == 1 and op == "moved":  # of what was moved already
            sources, taken = args[0], np.asarray(args[2])[taken]
        else:
            sources = [self.name(part) for part in parts]
        return self.add("moved", [sources, list(places.shape), taken.tolist()], value)


class Traced(NDArrayOperatorsMixin):
    """An array of which numpy's functions are recorded; `value` is what it is of an example."""

    def __init__(self, recorder: Recorder, name: str, value: Array) -> None:
        self.recorder, self.name, self.value = recorder, name, value

    shape = property(lambda self: self.value.shape)
    ndim = property(lambda self: self.value.ndim)
    T = property(lambda self: self._moved(lambda array: array.T))

    def __len__(self) -> int:
        return len(self.value)

    def __getitem__(self, key: Any) -> Traced:
        return self._moved(lambda array: array[key])

    def reshape(self, *shape: int) -> Traced:
        """See numpy."""
        return self._moved(lambda array: array.reshape(*shape))

    def transpose(self, *axes: int) -> Traced:
        """See numpy."""
        return self._moved(lambda array: array.transpose(*axes))

    def _moved(self, move: Callable[[Array], Array]) -> Traced:
        places = np.arange(self.value.size).reshape(self.value.shape)
        return self.recorder.moved([self], np.asarray(move(places)), np.asarray(move(self.value)))

    def _reduced(self, op: str, reduce: Callable[..., Any], axis: Any) -> Traced:
        axes = [axis] if np.ndim(axis) == 0 else list(axis)
        return self.recorder.add(op, [f"%{self.name}", axes], reduce(self.value, axis=axis))

    max = partialmethod(_reduced, "amax", np.max)
    min = partialmethod(_reduced, "amin", np.min)
    sum = partialmethod(_reduced, "sum", np.sum)
    all = partialmethod(_reduced, "all", np.all)
    argmin = partialmethod(_reduced, "argmin", np.argmin)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **settings: Any) -> Any:
        if method != "__call__" or settings:
            return NotImplemented
        if ufunc is np.matmul:
            first, second = inputs
            return (first[:, :, None] * second[None]).sum(axis=1)
        if ufunc.__name__ not in UFUNCS:
            raise ConfigError(f"the page cannot compute numpy's {ufunc.__name__}")
        return self._elementwise(UFUNCS[ufunc.__name__], ufunc, inputs)

    def _elementwise(self, op: str, function: Callable[..., Any], inputs: tuple[Any, ...]) -> Traced:
        value = function(*(value_of(each) for each in inputs))
        full = [each if np.ndim(value_of(each)) == 0 else spread(each, np.shape(value)) for each in inputs]
        return self.recorder.add(op, [self.recorder.name(each) for each in full], value)

    def __array_function__(self, function: Any, types: Any, args: tuple[Any, ...], settings: dict[str, Any]) -> Any:
        if function is np.where:
            return self._elementwise("where", np.where, args)
        if function is np.clip:
            value, low, high = args
            return np.minimum(np.maximum(value, low), high)
        if function is np.linalg.norm:
            return np.sqrt((args[0] * args[0]).sum(**settings))
        if function is np.cumsum and settings.keys() == {"axis"}:
            return self._reduced("cumsum", np.cumsum, settings["axis"])
        if function is np.take_along_axis and settings == {"axis": 0}:
            names = [self.recorder.name(each) for each in args]
            return self.recorder.add("take_along_rows", names, np.take_along_axis(*map(value_of, args), **settings))
        if function not in MOVES:
            raise ConfigError(f"the page cannot compute numpy's {function.__name__}")
        joins = function in (np.concatenate, np.stack)
        given = list(args[0]) if joins else [args[0]]
        values = [np.asarray(value_of(each)) for each in given]
        begins = np.cumsum([0, *(each.size for each in values)])
        places = [begin + np.arange(each.size).reshape(each.shape) for begin, each in zip(begins, values, strict=False)]
        first = (places, values) if joins else (places[0], values[0])
        moved, value = (function(each, *args[1:], **settings) for each in first)
        return self.recorder.moved(given, moved, value)


def value_of(given: Any) -> Any:
    """Return the value of the example."""
    return given.value if isinstance(given, Traced) else given


def spread(given: Any, shape: tuple[int, ...]) -> Any:
    """Return `given` in a broader shape."""
    return given if np.shape(value_of(given)) == shape else np.broadcast_to(given, shape)


def recorded(function: Callable[..., Mapping[str, Any]], example: Mapping[str, Array]) -> dict[str, Any]:
    """Return the nodes and constants of `function`, from the named arrays of `example` to named arrays.

    What it does must not depend on the numbers in the arrays, only on their shapes.

    Raises:
      ConfigError: it calls what the page does not know.
    """
    recorder = Recorder()
    made = function(**{name: Traced(recorder, f"in_{name}", np.asarray(value)) for name, value in example.items()})
    outputs = {name: recorder.name(value) for name, value in made.items()}
    needed, nodes = set(outputs.values()), []
    for name, (op, args) in reversed(recorder.nodes.items()):
        if f"%{name}" in needed:
            nodes.append([name, op, args])
            needed.update(each for part in args for each in (part if isinstance(part, list) else [part]))
    return {
        "inputs": {f"%in_{name}": name for name in example},
        "shapes": {name: list(np.shape(value)) for name, value in example.items()},
        "constants": {
            name: constant(torch.tensor(value)) for name, value in recorder.constants.items() if f"%{name}" in needed
        },
        "nodes": nodes[::-1],
        "outputs": outputs,
    }
