"""Functions of arrays from a graph, with their first and second derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import without_overflow
from symsimpson.graph.nodes import TINY, Exact, Graph, Value
from symsimpson.support.array_types import Floats

Entries = list[tuple[int, int, Value]]


#: Functions of arrays by their names in the graph.
FUNCTIONS: dict[str, Any] = {
    **{name: getattr(np, name) for name in ("cos", "cosh", "exp", "log", "abs")},
    **{name: getattr(np, name) for name in ("sin", "sinh", "sqrt", "tan", "tanh")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("cos", "cosh", "sin", "sinh", "tan")},
    **{"atanh": np.arctanh, "atan2": np.arctan2, "pow": np.power},
}
FUNCTIONS |= {name: np.vectorize(getattr(math, name), [float]) for name in ("erf", "erfc")}
FUNCTIONS |= without_overflow(np.exp, np.log, np.arctanh)
CONSTANTS = {"pi": math.pi, "EulerGamma": float(np.euler_gamma), "Catalan": 0.915965594177219015}
CONSTANTS["Tiny"] = TINY


class PointFunctions:
    """Functions f of the variables at a point, with their first and second derivatives.

    Second derivatives belong to the weighted sum w.f. ``variables`` are the nodes by which
    ``outputs`` are differentiated.
    """

    def __init__(self, graph: Graph, variables: Sequence[int], outputs: Sequence[Value]) -> None:
        self._graph, self._outputs, self.variables = graph, list(outputs), list(variables)
        self._compiled: dict[str, tuple[Callable[..., None], list[int]]] = {}
        self.weights = list(graph.numbers(f"weight_{r}" for r in range(len(outputs))))
        self._slopes: Entries = [
            (r, c, slope)
            for r, value in enumerate(self._outputs)
            for c, slope in enumerate(gradient(graph, value, self.variables))
            if slope[0]
        ]
        self.slopes = [(r, c) for r, c, _ in self._slopes]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_compiled": {}}  # functions are compiled again on demand

    @cached_property
    def _curvatures(self) -> Entries:
        graph, entries = self._graph, []
        total = graph.add(graph.products(self._outputs, self.weights))
        for i, slope in enumerate(gradient(graph, total, self.variables)):
            row = gradient(graph, slope, self.variables[: i + 1])
            entries += [(i, j, entry) for j, entry in enumerate(row) if entry[0]]
        return entries

    @property
    def curved(self) -> list[tuple[int, int]]:
        """Pairs of variables with a nonzero second derivative of w.f."""
        return [(i, j) for i, j, _ in self._curvatures]

    def values(self, at: Mapping[int, Any], count: int) -> Floats:
        """Return f at ``count`` points, shape (len(f), count)."""
        return self._evaluate("values", self._outputs, at, count)

    def slopes_at(self, at: Mapping[int, Any], count: int) -> Floats:
        """Return the nonzero first derivatives at points, shape (len(slopes), count)."""
        return self._evaluate("slopes", [x for *_, x in self._slopes], at, count)

    def jacobian(self, at: Mapping[int, Any], count: int) -> Floats:
        """Return the Jacobian at points, shape (count, len(f), len(variables))."""
        jacobian = np.zeros((count, len(self._outputs), len(self.variables)))
        for (r, c), slope in zip(self.slopes, self.slopes_at(at, count), strict=True):
            jacobian[:, r, c] = slope
        return jacobian

    def curvatures_at(self, at: Mapping[int, Any], weights: Floats, count: int) -> Floats:
        """Return second derivatives of w.f at points, shape (len(curved), count)."""
        known = {**at, **dict(zip(self.weights, weights, strict=True))}
        return self._evaluate("curvatures", [x for *_, x in self._curvatures], known, count)

    def _evaluate(
        self, kind: str, outputs: Sequence[Value], at: Mapping[int, Any], count: int
    ) -> Floats:
        if kind not in self._compiled:
            self._compiled[kind] = _compile_values(self._graph, outputs)
        function, needed = self._compiled[kind]
        values = np.empty((len(outputs), count))
        with np.errstate(all="ignore"):
            function(values, *(at[n] for n in needed))
        return values


def _compile_values(
    graph: Graph, outputs: Sequence[Value]
) -> tuple[Callable[..., None], list[int]]:
    """Compile a function that writes nodes to the rows of an array; return it and its symbols."""
    lines, needed = [], []
    for n in graph.descendants(n for c, n in outputs if c):
        kind, parts, _ = graph.nodes[n]
        match kind:
            case "symbol":
                needed.append(n)
                continue
            case "sum":
                text = " + ".join(_write_product(c, f"x{m}") for c, m in parts)
            case "product":
                text = " * ".join(_write_power(f"x{m}", e) for m, e in parts)
            case "function":
                given = ", ".join(_write_product(c, f"x{m}") for c, m in parts[1:])
                text = f"{parts[0]}({given})"
            case _:
                text = repr(CONSTANTS[parts[0]] if parts else 1.0)
        lines.append(f"    x{n} = {text}")
    for row, (c, n) in enumerate(outputs):
        lines.append(f"    found[{row}] = {_write_product(c, f'x{n}') if c else '0.0'}")
    head = ", ".join(["found", *(f"x{n}" for n in needed)])
    space = dict(FUNCTIONS)
    exec("\n".join([f"def fill({head}):", *lines, "    return"]), space)
    return space["fill"], needed


def _write_product(c: Exact, x: str) -> str:
    return x if c == 1 else f"-{x}" if c == -1 else f"{float(c)!r} * {x}"


def _write_power(x: str, e: Exact) -> str:
    if e == 1 or e == 2:
        return " * ".join([x] * int(e))
    if e == -1 or e == -2:
        return f"(1.0 / ({' * '.join([x] * -int(e))}))"
    return f"sqrt({x})" if 2 * e == 1 else f"{x} ** {float(e)!r}"
