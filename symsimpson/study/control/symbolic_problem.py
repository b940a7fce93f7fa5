"""The expressions of an optimal control problem as nodes of a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, cast

import mpmath
import numpy as np
import sympy as sp
from sympy.logic.boolalg import Boolean

from symsimpson.declare.coordinates import time
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.plain import Symbols
from symsimpson.errors import reject
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluate_nodes
from symsimpson.graph.nodes import Graph, Value, scale
from symsimpson.graph.rebuild import rebuild
from symsimpson.schemes.composition import Composition
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.study.control.problem_parts import (
    read_duration,
    read_mapping,
    read_pair,
    read_signals,
)
from symsimpson.support.names import did_you_mean, spelled

#: Functions with discontinuous derivatives.
KINKED = (sp.Abs, sp.Max, sp.Min, sp.sign, sp.Piecewise, sp.Heaviside, sp.floor, sp.ceiling)
#: Inequalities. Floating-point numbers do not distinguish strict ones from others.
INEQUALITIES = (sp.LessThan, sp.GreaterThan, sp.StrictLessThan, sp.StrictGreaterThan)


@dataclass(frozen=True)
class Limits:
    """An expression with a lower and an upper bound; equal bounds prescribe its value."""

    name: str
    value: Value
    low: float
    high: float


class SymbolicProblem:
    """An optimal control problem, with its expressions as nodes of one graph."""

    def __init__(self, problem: Any) -> None:
        system = self.system = problem.system
        plain = system.plain
        signals = read_signals(system, problem.signals)
        self.symbols = Symbols(system.coordinates, system.parameters, (*system.inputs, *signals))
        graph = self.graph = Graph()
        self.q, self.v, self.p, self.u, self.parameters = (
            graph.numbers(s.name for s in group)
            for group in (plain.q, plain.v, plain.p, plain.u, plain.parameters)
        )
        (self.t,) = graph.numbers([plain.t.name])
        signal_nodes = graph.numbers(s.name for s in self.symbols.u[len(self.u) :])
        #: Signals by their nodes: the symbol, and the user's function of time.
        self.signals = dict(zip(signal_nodes, signals.items(), strict=True))
        L, *f = rebuild(plain.graph, [plain.L, *plain.f], {}, graph)
        slopes, n = gradient(graph, L, [*self.q, *self.v]), len(self.q)
        self.forces = [graph.add([slopes[i], f[i]]) for i in range(n)]
        self.momenta = slopes[n:]
        self.constraints, self.constraint_names = (
            plain.write_constraints(graph),
            plain.constraint_names,
        )
        self.multipliers = graph.numbers(s.name for s in plain.multipliers)
        self.names = [spelled(q) for q in system.coordinates]
        self.inputs = [spelled(u) for u in system.inputs]
        self.values = [float(x) for x in system.parameters.values()]
        self._by_name: dict[str, Any] = dict(zip(self.names, system.coordinates, strict=True))
        self._by_name |= {f"v_{q}": x.diff(time) for q, x in self._by_name.items()}
        self._by_name |= dict(zip(self.inputs, system.inputs, strict=True))
        self.running_cost = self.read_value("cost", problem.cost)
        self.final_cost = self.read_value("final_cost", problem.final_cost, ends=True)
        #: Boundary conditions at the start and at the end.
        self.end_limits = self._read_end("start", problem.start), self._read_end("end", problem.end)
        #: Equations between both ends: name, final expression, negative of the initial expression.
        self.linkages = self._read_linkages(problem.conditions)
        self.duration = read_duration(problem.duration)
        if self.signals and self.duration[0] < self.duration[1]:
            reject(
                f"duration is {problem.duration!r}, but signals need a duration that is a number.",
                remedy="Pass one number for the duration, or leave signals out.",
            )
        self._read_unknowns(problem.unknowns)
        self._read_bounds(problem)
        #: Bounds of inputs in each phase, by the indices of inputs.
        self.phases = self._read_phases(problem.phases)
        self._check_dependence()
        self._check_ends()

    @property
    def extents(self) -> Any:
        """Largest coordinates that the user gave, shape (3, n).

        The rows have values at the ends, velocities at the ends times the duration, and bounds.
        An entry without such a number is 0.
        """
        duration = float(np.sqrt(self.duration[0] * self.duration[1]))
        extents = np.zeros((3, len(self.q)))
        bounds = [Limits("", (1, self.q[a]), *pair) for a, pair in self.coordinate_bounds.items()]
        for row, limits in (
            (0, [*self.end_limits[0], *self.end_limits[1]]),
            (2, [*self.path_limits, *bounds]),
        ):
            for limit in limits:
                factor, node = limit.value
                for shift, nodes, size in ((0, self.q, 1.0), (row == 0, self.v, duration)):
                    if node in nodes:
                        finite = [abs(x) for x in (limit.low, limit.high) if np.isfinite(x)]
                        place = row + shift, nodes.index(node)
                        largest = size * max(finite, default=0.0) / abs(float(factor))
                        extents[place] = max(extents[place], largest)
        return extents

    def fixed_values(self, end: int) -> dict[int, float]:
        """Return coordinates and velocities with a prescribed value at an end, by their nodes."""
        return {
            limit.value[1]: limit.low / float(limit.value[0])
            for limit in self.end_limits[end]
            if limit.low == limit.high and limit.value[1] in (*self.q, *self.v)
        }

    @property
    def free_nodes(self) -> list[int]:
        """Nodes of the parameters that the solver finds."""
        return [self.parameters[i] for i in self.free_parameters]

    @property
    def free_names(self) -> list[str]:
        """Names of the parameters that the solver finds."""
        names = [spelled(a) for a in self.system.parameters]
        return [names[i] for i in self.free_parameters]

    @property
    def fixed_parameters(self) -> dict[int, float]:
        """Values of the other parameters, by their nodes."""
        pairs = enumerate(zip(self.parameters, self.values, strict=True))
        return {node: value for j, (node, value) in pairs if j not in self.free_parameters}

    def read_value(self, what: str, expression: Any, *, ends: bool = False) -> Value:
        """Return the node of an expression; ``ends`` says that it may not contain inputs."""
        if isinstance(expression, str):
            expression = self._find_by_name(what, expression, ends)
        if isinstance(expression, Real) and not isinstance(expression, (sp.Basic, bool)):
            number, _ = read_pair(f"the {what}", expression, "a finite number")
            expression = sp.Rational(repr(number))  # the exact decimal number
        symbols = self.symbols
        signal_symbols = {symbol for symbol, _ in self.signals.values()}
        known = expression.free_symbols & signal_symbols if isinstance(expression, sp.Basic) else ()
        if ends and known:
            reject(
                f"the {what} contains the signal {min(map(str, known))}.",
                why="Signals have values at nodes only, not at the ends of the motion.",
                remedy="Write it as an expression of symsimpson.time, or as a number.",
            )
        if isinstance(expression, sp.Expr) and expression.has(*KINKED):
            reject(
                f"the {what} {expression} has a kink.",
                why="The solver needs its second derivatives.",
                remedy="Smooth it (sqrt(x**2 + 1e-6) for |x|), or use bounds= and path=.",
            )
        allowed = (*symbols.q, *symbols.v, *symbols.a, symbols.t, *(() if ends else symbols.u))
        node = read_expression(self.system.name, what, expression, symbols, symbols.known, allowed)
        (value,) = rebuild(symbols.graph, [node], {}, self.graph)
        return value

    def _find_by_name(self, what: str, text: str, ends: bool) -> Any:
        """Return the coordinate, velocity or input with a name; ``ends`` excludes inputs."""
        name = spelled(text)
        if name not in self._by_name:
            known = [x for x in self._by_name if not (ends and x in self.inputs)]
            reject(
                f"{what} contains {text!r}, which is not a coordinate{'' if ends else ', input'} "
                f"or velocity.{did_you_mean(name, known)}",
                remedy=f"The system has {', '.join(known)}. Strings are never evaluated: write "
                "expressions with the symbols themselves.",
            )
        return self._by_name[name]

    def _read_linkages(self, given: Mapping[Any, Any]) -> list[tuple[str, Value, Value]]:
        """Return the name, the final value and the negative initial value of each equation."""
        how = "expressions of the end and of the start: {x.diff(): x.diff()}"
        conditions = []
        for name, key, value in read_mapping("conditions", given, how):
            last, first = (self.read_value("conditions", x, ends=True) for x in (key, value))
            conditions.append((name, last, scale(-1, first)))
        return conditions

    def _read_end(self, what: str, given: Mapping[Any, Any]) -> list[Limits]:
        """Return the boundary conditions of the argument ``what``, start or end."""
        limits, how = [], "values by symbol: {x: 0, x.diff(): 0}"
        for name, key, value in read_mapping(what, given, how):
            if not isinstance(value, (tuple, str, sp.Basic, Real)):
                reject(
                    f"{what}[{name}] is {value!r}, which is not a value of an expression.",
                    remedy="Pass a number, an expression, or (low, high).",
                )
            if isinstance(value, tuple):
                low, high = read_pair(f"{what}[{name}]", value)
                limits.append(Limits(name, self.read_value(what, key, ends=True), low, high))
                continue
            quantity, to = (self.read_value(what, x, ends=True) for x in (key, value))
            if not self.graph.nodes[to[1]].symbols:  # a number
                number = self.to_number(to)
                limits.append(Limits(name, quantity, number, number))
            else:
                limits.append(Limits(name, self.graph.add([quantity, scale(-1, to)]), 0.0, 0.0))
        return limits

    def to_number(self, value: Value) -> float:
        """Return the number of a node that contains no symbols."""
        c, n = value
        return float(c * evaluate_nodes(self.graph, [n], {}, mpmath.fp)[n]) if c else 0.0

    def _read_unknowns(self, given: Any) -> None:
        self.free_parameters: list[int] = []  #: Indices of parameters that the solver finds.
        self.free_bounds: list[tuple[float, float]] = []
        symbols = list(self.system.parameters)
        names = [*map(spelled, symbols)]
        for name, _, bounds in read_mapping("unknowns", given, "pairs by symbol: {m: (1, 2)}"):
            place = _find_index("unknowns", name, names, "parameter")
            pair = read_pair(f"unknowns[{name}]", bounds)
            sign = symbols[place]
            if (sign.is_positive or sign.is_nonnegative) and pair[0] < 0:
                reject(
                    f"unknowns[{name}] is {bounds!r}, but {name} is declared positive.",
                    remedy="Raise the lower bound, or declare the symbol without this assumption.",
                )
            self.free_parameters.append(place)
            self.free_bounds.append(pair)

    def _read_bounds(self, problem: Any) -> None:
        self.input_bounds: dict[int, tuple[float, float]] = {}
        self.coordinate_bounds: dict[int, tuple[float, float]] = {}
        #: Bounds that hold at nodes, of expressions other than inputs and coordinates.
        self.path_limits: list[Limits] = []
        how = "pairs by symbol: {u: (-1, 1)}"
        for name, key, given in read_mapping("bounds", problem.bounds, how):
            pair = read_pair(f"bounds[{name}]", given)
            if name in self.inputs:
                self.input_bounds[self.inputs.index(name)] = pair
            elif name in self.names:
                self.coordinate_bounds[self.names.index(name)] = pair
            else:
                self.path_limits.append(Limits(name, self.read_value("bounds", key), *pair))
        if not isinstance(problem.path, (tuple, list)):
            reject(
                f"path is {problem.path!r}, which is not a list.",
                remedy="Pass [expression, (low, expression, high)].",
            )
        for entry in problem.path:
            if isinstance(entry, (tuple, list)) and len(entry) != 3:
                reject(f"path has the entry {entry!r}.", remedy="Pass (low, expression, high).")
            low, expression, high = entry if isinstance(entry, (tuple, list)) else (None, entry, 0)
            if entry is expression and isinstance(entry, sp.Equality):
                low, expression = 0, entry.lhs - entry.rhs
            elif entry is expression and isinstance(entry, INEQUALITIES):
                expression = entry.lts - entry.gts
            elif isinstance(expression, Boolean):
                reject(
                    f"path contains {entry!r}, which is not an expression or a single relation.",
                    remedy="Pass each relation separately: x <= 2, sp.Eq(x, y), or (low, "
                    "expression, high).",
                )
            pair = read_pair(f"path {expression}", (low, high))
            value = self.read_value("path", expression)
            self._add_path_limits(Limits(str(expression), value, *pair))

    def _add_path_limits(self, limits: Limits) -> None:
        """Append limits; merge them with limits of the negative expression."""
        negative = scale(-1, limits.value)
        for k, other in enumerate(self.path_limits):
            if other.value == negative:
                low, high = max(other.low, -limits.high), min(other.high, -limits.low)
                if low <= high:  # else infeasible, as the solver will report
                    self.path_limits[k] = Limits(other.name, other.value, low, high)
                    return
        self.path_limits.append(limits)

    def _read_phases(self, given: Any) -> list[dict[int, tuple[float, float]]]:
        """Return the bounds of inputs in each phase; one phase without bounds is the default."""
        if not isinstance(given, (tuple, list)):
            reject(
                f"phases is {given!r}, which is not a list.",
                remedy="Pass a list with the bounds of inputs in each phase: [{u: 1}, {u: -1}].",
            )
        if self.signals and len(given) > 1:
            reject(
                "signals and phases cannot be combined.",
                why="Signals are functions of time, but the start times of phases are unknown.",
                remedy="Leave out signals or phases.",
            )
        phases: list[dict[int, tuple[float, float]]] = []
        for number, phase in enumerate(given):
            what = f"phases[{number}]"
            phases.append({})
            for name, _, bounds in read_mapping(what, phase, "numbers or pairs by inputs: {u: 1}"):
                place = _find_index(what, name, self.inputs, "input")
                low, high = read_pair(f"{what}[{name}]", bounds)
                least, most = self.input_bounds.get(place, (-np.inf, np.inf))
                _check_overlap(what, name, (low, high), (least, most))
                phases[-1][place] = max(low, least), min(high, most)
        return phases or [{}]

    def _check_dependence(self) -> None:
        """Reject conditions that do not depend on any variable of the problem."""
        unknown = {*self.q, *self.v, *self.u, *self.free_nodes}
        end_unknown = unknown | ({self.t} if self.duration[0] < self.duration[1] else set())
        conditions = [("start", x.name, [x.value], unknown) for x in self.end_limits[0]]
        conditions += [("end", x.name, [x.value], end_unknown) for x in self.end_limits[1]]
        conditions += [("bounds or path", x.name, [x.value], end_unknown) for x in self.path_limits]
        conditions += [("conditions", name, [*pair], end_unknown) for name, *pair in self.linkages]
        for what, name, values, free in conditions:
            if all(self.graph.nodes[node].symbols.isdisjoint(free) for _, node in values):
                reject(
                    f"{what} has a condition on {name}, which is constant.",
                    why="It contains no coordinate, velocity, input or unknown parameter.",
                    remedy="Leave it out, or write it with one of these.",
                )

    def _check_ends(self) -> None:
        """Reject boundary conditions that are too many, or outside of the bounds."""
        n = len(self.q)
        # compare nodes, not names: an equation at an end may have the name x
        bounds = [(limit.value, limit.low, limit.high) for limit in self.path_limits]
        for a, pair in self.coordinate_bounds.items():
            bounds.append((self.read_value("bounds", self.names[a], ends=True), *pair))
        for limits, where in zip(self.end_limits, ("start", "end"), strict=True):
            if len([x for x in limits if x.low == x.high]) > 2 * n:
                reject(
                    f"{where} has {len(limits)} conditions for {2 * n} quantities: {n} coordinates "
                    f"and {n} velocities.",
                    remedy="Leave out conditions that follow from others.",
                )
            for limit in limits:
                for value, low, high in bounds:
                    if value == limit.value:
                        _check_overlap(where, limit.name, (limit.low, limit.high), (low, high))


def _find_index(what: str, name: str, names: list[str], kind: str) -> int:
    """Return the index of a name in a list; raise InputError if the list does not have it."""
    if name not in names:
        reject(
            f"{what} contains {name!r}, but the system has no {kind} of this name."
            f"{did_you_mean(name, names)}",
            remedy=f"Use one of the system's {kind}s: {', '.join(names) or 'it has none'}.",
        )
    return names.index(name)


def _check_overlap(what: str, name: str, given: Any, bounds: Any) -> None:
    """Raise InputError if the interval ``given`` does not intersect the interval ``bounds``."""
    (low, high), (least, most) = given, bounds
    if low > most or high < least:
        shown = f"{low:g}" if low == high else f"({low:g}, {high:g})"
        reject(
            f"{what} has {name} = {shown}, outside of its bounds ({least:g}, {most:g}).",
            remedy=f"Widen the bounds, or choose values of {what} inside them.",
        )


def read_galerkin_scheme(scheme: Any) -> Scheme:
    """Return a scheme of the Galerkin family, whose steps have control points.

    Raises SchemeError if no scheme has this name, and InputError if the scheme is a composition.
    """
    candidate: Any = read_scheme(scheme)
    if isinstance(candidate, Composition):
        reject(
            f"scheme is {candidate.name}, a composition.",
            why="The steps of compositions have no control points.",
            remedy="Use a scheme of the Galerkin family: 'lobatto6', 'simpson' or 'gauss6'.",
        )
    return cast("Scheme", candidate)
