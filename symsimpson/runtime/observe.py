"""Quantities that are watched during a run: expressions in, the text of a kernel out."""

from __future__ import annotations

import ast
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.load import Facts

if TYPE_CHECKING:
    from symsimpson.runtime.trajectory import Trajectory

__all__ = ["KINDS", "Reduction", "observing_kernel", "read_reductions", "reduce_states"]

#: Ways to reduce values over the steps of a run, in the order of their numbers.
KINDS = ("min", "max", "mean", "first")

_FUNCTIONS = {
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log",
    "sqrt", "abs", "min", "max",
}  # fmt: skip
_SPELLED = {"Abs": "abs", "Min": "min", "Max": "max"}
_SIGNS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**",
}  # fmt: skip
LONGEST = 2000


@dataclass(frozen=True)
class Reduction:
    """A quantity, and what of its values is kept.

    Attributes
    ----------
    name, kind : str
    expression : str
        The quantity as it was asked for.
    text : str
        The quantity as a Python expression in names of the kernel.
    energy : bool
        Whether it contains the energy.
    """

    name: str
    kind: str
    expression: str
    text: str
    energy: bool


def read_reductions(facts: Facts, given: Mapping[str, Any] | None) -> tuple[Reduction, ...]:
    """Read a mapping from names to pairs of a kind and an expression.

    Raises
    ------
    InputError
        If a kind is unknown, or an expression contains something else than arithmetic, functions
        and the names of coordinates, momenta, parameters, t and energy.
    """
    if given is None:
        return ()
    if not isinstance(given, Mapping):
        raise InputError(
            f"reduce is {type(given).__name__}, not a mapping.\n"
            "Pass reduce={'highest': ('max', 'q1')}."
        )
    found = []
    for name, pair in given.items():
        if not (isinstance(pair, tuple) and len(pair) == 2 and pair[0] in KINDS):
            raise InputError(
                f"reduce[{name!r}] is {pair!r}.\nPass a pair of one of {', '.join(KINDS)} and an "
                "expression, such as ('max', 'q1') or ('first', 'q1 - 3')."
            )
        reader = _Reader(facts, name)
        text = reader.read(str(pair[1]))
        found.append(Reduction(str(name), pair[0], str(pair[1]), text, reader.energy))
    return tuple(found)


class _Reader:
    """Writes an expression anew from its syntax tree; what is not on the list is refused."""

    def __init__(self, facts: Facts, name: str) -> None:
        self._name = name
        self.energy = False
        self._known = {"t": "t", "pi": "3.141592653589793", "energy": "energy"}
        self._known |= {q: f"q_{i}" for i, q in enumerate(facts.coordinates)}
        self._known |= {f"p_{q}": f"p_{i}" for i, q in enumerate(facts.coordinates)}
        self._known |= {a: f"a_{i}" for i, a in enumerate(facts.parameters)}
        self._moving = set(facts.coordinates)

    def read(self, text: str) -> str:
        if len(text) > LONGEST:
            raise self._refuse(f"it has {len(text)} characters, more than {LONGEST}")
        try:
            body = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise self._refuse("it is no expression") from None
        try:
            return self._write(body)
        except RecursionError:
            raise self._refuse("it is nested too deeply") from None

    def _refuse(self, why: str) -> InputError:
        return InputError(
            f"reduce[{self._name!r}]: {why}.\nUse numbers, + - * / **, "
            f"{', '.join(sorted(_FUNCTIONS))}, and the names {', '.join(self._known)}."
        )

    def _write(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=bool()):
                raise self._refuse("it contains a truth value")
            case ast.Constant(value=int() | float() as number):
                return repr(float(number))
            case ast.Name(id=name) if name in self._known:
                self.energy |= name == "energy"
                return self._known[name]
            case ast.Call(func=ast.Name(id=name), args=[ast.Name(id="t")], keywords=[]) if (
                name in self._moving
            ):
                return self._known[name]  # SymPy writes q1(t)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if (
                _SPELLED.get(name, name) in _FUNCTIONS and arguments
            ):
                inner = ", ".join(map(self._write, arguments))
                return f"{_SPELLED.get(name, name)}({inner})"
            case ast.UnaryOp(op=op, operand=operand) if isinstance(op, (ast.USub, ast.UAdd)):
                sign = "-" if isinstance(op, ast.USub) else "+"
                return f"({sign}{self._write(operand)})"
            case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)) if (
                abs(power) < 100
            ):
                return f"({self._write(left)} ** {power})"
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _SIGNS:
                return f"({self._write(left)} {_SIGNS[type(op)]} {self._write(right)})"
        raise self._refuse(f"it contains {ast.unparse(node)[:60]!r}")


def observing_kernel(facts: Facts, found: Sequence[Reduction]) -> str:
    """Write a kernel that puts the quantities into the rows behind the workspace's others."""
    lines = [
        "from math import acos, asin, atan, atan2, cos, cosh, exp, log, sin, sinh, sqrt, tan, tanh",
        "",
        "",
        "def observe(h, t, workspace):",
        '    """Quantities that are watched."""',
        "    W = carray(workspace, (ROWS, LANES))",
        "    for lane in range(LANES):",
    ]
    rows = [(f"q_{i}", f"POSITION + {i}") for i in range(facts.n)]
    rows += [(f"p_{i}", f"MOMENTUM + {i}") for i in range(facts.n)]
    rows += [(f"a_{i}", f"PARAMETER + {i}") for i in range(len(facts.parameters))]
    rows.append(("energy", "ENERGY"))
    lines += [f"        {name} = W[{row}, lane]" for name, row in rows]
    lines += [f"        W[{facts.rows + k}, lane] = {one.text}" for k, one in enumerate(found)]
    return "\n".join(lines) + "\n"


def reduce_states(
    found: Sequence[Reduction], run: Trajectory, parameters: NDArray[np.float64]
) -> list[float]:
    """Reduce quantities over the stored states of a single run."""
    names: dict[str, Any] = {
        name: getattr(np, {"asin": "arcsin", "acos": "arccos", "atan": "arctan",
                           "atan2": "arctan2"}.get(name, name))
        for name in _FUNCTIONS - {"min", "max"}
    }  # fmt: skip
    names |= {
        "min": lambda *x: functools.reduce(np.minimum, x),
        "max": lambda *x: functools.reduce(np.maximum, x),
    }
    names |= {f"q_{i}": x for i, x in enumerate(run.q.T)}
    names |= {f"p_{i}": x for i, x in enumerate(run.p.T)}
    names |= {f"a_{i}": x for i, x in enumerate(parameters)}
    names |= {"t": run.t, "energy": run.energy, "__builtins__": {}}
    reduced = []
    for one in found:
        value = eval(one.text, names)  # written by the reader above, from its list alone
        value = np.broadcast_to(value, run.t.shape)
        if one.kind == "first":
            reduced.append(_first_crossing(run.t, value))
        else:
            reduced.append(float(getattr(value, one.kind)()))
    return reduced


def _first_crossing(t: NDArray[np.float64], value: NDArray[np.float64]) -> float:
    positive = np.flatnonzero(value > 0)
    if positive.size == 0:
        return float("nan")
    k = int(positive[0])
    if k == 0:
        return float(t[0])
    return float(t[k] - (t[k] - t[k - 1]) * value[k] / (value[k] - value[k - 1]))
