"""Actions of events in many digits, to be differentiated by differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mpmath import mp

from symsimpson.errors import InputError
from symsimpson.graph.derive import gradient
from symsimpson.graph.evaluate import evaluated
from symsimpson.graph.nodes import Exact
from symsimpson.program.program import Program
from symsimpson.program.reader import OF_MATH
from symsimpson.stepping.event import Impact
from symsimpson.stepping.run_events import RunEvents
from symsimpson.support.array_types import Floats
from symsimpson.support.names import speed_of_approach

__all__ = ["DIGITS", "Jumps", "slope"]

#: So many digits, and differences that leave as many of a derivative as doubles have, and more.
DIGITS, DIFFERENCE = 60, "1e-20"
#: Functions that expressions may have, in many digits.
FUNCTIONS = OF_MATH.split(", ")
BUILT_IN = {"abs": abs, "max": max, "min": min}


def slope(function: Callable[[Any], Sequence[Any]], at: Any, way: Any) -> list[Any]:
    """Return the derivative of a function along a way, by central differences."""
    size = max(map(abs, way), default=mp.mpf(0))
    if size == 0:
        return [0 * x for x in function(at)]
    d = mp.mpf(DIFFERENCE) / size
    ends = (function([x + s * d * y for x, y in zip(at, way, strict=True)]) for s in (1, -1))
    return [(a - b) / (2 * d) for a, b in zip(*ends, strict=True)]


def _times(c: Exact, x: Any) -> Any:
    """Return the product of an exact number and another one."""
    return x * c.numerator / c.denominator


class Jumps:
    """Values of expressions of events, and states behind them, in many digits.

    A point is a list of t, q, p and the parameters.
    """

    def __init__(self, program: Program, run_events: RunEvents, parameters: Floats) -> None:
        assert program.declared is not None
        plain, n = program.declared.plain, program.n
        self._n, self._events, self._plain = n, run_events, plain
        self._names, self._parameters = tuple(program.header.parameters), parameters
        self._place = program.names.parameters.found
        graph = plain.graph
        self._texts = [
            compile(expression.text, "<event>", "eval") for expression in run_events.watched
        ]
        self._energetic = [expression.energetic for expression in run_events.watched]
        self._mass = [(i, j, plain.entry(i, j)) for i in range(n) for j in range(n)]
        self._held = [
            gradient(graph, phi, plain.numbers(plain.q)) for phi in plain.constraints.values()
        ]
        self._held += [list(row[:-1]) for row in plain.velocity_constraints.values()]
        self._roots = {c_n[1] for *_, c_n in self._mass}
        self._roots |= {m for row in (*self._held, plain.a, [plain.V]) for _, m in row}

    def point(self, t: float, q: Floats, p: Floats) -> list[Any]:
        """Return the point of a state."""
        return [mp.mpf(float(x)) for x in (t, *q, *p, *self._parameters)]

    def ways(self, moved: Floats, columns: Floats, varied: Sequence[str]) -> list[list[Any]]:
        """Return variations of points: of the time, the state, and of parameters by the last."""
        variations, count = [], columns.shape[1]
        for j in range(count):
            direction = np.zeros(len(self._parameters))
            name = varied[j - count] if count - j <= len(varied) else ""
            if name in self._names:
                direction[self._names.index(name)] = 1.0
            variations.append([mp.mpf(float(x)) for x in (moved[j], *columns[:, j], *direction)])
        return variations

    def value(self, k: int, z: Sequence[Any]) -> Any:
        """Return an expression at a point."""
        return self._read(z)([k])[0]

    def act(self, event: int, z: Sequence[Any]) -> list[Any]:
        """Return q and p behind an event."""
        n, (t, q, p) = self._n, self._state(z)
        if isinstance(self._events.events[event].action, Impact):
            return [*q, *self._hit(event, z)]
        changes = self._events.changes[event]
        if not changes:
            return [*q, *p]
        at = self._values(t, q, z)
        v, q = list(self._velocity(at, p)), list(q)
        values = self._read(z)([place for *_, place in changes])
        momenta = {}
        for (block, place, _), x in zip(changes, values, strict=True):
            if block == "p":
                momenta[place] = x
            else:
                {"q": q, "v": v}[block][place] = x
        blocks = {block for block, *_ in changes}
        # velocities are kept where positions change, unless momenta are given
        if "p" in blocks and "v" not in blocks:
            return [*q, *(momenta.get(a, p[a]) for a in range(n))]
        at = self._values(t, q, z)
        return [*q, *self._momentum(at, self._with_momenta(at, v, momenta))]

    def _with_momenta(
        self, at: dict[int, Any], v: Sequence[Any], momenta: dict[int, Any]
    ) -> list[Any]:
        """Return velocities of which some are those of given momenta, and the others stay."""
        given, v = sorted(momenta), list(v)
        if not given:
            return v
        for a in given:
            v[a] = mp.mpf(0)
        base, M = self._momentum(at, v), mp.zeros(len(given))
        for i, j, (c, node) in self._mass:
            if i in momenta and j in momenta:
                M[given.index(i), given.index(j)] = _times(c, at[node])
        solution = mp.lu_solve(M, mp.matrix([momenta[a] - base[a] for a in given]))
        for a, x in zip(given, solution, strict=True):
            v[a] = x
        return v

    def _hit(self, event: int, z: Sequence[Any]) -> list[Any]:
        """Return the momenta behind an impact."""
        n, (t, q, p) = self._n, self._state(z)
        first, place = self._events.slopes[event], self._events.rate[event]
        assert first is not None
        assert place is not None
        *along, rate = self._read(z)([*range(first, first + n), place])
        at = self._values(t, q, z)
        m = len(self._held)
        full = mp.zeros(n + m)
        for i, j, (c, node) in self._mass:
            full[i, j] = _times(c, at[node])
        for r, row in enumerate(self._held):
            for a, (c, node) in enumerate(row):
                full[n + r, a] = full[a, n + r] = _times(c, at[node])
        w = mp.lu_solve(full, mp.matrix([*along, *[0] * m]))
        weight = mp.fdot(along, w[:n])
        impulse = -(1 + self._restitution(event, -rate, z)) * rate / weight
        return [p[i] + impulse * mp.fdot([full[i, j] for j in range(n)], w[:n]) for i in range(n)]

    def _restitution(self, event: int, speed: Any, z: Sequence[Any]) -> Any:
        given = self._events.events[event].action.restitution  # type: ignore[union-attr]
        if not hasattr(given, "free_symbols"):
            return mp.mpf(float(given))
        from sympy import Dummy, lambdify  # slow to import, and there by now

        values, place = z[1 + 2 * self._n :], self._place
        symbols = {x: Dummy() for x in given.free_symbols}  # whose names may be any
        approach = speed_of_approach()
        known = [speed if x == approach else values[place(x)] for x in symbols]
        return lambdify([*symbols.values()], given.xreplace(symbols), "mpmath")(*known)

    def _state(self, z: Sequence[Any]) -> tuple[Any, list[Any], list[Any]]:
        n = self._n
        return z[0], list(z[1 : 1 + n]), list(z[1 + n : 1 + 2 * n])

    def _values(self, t: Any, q: Sequence[Any], z: Sequence[Any]) -> dict[int, Any]:
        """Return the nodes of the energies and constraints at a position."""
        plain = self._plain
        symbols = (*plain.q, *plain.parameters, plain.t)
        known = (*q, *z[1 + 2 * self._n :], t)
        given = dict(zip(plain.numbers(symbols), known, strict=True))
        return evaluated(plain.graph, self._roots, given, mp)

    def _momentum(self, at: dict[int, Any], v: Sequence[Any]) -> list[Any]:
        """Return M v + a."""
        momentum = [_times(c, at[n]) for c, n in self._plain.a]
        for i, j, (c, node) in self._mass:
            momentum[i] += _times(c, at[node]) * v[j]
        return momentum

    def _velocity(self, at: dict[int, Any], p: Sequence[Any]) -> Any:
        """Return M^-1 (p - a)."""
        M = mp.zeros(self._n)
        for i, j, (c, node) in self._mass:
            M[i, j] = _times(c, at[node])
        return list(mp.lu_solve(M, mp.matrix(self._without_a(at, p))))

    def _without_a(self, at: dict[int, Any], p: Sequence[Any]) -> list[Any]:
        """Return p - a."""
        return [x - _times(c, at[n]) for x, (c, n) in zip(p, self._plain.a, strict=True)]

    def _read(self, z: Sequence[Any]) -> Callable[[Sequence[int]], list[Any]]:
        """Return what evaluates expressions at a point."""
        t, q, p = self._state(z)
        names: dict[str, Any] = {name: getattr(mp, name) for name in FUNCTIONS} | {"t": t}
        names |= {f"q_{i}": x for i, x in enumerate(q)} | {f"p_{i}": x for i, x in enumerate(p)}
        names |= {f"a_{i}": x for i, x in enumerate(z[1 + 2 * self._n :])}

        def read(places: Sequence[int]) -> list[Any]:
            if any(self._energetic[k] for k in places) and "energy" not in names:
                at = self._values(t, q, z)
                v = self._velocity(at, p)
                kinetic = mp.fdot(self._without_a(at, p), v) / 2
                c, n = self._plain.V
                names.update({f"v_{i}": x for i, x in enumerate(v)})
                names.update(kinetic_energy=kinetic, energy=kinetic + _times(c, at[n]))
            try:
                return [eval(self._texts[k], {"__builtins__": BUILT_IN}, names) for k in places]
            except (NameError, TypeError, ValueError, ZeroDivisionError) as error:
                raise InputError(
                    f"the event expression {self._events.watched[places[0]].expression!r} cannot "
                    f"be differentiated: {error}.\nRun without tangents and sensitivities."
                ) from None

        return read
