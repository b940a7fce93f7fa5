"""Traces: library texts that are executed with expressions for numbers."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from types import CodeType
from typing import Any, TypeAlias

import sympy as sp

from symsimpson.discrete.combined_rows import rationalise
from symsimpson.errors import GenerationError, reject
from symsimpson.graph.nodes import exact
from symsimpson.lower.expression import Expression
from symsimpson.lower.levels import Definitions, Level


class Irrational:
    """An exact irrational number; roots cancel, and denominators have no roots."""

    __slots__ = ("value",)

    def __init__(self, value: sp.Expr) -> None:
        self.value = value

    def _with(self, other: Any, operate: Callable[[Any, Any], Any]) -> Any:
        if isinstance(other, Expression):
            return operate(other.graph.of(self.value), other)
        if not isinstance(other, (int, Fraction, Irrational)):
            return NotImplemented
        return _combine(operate, self.value, _to_sympy(other))

    def __neg__(self) -> ExactNumber:
        return Irrational(-self.value)

    def __add__(self, other: Any) -> Any:
        return self._with(other, operator.add)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        return self._with(other, operator.mul)

    __rmul__ = __mul__

    def __eq__(self, other: object) -> bool:
        """Return whether another irrational number is equal; rational numbers never are."""
        return isinstance(other, Irrational) and self.value == other.value

    def __hash__(self) -> int:
        return hash(self.value)

    def __gt__(self, other: Any) -> bool:
        return bool(self.value > _to_sympy(other))

    def __lt__(self, other: Any) -> bool:
        return bool(self.value < _to_sympy(other))


#: A number of a table.
ExactNumber: TypeAlias = int | Fraction | Irrational


class ExactTable:
    """A table of the scheme with exact entries."""

    def __init__(self, entries: tuple[Any, ...]) -> None:
        self._entries = entries

    def __getitem__(self, place: int | tuple[int, ...]) -> Any:
        entry: Any = self._entries
        for k in place if isinstance(place, tuple) else (place,):
            if k < 0:
                raise IndexError(f"A text reads the entry {place} of a table.")
            entry = entry[k]
        return ExactTable(entry) if isinstance(entry, tuple) else exact_number(entry)

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self._entries)))

    def __len__(self) -> int:
        return len(self._entries)


def exact_number(number: Any) -> ExactNumber:
    """Return a number of SymPy as a whole number, a fraction, or an irrational number."""
    if isinstance(number, (int, Fraction, Irrational)):
        return number
    value = sp.sympify(number)
    return exact(Fraction(int(value.p), int(value.q))) if value.is_Rational else Irrational(value)


def _to_sympy(number: ExactNumber) -> sp.Expr:
    if isinstance(number, Irrational):
        return number.value
    return sp.Rational(number.numerator, number.denominator)


@lru_cache(maxsize=10_000)  # the same products of entries for all pairs of coordinates
def _combine(operate: Callable[[Any, Any], Any], x: sp.Expr, y: sp.Expr) -> ExactNumber:
    return exact_number(rationalise(operate(x, y)))


#: The point of functions that have no node and no control point as argument.
PLACES = {"path_start": "start", "path_end": "end"}
_OPERATIONS = {"Add": operator.add, "Sub": operator.sub, "Mult": operator.mul}


class TracedRows:
    """The rows of one lane: a text names them by ``W[row, lane]``.

    A row holds a value, or a function that makes its value when it is read for the first time.
    """

    def __init__(self, named: Callable[..., Any], name: Callable[[int], str]) -> None:
        self.values: dict[int, Any] = {}
        self._named, self._name = named, name

    def raw(self, row: int) -> Any:
        """Return a row's value without a name. Raises GenerationError if the row was not set."""
        if row not in self.values:
            reject(
                f"A text reads the row {self._name(row)} before it is set.", error=GenerationError
            )
        value = self.values[row]
        if callable(value):
            value = self.values[row] = value()
        return value

    def __getitem__(self, place: tuple[int, int]) -> Any:
        row = place[0]
        value = self.values[row] = self._named(lambda: self._name(row), self.raw(row))
        return value

    def __setitem__(self, place: tuple[int, int], value: Any) -> None:
        self.values[place[0]] = value


class Trace:
    """Executes functions of texts: Python resolves loops, tables, and conditions on these.

    A value that a text reads from a local variable or from a row becomes a definition.

    ``names`` has all other names in the texts: first rows of blocks, tables, sizes, and functions
    in Python. ``sections`` has the section title of each function.
    """

    def __init__(
        self,
        graph: Definitions,
        texts: Iterable[str],
        names: Mapping[str, Any],
        row_name: Callable[[int], str],
        spelt_index: Callable[[str, int], str],
        sections: Mapping[str, str],
    ) -> None:
        self._graph, self._spelt_index = graph, spelt_index
        self.section, self.place = "constants", ""
        self.rows = TracedRows(self.name_value, row_name)
        self.names: dict[str, Any] = {
            **names,
            "W": self.rows,
            "real": exact_number,
            "abs": self._absolute,
            "min": self._least,
            "sincos": self._sincos,
            "_use": self._name_local,
            "_add_to": self._add,
            "_add_to_row": self._add_to_row,
            "_divide": self._divide,
            "_moved": self.rows.raw,
            "_known": _check_condition,
        }
        for text in texts:
            exec(instrument(text), self.names)
        self.names |= names  # functions in Python replace those of the text
        self.names["exact_sum"] = self._exact_sum
        for name, title in sections.items():
            if name in self.names:
                self.names[name] = self._with_title(self.names[name], title, PLACES.get(name, ""))

    def run(self, function: str, *arguments: Any) -> None:
        """Execute a function of the text."""
        self.names[function](self.rows, *arguments)

    def _with_title(
        self, function: Callable[..., Any], title: str, place: str
    ) -> Callable[..., Any]:
        arguments = getattr(function, "__code__", None)
        names = arguments.co_varnames[: arguments.co_argcount] if arguments else ()

        def run(*given: Any) -> Any:
            here = dict(zip(names, given, strict=False))
            point = f"c{here['point']}" if "point" in here else place
            self.place = str(here.get("node", point or self.place))
            before, self.section = self.section, title.format(node=self.place)
            result = function(*given)
            self.section = before
            return result

        return run

    # -- values with names

    def name_value(self, hint: str | Callable[[], str], value: Any) -> Any:
        """Return a symbol for a value; return numbers and symbols unchanged."""
        if not isinstance(value, Expression) or value.is_number or value.is_symbol:
            return value
        name = hint if isinstance(hint, str) else hint()
        return self._graph.define_removable(name, value, self.section)

    def _name_local(self, name: str, over: Sequence[str], value: Any, *indices: Any) -> Any:
        def spelt() -> str:
            varies = self._graph.level(value) > Level.RUN
            return "_".join((name, *(map(self._spelt_index, over, indices) if varies else ())))

        return self.name_value(spelt, value)

    # -- operations

    def _add(self, old: Any, operation: str, value: Any) -> Any:
        if operation == "Div":
            return self._divide(self.name_value("rest", old), value)
        return _OPERATIONS[operation](old, value)

    def _add_to_row(self, row: int, operation: str, value: Any) -> None:
        self.rows.values[row] = self._add(self.rows.raw(row), operation, value)

    def _divide(self, x: Any, y: Any) -> Any:
        if isinstance(y, Expression) and y.is_number:
            return x * y**-1
        if isinstance(y, Expression):
            y = self.name_value("den", y)
            return x * self.name_value(f"inv_{y.name}" if y.is_symbol else "inv", y**-1)
        if isinstance(y, Irrational):
            return x * exact_number(rationalise(1 / y.value))
        return x / y if isinstance(x, Expression) else exact(Fraction(1) / y) * x

    def _absolute(self, x: Any) -> Any:
        if not isinstance(x, Expression):
            return abs(x)
        return x if self._graph.is_positive(x) else self._graph.apply("abs", x)

    def _least(self, x: Any, *others: Any) -> Any:
        for y in others:
            both = isinstance(x, Expression) or isinstance(y, Expression)
            x = self._graph.apply("min", x, y) if both else min(x, y)
        return x

    def _sincos(self, angle: Any) -> tuple[Expression, Expression]:
        angle = self._graph.of(angle)
        return self._graph.define_sincos(
            angle.name if angle.is_symbol else "angle", angle, self.section
        )

    def _exact_sum(self, x: Expression, y: Any) -> tuple[Expression, Expression]:
        step = self.name_value(f"{x.name}_step", self._graph.of(y))
        return self._graph.define_pair(
            "exact_sum", (x, step), (f"{x.name}_next", f"{x.name}_low_next"), self.section
        )


def _check_condition(value: Any) -> Any:
    """Return the operand of a condition. Raises GenerationError for a value of the run."""
    if isinstance(value, Expression):
        reject(
            f"A traced text has a condition on the value {value}.",
            why="A trace cannot branch on a value of the run.",
            remedy="Move the condition to a function that the kernel calls after the trace.",
            error=GenerationError,
        )
    return value


@lru_cache(maxsize=1024)
def instrument(text: str) -> CodeType:
    """Return the code of a function that reports the values it reads to a :class:`Trace`."""
    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    function.decorator_list = []
    local = {
        node.id
        for node in ast.walk(function)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }
    given = [x.arg for x in function.args.args if x.arg in ("node", "point")]
    writer = _Instrument(local, given)
    function.body = [writer.visit(statement) for statement in function.body]
    return compile(ast.fix_missing_locations(ast.Module([function], [])), "<traced>", "exec")


class _Instrument(ast.NodeTransformer):
    """Writes reads, divisions, additions and conditions of a text as calls of the trace."""

    def __init__(self, local: Iterable[str], indices: Sequence[str]) -> None:
        self._local, self._indices = set(local), [*indices]
        #: The indices of the loops in which a local is assigned for the first time.
        self._assigned: dict[str, tuple[str, ...]] = {}

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if not isinstance(node.ctx, ast.Load) or node.id not in self._local:
            return node
        if node.id in self._indices:
            return node
        over = tuple(x for x in self._assigned.get(node.id, ()) if x in self._indices)
        indices = ast.Tuple([ast.Constant(x) for x in over], ast.Load())
        values = [ast.Name(x, ast.Load()) for x in over]
        return _call("_use", ast.Constant(node.id), indices, node, *values)

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        """Do not name a value that is only copied to a row: the row has a name."""
        (target,) = node.targets
        to_row, value = isinstance(target, ast.Subscript), node.value
        if to_row and isinstance(value, ast.Subscript) and isinstance(value.slice, ast.Tuple):
            node.value = _call("_moved", self.visit(value.slice.elts[0]))
        elif not (to_row and isinstance(value, ast.Name)):
            node.value = self.visit(value)
        node.targets = [self.visit(target)]
        for name in ast.walk(target):
            if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store):
                self._assigned.setdefault(name.id, (*self._indices,))
        return node

    def visit_For(self, node: ast.For) -> ast.stmt:
        assert isinstance(node.target, ast.Name)
        node.iter = self.visit(node.iter)
        self._indices.append(node.target.id)
        node.body = [self.visit(statement) for statement in node.body]
        self._indices.pop()
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        return _call("_divide", node.left, node.right) if isinstance(node.op, ast.Div) else node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        value, operation = self.visit(node.value), ast.Constant(type(node.op).__name__)
        if isinstance(node.target, ast.Subscript):
            place = node.target.slice
            assert isinstance(place, ast.Tuple)
            row = self.visit(place.elts[0])
            return ast.Expr(_call("_add_to_row", row, operation, value))
        assert isinstance(node.target, ast.Name)
        old = ast.Name(node.target.id, ast.Load())
        return ast.Assign([node.target], _call("_add_to", old, operation, value))

    def _visit_choice(self, node: Any) -> Any:
        self.generic_visit(node)
        node.test = _call("_known", node.test)
        return node

    visit_If = visit_IfExp = _visit_choice

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        node.left = _call("_known", node.left)
        node.comparators = [_call("_known", x) for x in node.comparators]
        return node


def _call(function: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(function, ast.Load()), [*arguments], [])
