"""Kinks: points on a path at which a force, or V, is discontinuous.

The root of a sum of squares, r = sqrt(x**2 + y**2), is smooth except at r = 0, where its derivative
changes its sign. The function atan2(y, x) jumps by 2 pi at y = 0, x < 0. With every scheme, a step
across such a point has order one.
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
from symsimpson.graph.evaluate import evaluate_nodes
from symsimpson.graph.nodes import Exact, Value
from symsimpson.support.array_types import Floats

#: Largest distance of a zero from the segment between two states, relative to its length.
NEAR = 0.1
#: Largest number of passages of a root at which forces are compared.
PASSAGES = 8
#: Distances from the zero at which forces are compared, in steps, and digits of the comparison.
DISTANCES, DIGITS = (1e-2, 1e-3, 1e-4), 40
#: A force that grows by a larger factor towards the zero has a pole there.
MAX_GROWTH = 2.0
#: Least height of a jump, relative to the force, and least ratio of its heights near and far.
MIN_JUMP, MIN_RATIO = 1e-3, 0.5

HALF = Fraction(1, 2)
SMOOTH = (
    "Smooth the root, sqrt(... + epsilon**2). Or accept the result if half the step size does not "
    "change it"
)
UNCUT = "Replace the arcus tangent by an angle as a coordinate, or by its cosine and sine"


@dataclass(frozen=True)
class _Singularity:
    """The zeros of a sum of squares under a root, or the cut of atan2(y, x).

    A term of the sum is a constant factor times a square of a function of q and t. For atan2, the
    sum is y**2, and ``negative`` is x, which is negative on the cut.
    """

    where: str  #: The place as text, for messages.
    remedy: str  #: What the user can do about it, a sentence without its full stop.
    squares: tuple[tuple[tuple[Exact, int], ...], ...]  #: Pairs (half the exponent, base).
    factors: tuple[tuple[Exact, tuple[tuple[Exact, int], ...]], ...]
    negative: Value | None = None


def has_kinks(system: MechanicalSystem) -> bool:
    """Return whether V or a force may be discontinuous."""
    return bool(_find_singularities(system)[1])


def kink_passed(
    system: MechanicalSystem, t: Floats, q: Floats, values: Sequence[float]
) -> tuple[float, str, str] | None:
    """Find the first point of a path at which the force or V is discontinuous.

    ``t`` and ``q`` are the states of consecutive steps, shape (N,) and (N, n). ``values`` are the
    values of the parameters and then of the inputs, in the order of their declaration. The result
    is the time, the place with the user's expression, and a remedy. It is None if the path has no
    such point. A pole, at which the force is infinite, is not a kink.

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
    plain, singularities = _find_singularities(system)
    t, q = np.asarray(t, dtype=np.float64), np.asarray(q, dtype=np.float64)
    if not singularities or len(t) < 2:
        return None
    # a time transformation adds parameters at the end, which V does not contain
    count, total = len(plain.parameters), len(system.parameters)
    numbers = [float(x) for x in (*values[:count], *values[total:])]
    constants = dict(zip(plain.numbers((*plain.parameters, *plain.u)), numbers, strict=True))
    first: tuple[float, str, str] | None = None
    for singularity in singularities:
        passages = _near_passages(plain, singularity, constants, t, q)
        if passages is None:
            continue
        near, part = passages
        for k in np.flatnonzero(near)[:PASSAGES]:
            time = float(t[k] + part[k] * (t[k + 1] - t[k]))
            if first is not None and not time < first[0]:
                break
            ends = t[k : k + 2], q[k : k + 2]
            if _is_discontinuous(plain, singularity, constants, *ends, float(part[k])):
                first = time, singularity.where, singularity.remedy
                break
    return first


@lru_cache(maxsize=64)
def _find_singularities(system: MechanicalSystem) -> tuple[Plain, tuple[_Singularity, ...]]:
    """Return the graph of V and the forces, with their roots of sums of squares and atan2 cuts."""
    retiming = system.retiming
    plain = (system.plain if retiming is None else retiming.plain).resting
    graph, moving = plain.graph, {*plain.numbers(plain.q), plain.time}
    back = dict(Symbols(system.coordinates, system.parameters, system.inputs).back)
    bases: dict[int, None] = {}
    singularities = []
    for n in graph.descendants([plain.V[1], *(n for _, n in plain.f)]):
        if graph.nodes[n].kind == "function" and graph.nodes[n].parts[0] == "atan2":
            _, (_, y), x = graph.nodes[n].parts
            if _depends_on_positions(plain, moving, y, x[1]):
                where = f"the cut of {spell(plain.to_sympy((1, n)).xreplace(back), 200)}"
                singularities.append(_Singularity(where, UNCUT, (((1, y),),), ((1, ()),), x))
        factors = graph.factors(n)
        exponents = [e for m, e in factors if graph.nodes[m].symbols & moving]
        for m, e in factors:  # 1/r is a pole, unless its numerator moves and may vanish, too
            if e == HALF or (e == -HALF and max(exponents, default=0) > 0):
                bases[m] = None
    for n in bases:
        terms = _split_squares(plain, n, moving)
        if terms is not None:
            where = f"a zero of {spell(sp.sqrt(plain.to_sympy((1, n)).xreplace(back)), 200)}"
            squares, constants = (tuple(x) for x in zip(*terms, strict=True))
            singularities.append(_Singularity(where, SMOOTH, squares, constants))
    return plain, tuple(singularities)


def _depends_on_positions(plain: Plain, moving: set[int], n: int, *others: int) -> bool:
    """Return whether node n depends on q or t, and no node depends on velocities."""
    nodes, allowed = plain.graph.nodes, moving | {*plain.numbers((*plain.parameters, *plain.u))}
    symbols = frozenset().union(*(nodes[m].symbols for m in (n, *others)))
    return not nodes[n].symbols.isdisjoint(moving) and symbols <= allowed


def _split_squares(plain: Plain, n: int, moving: set[int]) -> list[tuple[Any, Any]] | None:
    """Split a sum of squares into terms: pairs (e/2, base) and a constant factor.

    Returns None if node n is not a sum of squares of functions of q and t.
    """
    graph = plain.graph
    if not _depends_on_positions(plain, moving, n):
        return None
    terms, seen = [], {n}
    work: list[tuple[Exact, int]] = [(1, n)]
    while work:
        c, m = work.pop()
        node = graph.nodes[m]
        if node.kind == "sum" and c > 0:  # a repeated term does not change the zeros of the sum
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
    plain: Plain, singularity: _Singularity, constants: dict[int, float], t: Floats, q: Floats
) -> tuple[NDArray[np.bool_], Floats] | None:
    """Find the segments between states that pass near a zero, shape (N - 1,) each.

    Returns whether a segment passes near it, and the fraction of the segment at the closest point.
    The result is None if there is no zero.
    """
    state = _state(plain, t, q)
    u = _square_roots(plain, singularity, constants, state, _ARRAYS)
    if u is None:
        return None
    on_cut: Any = True
    if singularity.negative is not None:
        c, n = singularity.negative
        x = evaluate_nodes(plain.graph, [n], {**constants, **state}, _ARRAYS)[n]
        on_cut = float(c) * np.broadcast_to(x, t.shape)[:-1] < 0
    with np.errstate(all="ignore"):
        start, change = u[:, :-1], np.diff(u, axis=1)
        length = (change**2).sum(axis=0)
        part = np.clip(-(start * change).sum(axis=0) / length, 0.0, 1.0)
        distance = ((start + part * change) ** 2).sum(axis=0)
        return (distance < NEAR**2 * length) & (length > 0.0) & on_cut, part


def _square_roots(
    plain: Plain,
    singularity: _Singularity,
    constants: dict[int, float],
    state: dict[int, Any],
    context: Any,
) -> Any:
    """Return the u_i of the sum of squares u_i^2, shape (terms, ...); None if it has no zero."""
    graph, rows = plain.graph, []
    symbols = {**constants, **state}
    for bases, (c, powers) in zip(singularity.squares, singularity.factors, strict=True):
        fixed = evaluate_nodes(graph, [b for _, b in powers], symbols, mpmath.fp)
        factor = float(c) * float(np.prod([fixed[b] ** float(e) for e, b in powers]))
        if not factor >= 0 or (factor > 0 and not bases):
            return None
        if factor > 0:
            values = evaluate_nodes(graph, [b for _, b in bases], symbols, context)
            rows.append(factor**0.5 * context.fprod(values[b] ** int(e) for e, b in bases))
    return np.array(rows) if rows else None


def _state(plain: Plain, t: Any, q: Any) -> dict[int, Any]:
    """Return the values of the nodes of q and t."""
    return dict(zip(plain.numbers(plain.q), np.transpose(q), strict=True)) | {plain.time: t}


def _is_discontinuous(
    plain: Plain,
    singularity: _Singularity,
    constants: dict[int, float],
    t: Floats,
    q: Floats,
    part: float,
) -> bool:
    """Return whether the force or V has a finite jump at a fraction ``part`` of a step.

    ``t`` and ``q`` are the two states of the step, shape (2,) and (2, n).
    """
    with mpmath.workdps(DIGITS):
        begin, end = (mpmath.mpf(float(x)) for x in t)
        start = [mpmath.mpf(float(x)) for x in q[0]]
        step = [mpmath.mpf(float(x)) for x in np.subtract(q[1], q[0])]
        time = begin + part * (end - begin)
        zero = _solve_zero(plain, singularity, constants, time, _displace(start, part, step))
        velocity = [x / (end - begin) for x in step]
        pairs = [[_displace(zero, part, step) for part in (-x, x)] for x in DISTANCES]
        forces = [[_force(plain, constants, time, x, velocity) for x in pair] for pair in pairs]
        potentials = [[_potential(plain, constants, time, x) for x in pair] for pair in pairs]
    sizes = [max(map(_norm, pair)) for pair in forces]
    jumps = [_norm([a - b for a, b in zip(*pair, strict=True)]) for pair in forces]
    finite = bool(np.isfinite(sizes).all()) and sizes[-1] <= MAX_GROWTH * sizes[0]
    changes = [float(abs(a - b)) for a, b in potentials]
    least = 10.0 ** (-DIGITS // 2) * float(max(abs(x) for pair in potentials for x in pair))
    potential_jumps = changes[-1] > max(least, MIN_RATIO * changes[0])
    force_jumps = jumps[-1] > max(MIN_JUMP * sizes[-1], MIN_RATIO * jumps[0])
    return finite and (potential_jumps or force_jumps)


def _displace(point: Sequence[Any], part: float, step: Sequence[Any]) -> list[Any]:
    """Return point + part * step."""
    return [a + part * b for a, b in zip(point, step, strict=True)]


def _norm(vector: Sequence[Any]) -> float:
    """Return the Euclidean norm in double precision."""
    return float(mpmath.norm(list(vector)))


def _solve_zero(
    plain: Plain, singularity: _Singularity, constants: dict[int, float], t: Any, q: list[Any]
) -> list[Any]:
    """Move a point onto the zero by Gauss-Newton steps with derivatives by differences."""
    small = mpmath.mpf(10) ** (-DIGITS // 2)

    def residual(q: list[Any]) -> list[Any]:
        state = _state(plain, t, q)
        return list(_square_roots(plain, singularity, constants, state, mpmath.mp))

    for _ in range(4):
        u = residual(q)
        columns = []
        for i in range(len(q)):
            displaced = residual([*q[:i], q[i] + small, *q[i + 1 :]])
            columns.append([float((a - b) / small) for a, b in zip(displaced, u, strict=True)])
        change = np.linalg.pinv(np.array(columns).T) @ np.array([float(x) for x in u])
        q = [a - float(b) for a, b in zip(q, change, strict=True)]
    return q


def _potential(plain: Plain, constants: dict[int, float], t: Any, q: list[Any]) -> Any:
    """Return V in many digits."""
    c, n = plain.V
    values = evaluate_nodes(plain.graph, [n], {**constants, **_state(plain, t, q)}, mpmath.mp)
    return values[n] * c.numerator / c.denominator


def _force(
    plain: Plain, constants: dict[int, float], t: Any, q: list[Any], v: list[Any]
) -> list[Any]:
    """Return -dV/dq + f in many digits, by differences, because V has no node for dV/dq."""
    graph, small = plain.graph, mpmath.mpf(10) ** (-DIGITS // 2)
    symbols = {**constants, **dict(zip(plain.numbers(plain.v), v, strict=True))}
    potential = partial(_potential, plain, constants, t)
    f = evaluate_nodes(
        graph, [n for _, n in plain.f], {**symbols, **_state(plain, t, q)}, mpmath.mp
    )
    force = []
    for i, (c, n) in enumerate(plain.f):
        plus, minus = (potential([*q[:i], q[i] + x, *q[i + 1 :]]) for x in (small, -small))
        force.append((minus - plus) / (2 * small) + f[n] * c.numerator / c.denominator)
    return force


class _ArrayContext:
    """The functions of an mpmath context for NumPy arrays, to evaluate nodes at many states."""

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


_ARRAYS = _ArrayContext()
