"""A problem of optimal control, read into a graph."""

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
from symsimpson.graph.evaluate import evaluated
from symsimpson.graph.nodes import Graph, Value, scaled
from symsimpson.graph.rebuild import rebuilt
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

#: Functions whose slope jumps.
KINKED = (sp.Abs, sp.Max, sp.Min, sp.sign, sp.Piecewise, sp.Heaviside, sp.floor, sp.ceiling)
#: Relations of which numbers do not tell the strict ones from others.
INEQUALITIES = (sp.LessThan, sp.GreaterThan, sp.StrictLessThan, sp.StrictGreaterThan)


@dataclass(frozen=True)
class Limits:
    """An expression between a low and a high number; these are equal where it is given."""

    name: str
    value: Value
    low: float
    high: float


class Reading:
    """The expressions of a problem in a graph of the plain symbols, and numbers."""

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
        of_signals = graph.numbers(s.name for s in self.symbols.u[len(self.u) :])
        #: By the nodes of what is a given function of the time: its symbol, and the function.
        self.signals = dict(zip(of_signals, signals.items(), strict=True))
        L, *f = rebuilt(plain.graph, [plain.L, *plain.f], {}, graph)
        slopes, n = gradient(graph, L, [*self.q, *self.v]), len(self.q)
        self.forces = [graph.add([slopes[i], f[i]]) for i in range(n)]
        self.momenta = slopes[n:]
        self.held, self.constraints = plain.held_rows(graph), plain.held
        self.multipliers = graph.numbers(s.name for s in plain.multipliers)
        self.names = [spelled(q) for q in system.coordinates]
        self.inputs = [spelled(u) for u in system.inputs]
        self.values = [float(x) for x in system.parameters.values()]
        self._known: dict[str, Any] = dict(zip(self.names, system.coordinates, strict=True))
        self._known |= {f"v_{q}": x.diff(time) for q, x in self._known.items()}
        self._known |= dict(zip(self.inputs, system.inputs, strict=True))
        self.running = self.value("cost", problem.cost)
        self.final = self.value("final_cost", problem.final_cost, ends=True)
        #: Limits at the start, and at the end.
        self.ends = tuple(self._end(what, getattr(problem, what)) for what in ("start", "end"))
        #: Names, what stands at the end, and less what of the start it is equal to.
        self.tied = self._tied(problem.conditions)
        self.duration = read_duration(problem.duration)
        if self.signals and self.duration[0] < self.duration[1]:
            reject(
                f"signals are functions of the time, and duration is {problem.duration!r}.",
                remedy="Pass one number for the duration.",
            )
        self._read_unknowns(problem.unknowns)
        self._read_bounds(problem)
        #: The bounds of inputs in each, by their places.
        self.phases = self._phases(problem.phases)
        self._check_moving()
        self._check()

    @property
    def extents(self) -> Any:
        """The largest coordinates that ends, velocities there, and bounds give, shape (3, n).

        Velocities count times the duration; what nothing is said of is 0.
        """
        whole = float(np.sqrt(self.duration[0] * self.duration[1]))
        extents = np.zeros((3, len(self.q)))
        bounds = [Limits("", (1, self.q[a]), *pair) for a, pair in self.of_coordinates.items()]
        for row, limits in ((0, [*self.ends[0], *self.ends[1]]), (2, [*self.within, *bounds])):
            for limit in limits:
                factor, node = limit.value
                for shift, nodes, size in ((0, self.q, 1.0), (row == 0, self.v, whole)):
                    if node in nodes:
                        finite = [abs(x) for x in (limit.low, limit.high) if np.isfinite(x)]
                        place = row + shift, nodes.index(node)
                        largest = size * max(finite, default=0.0) / abs(float(factor))
                        extents[place] = max(extents[place], largest)
        return extents

    def fixed(self, end: int) -> dict[int, float]:
        """Return coordinates and velocities that factor * x = value fixes at an end, by nodes."""
        return {
            limit.value[1]: limit.low / float(limit.value[0])
            for limit in self.ends[end]
            if limit.low == limit.high and limit.value[1] in (*self.q, *self.v)
        }

    @property
    def found_names(self) -> list[str]:
        """Names of the parameters that are found."""
        names = [spelled(a) for a in self.system.parameters]
        return [names[i] for i in self.found]

    @property
    def given(self) -> dict[int, float]:
        """The parameters that are not found, by their nodes."""
        pairs = enumerate(zip(self.parameters, self.values, strict=True))
        return {node: value for j, (node, value) in pairs if j not in self.found}

    def value(self, what: str, expression: Any, *, ends: bool = False) -> Value:
        """Read an expression of coordinates, velocities, parameters, t, and inputs within."""
        if isinstance(expression, str):
            expression = self._named(what, expression, ends)
        if isinstance(expression, Real) and not isinstance(expression, (sp.Basic, bool)):
            number, _ = read_pair(f"the {what}", expression, "a finite number")
            expression = sp.Rational(repr(number))  # as it is written
        symbols = self.symbols
        of_signals = {symbol for symbol, _ in self.signals.values()}
        known = expression.free_symbols & of_signals if isinstance(expression, sp.Basic) else ()
        if ends and known:
            reject(
                f"the {what} contains the signal {min(map(str, known))}, which is known within the "
                "motion.",
                remedy="Write it as an expression of symsimpson.time, or as a number.",
            )
        if isinstance(expression, sp.Expr) and expression.has(*KINKED):
            reject(
                f"the {what} {expression} has a kink, and is to be differentiated twice.",
                remedy="Smooth it, as sqrt(x**2 + 1e-6) for |x|, or say it by bounds= and path=.",
            )
        allowed = (*symbols.q, *symbols.v, *symbols.a, symbols.t, *(() if ends else symbols.u))
        read = read_expression(self.system.name, what, expression, symbols, symbols.known, allowed)
        (value,) = rebuilt(symbols.graph, [read], {}, self.graph)
        return value

    def _named(self, what: str, text: str, ends: bool) -> Any:
        """Return the coordinate, velocity or input of a name; there are no inputs at ends."""
        name = spelled(text)
        if name not in self._known:
            known = [x for x in self._known if not (ends and x in self.inputs)]
            reject(
                f"{what} names {text!r}, which is no coordinate{'' if ends else ', input'} or "
                f"velocity.{did_you_mean(name, known)}",
                remedy=f"The system has {', '.join(known)}. Text "
                "is never evaluated: expressions are written with the symbols themselves.",
            )
        return self._known[name]

    def _tied(self, given: Mapping[Any, Any]) -> list[tuple[str, Value, Value]]:
        """Read what is at the end what something is at the start, with a minus."""
        how = "expressions at the end by those at the start: {x.diff(): x.diff()}"
        conditions = []
        for name, key, value in read_mapping("conditions", given, how):
            last, first = (self.value("conditions", x, ends=True) for x in (key, value))
            conditions.append((name, last, scaled(-1, first)))
        return conditions

    def _end(self, what: str, given: Mapping[Any, Any]) -> list[Limits]:
        """Read what holds at an end."""
        limits, how = [], "values by symbol: {x: 0, x.diff(): 0}"
        for name, key, value in read_mapping(what, given, how):
            if not isinstance(value, (tuple, str, sp.Basic, Real)):
                reject(
                    f"{what}[{name}] is {value!r}.",
                    remedy="Pass a number, an expression, or (low, high).",
                )
            if isinstance(value, tuple):
                low, high = read_pair(f"{what}[{name}]", value)
                limits.append(Limits(name, self.value(what, key, ends=True), low, high))
                continue
            quantity, to = self.value(what, key, ends=True), self.value(what, value, ends=True)
            if not self.graph.nodes[to[1]].symbols:  # a number of its own: bounds say it best
                number = self.number(to)
                limits.append(Limits(name, quantity, number, number))
            else:
                limits.append(Limits(name, self.graph.add([quantity, scaled(-1, to)]), 0.0, 0.0))
        return limits

    def number(self, value: Value) -> float:
        """Return a value in which no symbol stands."""
        c, n = value
        return float(c * evaluated(self.graph, [n], {}, mpmath.fp)[n]) if c else 0.0

    def _read_unknowns(self, given: Any) -> None:
        self.found: list[int] = []  #: Places of parameters that are found.
        self.found_bounds: list[tuple[float, float]] = []
        symbols = list(self.system.parameters)
        names = [*map(spelled, symbols)]
        for name, _, bounds in read_mapping("unknowns", given, "pairs by symbol: {m: (1, 2)}"):
            place = _place("unknowns", name, names, "parameter")
            pair = read_pair(f"unknowns[{name}]", bounds)
            sign = symbols[place]
            if (sign.is_positive or sign.is_nonnegative) and pair[0] < 0:
                reject(
                    f"unknowns lets {name} be {bounds!r}, and it is declared positive.",
                    remedy="Raise the low bound, or declare it with another sign.",
                )
            self.found.append(place)
            self.found_bounds.append(pair)

    def _read_bounds(self, problem: Any) -> None:
        self.of_inputs: dict[int, tuple[float, float]] = {}
        self.of_coordinates: dict[int, tuple[float, float]] = {}
        self.within: list[Limits] = []  #: At nodes, of what is no input and no coordinate.
        how = "pairs by symbol: {u: (-1, 1)}"
        for name, key, given in read_mapping("bounds", problem.bounds, how):
            pair = read_pair(f"bounds[{name}]", given)
            if name in self.inputs:
                self.of_inputs[self.inputs.index(name)] = pair
            elif name in self.names:
                self.of_coordinates[self.names.index(name)] = pair
            else:
                self.within.append(Limits(name, self.value("bounds", key), *pair))
        if not isinstance(problem.path, (tuple, list)):
            reject(
                f"path is {problem.path!r}, no list.",
                remedy="Pass [expression, (low, expression, high)].",
            )
        for entry in problem.path:
            if isinstance(entry, (tuple, list)) and len(entry) != 3:
                reject(f"path has {entry!r}.", remedy="Pass (low, expression, high).")
            low, expression, high = entry if isinstance(entry, (tuple, list)) else (None, entry, 0)
            if entry is expression and isinstance(entry, sp.Equality):
                low, expression = 0, entry.lhs - entry.rhs
            elif entry is expression and isinstance(entry, INEQUALITIES):
                expression = entry.lts - entry.gts
            elif isinstance(expression, Boolean):
                reject(
                    f"path has {entry!r}, which is neither an expression nor one relation of two.",
                    remedy="Pass relations one by one, as x <= 2, sp.Eq(x, y), or (low, "
                    "expression, high).",
                )
            pair = read_pair(f"path {expression}", (low, high))
            self._keep_within(Limits(str(expression), self.value("path", expression), *pair))

    def _keep_within(self, limits: Limits) -> None:
        """Keep a row; one that is the negative of another one makes one of both."""
        negative = scaled(-1, limits.value)
        for k, other in enumerate(self.within):
            if other.value == negative:
                low, high = max(other.low, -limits.high), min(other.high, -limits.low)
                if low <= high:  # else they contradict each other, which the solver tells
                    self.within[k] = Limits(other.name, other.value, low, high)
                    return
        self.within.append(limits)

    def _phases(self, given: Any) -> list[dict[int, tuple[float, float]]]:
        """Read what bounds inputs in each phase; there is one if none is given."""
        if not isinstance(given, (tuple, list)):
            reject(
                f"phases is {given!r}, no list.",
                remedy="Pass what bounds inputs in each: [{u: 1}, {u: -1}].",
            )
        if self.signals and len(given) > 1:
            reject(
                "signals are functions of the time, and where phases begin is found.",
                remedy="Leave out signals or phases.",
            )
        phases: list[dict[int, tuple[float, float]]] = []
        for number, phase in enumerate(given):
            what = f"phases[{number}]"
            phases.append({})
            for name, _, bounds in read_mapping(what, phase, "numbers or pairs by inputs: {u: 1}"):
                place = _place(what, name, self.inputs, "input")
                low, high = read_pair(f"{what}[{name}]", bounds)
                least, most = self.of_inputs.get(place, (-np.inf, np.inf))
                _check_overlap(what, name, (low, high), (least, most))
                phases[-1][place] = max(low, least), min(high, most)
        return phases or [{}]

    def _check_moving(self) -> None:
        """Refuse conditions on what is given."""
        unknown = {*self.q, *self.v, *self.u, *(self.parameters[i] for i in self.found)}
        timed = unknown | ({self.t} if self.duration[0] < self.duration[1] else set())
        asked = [("start", x.name, [x.value], unknown) for x in self.ends[0]]
        asked += [("end", x.name, [x.value], timed) for x in self.ends[1]]
        asked += [("bounds or path", x.name, [x.value], timed) for x in self.within]
        asked += [("conditions", name, [*pair], timed) for name, *pair in self.tied]
        for what, name, values, free in asked:
            if all(self.graph.nodes[node].symbols.isdisjoint(free) for _, node in values):
                reject(
                    f"{what} asks for something of {name}, in which nothing is free: no "
                    "coordinate, velocity, input or parameter that is found.",
                    remedy="Leave it out, or write it with what moves.",
                )

    def _check(self) -> None:
        """Refuse ends that cannot be satisfied."""
        n = len(self.q)
        # by what is bounded, not by its name: x may be given by an equation at an end
        bounds = [(limit.value, limit.low, limit.high) for limit in self.within]
        for a, pair in self.of_coordinates.items():
            bounds.append((self.value("bounds", self.names[a], ends=True), *pair))
        for limits, where in zip(self.ends, ("start", "end"), strict=True):
            if len([x for x in limits if x.low == x.high]) > 2 * n:
                reject(
                    f"{where} has {len(limits)} conditions on {2 * n} numbers, {n} coordinates and "
                    "as many velocities.",
                    remedy="Leave out those that follow from others.",
                )
            for limit in limits:
                for value, low, high in bounds:
                    if value == limit.value:
                        _check_overlap(where, limit.name, (limit.low, limit.high), (low, high))


def _place(what: str, name: str, names: list[str], kind: str) -> int:
    """Return the place of a name; raises InputError if there is none."""
    if name not in names:
        reject(
            f"{what} names {name!r}, which is no {kind}.{did_you_mean(name, names)}",
            remedy=f"The system has {', '.join(names) or 'none'}.",
        )
    return names.index(name)


def _check_overlap(what: str, name: str, given: Any, bounds: Any) -> None:
    """Raise InputError if no number between two given ones lies within bounds."""
    (low, high), (least, most) = given, bounds
    if low > most or high < least:
        shown = f"{low:g}" if low == high else f"({low:g}, {high:g})"
        reject(
            f"{what} has {name} = {shown}, outside of its bounds ({least:g}, {most:g}).",
            remedy=f"Widen the bounds, or give {what} within.",
        )


def read_family(scheme: Any) -> Scheme:
    """Read a scheme whose steps have control points.

    Raises SchemeError if no scheme has this name; InputError if it is a composition.
    """
    candidate: Any = read_scheme(scheme)
    if isinstance(candidate, Composition):
        reject(
            f"{candidate.name} is a composition, whose steps have no control points.",
            remedy="Take a scheme of the Galerkin family, as 'lobatto6', 'simpson' or 'gauss6'.",
        )
    return cast("Scheme", candidate)
