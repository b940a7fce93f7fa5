"""Quantities that are watched: expressions in, the text of a kernel out."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from keyword import iskeyword
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.kernels.header import Header

if TYPE_CHECKING:
    from symsimpson.runtime.evaluator import Evaluator

__all__ = [
    "KINDS",
    "Observed",
    "Reduction",
    "observing_kernel",
    "read_expression",
    "read_reductions",
    "reduce_values",
]

#: Ways to reduce values over the steps of a run, in the order of their numbers; then what
#: variations of a motion tell, which are no values of states.
KINDS = ("min", "max", "mean", "first", "lyapunov", "megno", "sali")
OF_VARIATIONS = KINDS[4:]

#: Functions, and how many arguments they take at least and at most.
_FUNCTIONS = dict.fromkeys(
    ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt",
     "abs"), (1, 1),
) | {"atan2": (2, 2), "min": (1, 50), "max": (1, 50)}  # fmt: skip
_SPELLED = {"Abs": "abs", "Min": "min", "Max": "max"}
_SIGNS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**",
}  # fmt: skip
LONGEST = 2000
LARGEST = 10**300


@dataclass(frozen=True)
class Observed:
    """A quantity.

    Attributes
    ----------
    expression : str
        The quantity as it was asked for.
    text : str
        The quantity as a Python expression in names of the kernel.
    energetic : bool
        Whether it contains the energy or velocities, which come from the kernel of the energy.
    wrapped : tuple of int
        Coordinates of which the turn between -pi and pi is meant.
    """

    expression: str
    text: str
    energetic: bool
    wrapped: tuple[int, ...] = ()


@dataclass(frozen=True)
class Reduction(Observed):
    """A quantity with a name, and what of its values is kept: one of ``KINDS``."""

    name: str = ""
    kind: str = KINDS[0]

    @property
    def of_variations(self) -> bool:
        """Whether it tells of variations of a motion."""
        return self.kind in OF_VARIATIONS


def read_expression(stepper: Evaluator, expression: Any, wrapped: tuple[int, ...] = ()) -> Observed:
    """Read an expression, a text or of SymPy; an equation means the difference of its sides.

    Raises
    ------
    InputError
        If it contains something else than arithmetic, functions and the names of coordinates,
        momenta, velocities, parameters, t and energy.
    """
    reader = _Reader(stepper, "the expression")
    return Observed(str(expression), reader.read_any(expression), reader.energetic, wrapped)


def read_reductions(stepper: Evaluator, given: Mapping[str, Any] | None) -> tuple[Reduction, ...]:
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
        kind = pair[0] if isinstance(pair, tuple) and len(pair) == 2 and not pair[1] else pair
        if isinstance(kind, str) and kind in OF_VARIATIONS:
            found.append(Reduction("", "0.0", False, name=str(name), kind=kind))
            continue
        if not (isinstance(pair, tuple) and len(pair) == 2 and pair[0] in KINDS[:4]):
            raise InputError(
                f"reduce[{name!r}] is {pair!r}.\nPass a pair of one of {', '.join(KINDS[:4])} and "
                "an expression, such as ('max', 'q1') or ('first', 'q1 - 3'); or one of "
                f"{', '.join(OF_VARIATIONS)}."
            )
        reader = _Reader(stepper, f"reduce[{name!r}]")
        text = reader.read_any(pair[1])
        found.append(
            Reduction(str(pair[1]), text, reader.energetic, name=str(name), kind=str(pair[0]))
        )
    return tuple(found)


class _Reader:
    """Writes an expression anew from its syntax tree; what is not on the list is refused."""

    def __init__(self, stepper: Evaluator, where: str) -> None:
        self._where = where
        self.energetic = False
        self._known = {"t": "t", "pi": "3.141592653589793", "energy": "energy"}
        coordinates = stepper._coordinate_names
        self._known |= {a: f"a_{i}" for a, i in stepper._aliases.items()}
        of_state = {f"{x}_{q}": f"{x}_{i}" for x in "pv" for q, i in coordinates.items()}
        self._double = set(stepper._aliases) & {"t", "energy", *of_state}
        self._known |= of_state
        self._known |= {q: f"q_{i}" for q, i in coordinates.items()}
        self._moving = set(coordinates)

    def read_any(self, expression: Any) -> str:
        """Read a text, an expression of SymPy, or an equation."""
        for k, symbol in enumerate(sorted(getattr(expression, "free_symbols", ()), key=str)):
            name = str(symbol)
            if name.isidentifier() and not iskeyword(name):
                continue
            if name not in self._known:  # a text with it could be read as something else
                raise self._refuse(f"it contains the unknown name {name!r}")
            plain = f"symbol_{k}_"
            self._known[plain] = self._known[name]
            expression = expression.xreplace({symbol: type(symbol)(plain)})
        if hasattr(expression, "lhs") and hasattr(expression, "rhs"):
            return self.read(f"({expression.lhs}) - ({expression.rhs})")
        return self.read(str(expression))

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
            f"{self._where}: {why}.\nUse numbers, + - * / **, "
            f"{', '.join(sorted(_FUNCTIONS))}, and the names {', '.join(self._known)}."
        )

    def _write(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=bool()):
                raise self._refuse("it contains a truth value")
            case ast.Constant(value=int() | float() as number):
                if not -LARGEST < number < LARGEST:
                    raise self._refuse("it contains a number that is too large")
                return repr(float(number))
            case ast.Name(id=name) if name in self._known:
                self._check_single(name)
                self.energetic |= self._known[name].startswith(("energy", "v_"))
                return self._known[name]
            case ast.Call(
                func=ast.Name(id="Derivative"),
                args=[ast.Call(func=ast.Name(id=name), args=[ast.Name(id="t")]), ast.Name(id="t")],
            ) if name in self._moving:
                return self._write(ast.Name(id=f"v_{name}"))  # SymPy's velocity
            case ast.Call(func=ast.Name(id=name), args=[ast.Name(id="t")], keywords=[]) if (
                name in self._moving
            ):
                return self._known[name]  # SymPy writes q1(t)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if (
                _SPELLED.get(name, name) in _FUNCTIONS and arguments
            ):
                least, most = _FUNCTIONS[_SPELLED.get(name, name)]
                if not least <= len(arguments) <= most:
                    raise self._refuse(f"{name} is given {len(arguments)} arguments")
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

    def _check_single(self, name: str) -> None:
        """Refuse a name that means a parameter and something else."""
        if name in self._double:
            raise self._refuse(f"{name!r} is a parameter, and the name of another quantity, too")


def observing_kernel(header: Header, found: Sequence[Observed], first: int | None = None) -> str:
    """Write a kernel that puts the quantities into rows from ``first`` on.

    Those are behind the rows of the module unless it is said, for the workspace of a run.
    """
    running = first is not None
    first = header.rows if first is None else int(first)
    lines = [
        "from math import acos, asin, atan, atan2, cos, cosh, exp, log, sin, sinh, sqrt, tan, tanh",
        "",
        "",
        "def observe(h, t, workspace):",
        '    """Quantities that are watched."""',
        "    W = carray(workspace, (ROWS, LANES))",
        "    for lane in range(LANES):",
    ]
    rows = [(f"q_{i}", f"POSITION + {i}") for i in range(header.n)]
    rows += [(f"p_{i}", f"MOMENTUM + {i}") for i in range(header.n)]
    rows += [(f"v_{i}", f"VELOCITY + {i}") for i in range(header.n)]
    rows += [(f"a_{i}", f"PARAMETER + {i}") for i in range(len(header.parameters))]
    rows.append(("energy", "ENERGY"))
    if header.retimed and running:
        rows.append(("t", "TIME"))
    lines += [f"        {name} = W[{row}, lane]" for name, row in rows]
    lines += [f"        W[{first + k}, lane] = {one.text}" for k, one in enumerate(found)]
    return "\n".join(lines) + "\n"


def reduce_values(
    found: Sequence[Reduction], t: NDArray[np.float64], values: NDArray[np.float64]
) -> list[float]:
    """Reduce values of quantities at the states of a run, shape (len(t), len(found)).

    What variations tell is not known of states.
    """
    return [
        float("nan")
        if one.of_variations
        else _first_crossing(t, value)
        if one.kind == "first"
        else float(getattr(value, one.kind)())
        for one, value in zip(found, values.T, strict=True)
    ]


def _first_crossing(t: NDArray[np.float64], value: NDArray[np.float64]) -> float:
    positive = np.flatnonzero(value > 0)
    if positive.size == 0:
        return float("nan")
    k = int(positive[0])
    if k == 0:
        return float(t[0])
    return float(t[k] - (t[k] - t[k - 1]) * value[k] / (value[k] - value[k - 1]))
