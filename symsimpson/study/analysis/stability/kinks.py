"""Kinks of V and of forces: where a force jumps, or V, and a motion has passed.

The root of a sum of squares, r = sqrt(x**2 + y**2), is smooth but for r = 0, where its derivative
changes its sign; and atan2(y, x) jumps by a whole turn where y = 0 and x < 0. A step across such a
point has order one, whatever the scheme.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from operator import mul
from typing import Any

import mpmath
import numpy as np
import sympy as sp
from numpy.typing import NDArray

from symsimpson.declare.checks import spell
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.declare.system import MechanicalSystem
from symsimpson.graph.evaluate import evaluated
from symsimpson.graph.nodes import Exact, Value
from symsimpson.support.array_types import Floats

#: A zero is passed if the line between two states misses it by less than this part of the line.
NEAR = 0.1
#: Passages of one root whose forces are looked at.
PASSAGES = 8
#: How far from the zero forces are compared, in parts of the step; and with how many digits.
PARTS, DIGITS = (1e-2, 1e-3, 1e-4), 40
#: A force that grows by more on the way to the zero has a pole there.
GROWS = 2.0
#: A jump is at least this part of the force, and keeps at least half of its height.
LEAST, KEEPS = 1e-3, 0.5

HALF = Fraction(1, 2)
SMOOTH = "Smooth the root, sqrt(... + epsilon**2), or trust what halving h leaves unchanged"
UNCUT = "Take an angle for a coordinate, or its cosine and sine for the arcus tangent"


@dataclass(frozen=True)
class _Root:
    """The square root of a sum of constant factors times squares of functions of q and t.

    Or what an arcus tangent of two arguments has its cut by: the square of the first, where the
    other is negative.
    """

    where: str
    remedy: str
    squares: tuple[tuple[tuple[Exact, int], ...], ...]  # pairs (half the exponent, base)
    factors: tuple[tuple[Exact, tuple[tuple[Exact, int], ...]], ...]
    negative: Value | None = None


def has_kinks(system: MechanicalSystem) -> bool:
    """Return whether forces of a system, or V, may jump."""
    return bool(_roots(system)[1])


def kink_passed(
    system: MechanicalSystem, t: Floats, q: Floats, values: Sequence[float]
) -> tuple[float, str, str] | None:
    """Find where a motion first passed a point at which its force jumps, or V.

    ``t`` and ``q`` are those of consecutive steps; ``values`` belong to the parameters, then to the
    inputs, in the order in which they were declared. The result is the time, where that is, with a
    root as the user wrote it, and what to do; None if no such point was passed between two states.
    A pole, where the force is not finite, is no kink.

    Examples
    --------
    >>> import numpy as np, sympy as sp, symsimpson as ss
    >>> from symsimpson.study.analysis.stability.kinks import kink_passed
    >>> x, y = ss.coordinates("x y")
    >>> cone = ss.MechanicalSystem(
    ...     "cone", coordinates=(x, y), kinetic=(x.diff()**2 + y.diff()**2)/2,
    ...     potential=sp.sqrt(x**2 + y**2))
    >>> kink_passed(cone, np.array([0.0, 1.0]), np.array([[1.0, 0.0], [-1.0, 0.0]]), [])[:2]
    (0.5, 'a zero of sqrt(x**2 + y**2)')
    """
    plain, roots = _roots(system)
    t, q = np.asarray(t, dtype=np.float64), np.asarray(q, dtype=np.float64)
    if not roots or len(t) < 2:
        return None
    count, total = len(plain.parameters), len(system.parameters)  # retiming adds some at the end
    given = [float(x) for x in (*values[:count], *values[total:])]
    known = dict(zip(plain.numbers((*plain.parameters, *plain.u)), given, strict=True))
    first: tuple[float, str, str] | None = None
    for root in roots:
        place = _near_passages(plain, root, known, t, q)
        if place is None:
            continue
        near, part = place
        for k in np.flatnonzero(near)[:PASSAGES]:
            when = float(t[k] + part[k] * (t[k + 1] - t[k]))
            if first is not None and not when < first[0]:
                break
            if _jumps(plain, root, known, t[k : k + 2], q[k : k + 2], float(part[k])):
                first = when, root.where, root.remedy
                break
    return first


@lru_cache(maxsize=64)
def _roots(system: MechanicalSystem) -> tuple[Plain, tuple[_Root, ...]]:
    """Return the plain system, and the roots of sums of squares and the cuts in V and forces."""
    retiming = system.retiming
    plain = system.plain if retiming is None else retiming.plain
    graph, moving = plain.graph, {*plain.numbers(plain.q), plain.time}
    back = dict(Symbols(system.coordinates, system.parameters, system.inputs).back)
    bases: dict[int, None] = {}
    roots = []
    for n in graph.reached([plain.V[1], *(n for _, n in plain.f)]):
        if graph.nodes[n].kind == "function" and graph.nodes[n].parts[0] == "atan2":
            _, (_, y), x = graph.nodes[n].parts
            if _of_positions(plain, moving, y, x[1]):
                where = f"the cut of {spell(plain.written((1, n)).xreplace(back), 200)}"
                roots.append(_Root(where, UNCUT, (((1, y),),), ((1, ()),), x))
        factors = graph.factors(n)
        late = [e for m, e in factors if graph.nodes[m].symbols & moving]
        for m, e in factors:  # by a distance alone, a pole: what is divided by it must vanish, too
            if e == HALF or (e == -HALF and max(late, default=0) > 0):
                bases[m] = None
    for n in bases:
        terms = _squares(plain, n, moving)
        if terms is not None:
            where = f"a zero of {spell(sp.sqrt(plain.written((1, n)).xreplace(back)), 200)}"
            roots.append(_Root(where, SMOOTH, *(tuple(x) for x in zip(*terms, strict=True))))
    return plain, tuple(roots)


def _of_positions(plain: Plain, moving: set[int], n: int, *others: int) -> bool:
    """Return whether a node moves, and it and others have values where positions have."""
    nodes, allowed = plain.graph.nodes, moving | {*plain.numbers((*plain.parameters, *plain.u))}
    inside = frozenset().union(*(nodes[m].symbols for m in (n, *others)))
    return not nodes[n].symbols.isdisjoint(moving) and inside <= allowed


def _squares(plain: Plain, n: int, moving: set[int]) -> list[tuple[Any, Any]] | None:
    """Split a sum of squares into terms: pairs (e/2, base) and a constant factor; else None."""
    graph = plain.graph
    if not _of_positions(plain, moving, n):
        return None
    terms, seen = [], {n}
    work: list[tuple[Exact, int]] = [(1, n)]
    while work:
        c, m = work.pop()
        node = graph.nodes[m]
        if node.kind == "sum" and c > 0:  # what stands in it twice has the zeros that it has once
            work += [(d, k) for d, k in node.parts if k not in seen]
            seen.update(k for _, k in node.parts)
            continue
        moving_factors = [(e, b) for b, e in graph.factors(m) if graph.nodes[b].symbols & moving]
        constant_factors = [
            (e, b) for b, e in graph.factors(m) if not graph.nodes[b].symbols & moving
        ]
        if any(e <= 0 or Fraction(e) % 2 for e, _ in moving_factors):
            return None
        terms.append((tuple((e // 2, b) for e, b in moving_factors), (c, tuple(constant_factors))))
    return terms


def _near_passages(
    plain: Plain, root: _Root, known: dict[int, float], t: Floats, q: Floats
) -> tuple[NDArray[np.bool_], Floats] | None:
    """Mark segments between states that pass near the zero, with the fraction at closest."""
    at = _at(plain, t, q)
    u = _root_terms(plain, root, known, at, _ARRAYS)
    if u is None:
        return None
    there: Any = True
    if root.negative is not None:
        c, n = root.negative
        x = evaluated(plain.graph, [n], {**known, **at}, _ARRAYS)[n]
        there = float(c) * np.broadcast_to(x, t.shape)[:-1] < 0
    with np.errstate(all="ignore"):
        start, change = u[:, :-1], np.diff(u, axis=1)
        length = (change**2).sum(axis=0)
        part = np.clip(-(start * change).sum(axis=0) / length, 0.0, 1.0)
        missed = ((start + part * change) ** 2).sum(axis=0)
        return (missed < NEAR**2 * length) & (length > 0.0) & there, part


def _root_terms(
    plain: Plain, root: _Root, known: dict[int, float], at: dict[int, Any], context: Any
) -> Any:
    """Return the u_i of root = sqrt(sum u_i^2), a row for each; None if it has no zero."""
    graph, rows = plain.graph, []
    symbols = {**known, **at}
    for bases, (c, still) in zip(root.squares, root.factors, strict=True):
        fixed = evaluated(graph, [b for _, b in still], symbols, mpmath.fp)
        factor = float(c) * float(np.prod([fixed[b] ** float(e) for e, b in still]))
        if not factor >= 0 or (factor > 0 and not bases):
            return None
        if factor > 0:
            moved = evaluated(graph, [b for _, b in bases], symbols, context)
            rows.append(factor**0.5 * context.fprod(moved[b] ** int(e) for e, b in bases))
    return np.array(rows) if rows else None


def _at(plain: Plain, t: Any, q: Any) -> dict[int, Any]:
    return dict(zip(plain.numbers(plain.q), np.transpose(q), strict=True)) | {plain.time: t}


def _jumps(
    plain: Plain, root: _Root, known: dict[int, float], t: Floats, q: Floats, part: float
) -> bool:
    """Return whether the force is finite on both sides of the zero, and it or V not the same."""
    with mpmath.workdps(DIGITS):
        begin, end = (mpmath.mpf(float(x)) for x in t)
        start = [mpmath.mpf(float(x)) for x in q[0]]
        way = [mpmath.mpf(float(x)) for x in np.subtract(q[1], q[0])]
        when = begin + part * (end - begin)
        zero = _zero(plain, root, known, when, _moved(start, part, way))
        speed = [x / (end - begin) for x in way]
        sides = [[_moved(zero, share, way) for share in (-s, s)] for s in PARTS]
        forces = [[_force(plain, known, when, x, speed) for x in pair] for pair in sides]
        levels = [[_potential(plain, known, when, x) for x in pair] for pair in sides]
    sizes = [max(map(_size, pair)) for pair in forces]
    jumps = [_size([a - b for a, b in zip(*pair, strict=True)]) for pair in forces]
    finite = bool(np.isfinite(sizes).all()) and sizes[-1] <= GROWS * sizes[0]
    steps = [float(abs(a - b)) for a, b in levels]
    least = 10.0 ** (-DIGITS // 2) * float(max(abs(x) for pair in levels for x in pair))
    kept = steps[-1] > max(least, KEEPS * steps[0])
    return finite and (kept or jumps[-1] > max(LEAST * sizes[-1], KEEPS * jumps[0]))


def _moved(point: Sequence[Any], share: float, way: Sequence[Any]) -> list[Any]:
    return [a + share * b for a, b in zip(point, way, strict=True)]


def _size(vector: Sequence[Any]) -> float:
    return float(mpmath.norm(list(vector)))


def _zero(plain: Plain, root: _Root, known: dict[int, float], t: Any, q: list[Any]) -> list[Any]:
    """Move a point onto the zero by Gauss-Newton steps with derivatives by differences."""
    small = mpmath.mpf(10) ** (-DIGITS // 2)

    def below(point: list[Any]) -> list[Any]:
        return list(_root_terms(plain, root, known, _at(plain, t, point), mpmath.mp))

    for _ in range(4):
        u = below(q)
        columns = []
        for i in range(len(q)):
            moved = below([*q[:i], q[i] + small, *q[i + 1 :]])
            columns.append([float((a - b) / small) for a, b in zip(moved, u, strict=True)])
        change = np.linalg.pinv(np.array(columns).T) @ np.array([float(x) for x in u])
        q = [a - float(b) for a, b in zip(q, change, strict=True)]
    return q


def _potential(plain: Plain, known: dict[int, float], t: Any, q: list[Any]) -> Any:
    """Return V in many digits."""
    c, n = plain.V
    values = evaluated(plain.graph, [n], {**known, **_at(plain, t, q)}, mpmath.mp)
    return values[n] * c.numerator / c.denominator


def _force(plain: Plain, known: dict[int, float], t: Any, q: list[Any], v: list[Any]) -> list[Any]:
    """Return -dV/dq + f, by differences in many digits: the graph stays as it is."""
    graph, small = plain.graph, mpmath.mpf(10) ** (-DIGITS // 2)
    symbols = {**known, **dict(zip(plain.numbers(plain.v), v, strict=True))}
    potential = partial(_potential, plain, known, t)
    acting = evaluated(graph, [n for _, n in plain.f], {**symbols, **_at(plain, t, q)}, mpmath.mp)
    force = []
    for i, (c, n) in enumerate(plain.f):
        ahead, behind = (potential([*q[:i], q[i] + x, *q[i + 1 :]]) for x in (small, -small))
        force.append((behind - ahead) / (2 * small) + acting[n] * c.numerator / c.denominator)
    return force


class _Arrays:
    """The functions that nodes are evaluated with, on arrays."""

    mpf, mpc, nan, pi, euler = float, complex, np.nan, np.pi, np.euler_gamma
    catalan = float(mpmath.fp.catalan)

    @staticmethod
    def fsum(terms: Iterable[Any]) -> Any:
        return sum(terms)

    @staticmethod
    def fprod(factors: Iterable[Any]) -> Any:
        return reduce(mul, factors, 1.0)

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name, None) or np.vectorize(getattr(mpmath.fp, name))


_ARRAYS = _Arrays()
