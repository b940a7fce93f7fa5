"""Loads of SymPy's mechanics as generalised forces, and those that a potential gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.integrals.manualintegrate import manualintegrate
from sympy.integrals.risch import risch_integrate

from symsimpson.mechanics.coordinates import time
from symsimpson.mechanics.expression_checks import SMOOTH

__all__ = ["Force", "added", "generalised", "potential_of"]

#: A generalised force, by coordinate; those on which it does not act are left out.
Force = dict[Any, sp.Expr]
#: Longer expressions are not integrated: SymPy may take for ever.
TOO_LONG = 400
#: Functions of a potential; a logarithm may not be defined where its derivative is.
ALLOWED = {*SMOOTH} - {sp.log}


def generalised(
    loads: Iterable[Any],
    inertial: Any,
    coordinates: Sequence[Any],
    speeds: Mapping[Any, sp.Expr] | None = None,
) -> Force:
    """Return the generalised force of loads.

    Loads are pairs of a point and a force, or of a frame and a torque. Generalised ``speeds``, in
    which velocities and loads are written, are given in those of coordinates. For each coordinate
    the result is the sum of vector . d(velocity)/d(velocity of the coordinate).
    """
    force: Force = {}
    parts = []
    for where, vector in loads:
        turning = hasattr(where, "ang_vel_in")
        velocity = where.ang_vel_in(inertial) if turning else where.vel(inertial)
        parts.append((vector.xreplace(speeds or {}), velocity.xreplace(speeds or {})))
    for q in coordinates:
        slopes = ((f, v.diff(q.diff(time), inertial, var_in_dcm=False)) for f, v in parts)
        total = sp.Add(*(f.dot(slope) for f, slope in slopes))
        if total != 0:
            force[q] = total
    return force


def potential_of(
    each: Sequence[Force],
    coordinates: Sequence[AppliedUndef],
    given: sp.Expr,
    inputs: Sequence[sp.Expr],
    vanish: Callable[[Iterable[sp.Expr]], bool],
) -> tuple[sp.Expr, Force]:
    """Return a potential V of the loads that have one, and the force that is left beside -dV/dq.

    Of the generalised force of ``each`` load the part that stands without velocities belongs to V
    if f = -dV/dq, of itself or together with others. What is ``given`` is taken for V if it is that
    of all loads. Inputs stand in no potential, and neither does the time; ``vanish`` tells whether
    expressions are zero identically.
    """
    still = {q.diff(time): 0 for q in coordinates}
    static = [{q: f.xreplace(still) for q, f in force.items()} for force in each]
    whole = added(static)
    if given != 0 and vanish(whole.get(q, 0) + given.diff(q) for q in coordinates):
        V, held = given, static
    else:
        V, held, others = sp.S.Zero, [], []
        for force in static:
            part = _integrated(force, coordinates, inputs, vanish)
            if part is None:
                others.append(force)
            else:
                V, held = V + part, [*held, force]
        part = _integrated(added(others), coordinates, inputs, vanish)
        if part is not None:
            V, held = V + part, static
    left = added([*each, *({q: -f for q, f in force.items()} for force in held)])
    return V, {q: f for q, f in left.items() if not vanish([f])}


def added(forces: Iterable[Force]) -> Force:
    """Add forces; short sums are multiplied out, so that terms cancel."""
    terms: dict[Any, list[sp.Expr]] = {}
    for force in forces:
        for q, f in force.items():
            terms.setdefault(q, []).append(f)
    totals = {q: sp.Add(*parts) for q, parts in terms.items()}
    return {q: _multiplied_out(f) for q, f in totals.items()}


def _multiplied_out(f: sp.Expr) -> sp.Expr:
    """Multiply out a short sum, but not what roots, inverses and functions are taken of."""
    if f.count_ops() >= TOO_LONG:
        return f
    kept = {part: sp.Dummy() for part in (*f.atoms(sp.Function), *_roots_and_inverses(f))}
    outer = f.xreplace(kept)
    return sp.expand(outer).xreplace({dummy: part for part, dummy in kept.items()})


def _roots_and_inverses(f: sp.Expr) -> list[sp.Pow]:
    """Return the powers in an expression that are no products."""
    return [x for x in f.atoms(sp.Pow) if not (x.exp.is_Integer and x.exp.is_positive)]


def _integrated(
    force: Force,
    coordinates: Sequence[AppliedUndef],
    inputs: Sequence[sp.Expr],
    vanish: Callable[[Iterable[sp.Expr]], bool],
) -> sp.Expr | None:
    """Return V with f = -dV/dq; None if there is none, or it is not found."""
    plain = {q: sp.Dummy(q.func.__name__, real=True) for q in coordinates}
    # the root of a square would become an absolute value, which has no slope: it stays a distance
    nothing = sp.Dummy("nothing", positive=True)
    f = [_apart(sp.sympify(force.get(q, 0)), nothing).xreplace(plain) for q in coordinates]
    driven = [x.atoms(AppliedUndef) | (x.free_symbols & {time, *inputs}) for x in f]
    if any(driven) or any(x.has(sp.nan, sp.zoo) for x in f):
        return None
    V = sp.S.Zero
    back = {dummy: q for q, dummy in plain.items()} | {nothing: sp.S.Zero}
    for x, part in zip(plain.values(), f, strict=True):
        slope = part + V.diff(x)
        if not vanish([slope.xreplace(back)]):
            # of terms with the same distances together: of each alone there may be no V
            groups: dict[frozenset[sp.Expr], list[sp.Expr]] = {}
            for term in sp.Add.make_args(_multiplied_out(slope)):
                groups.setdefault(_distances(term, x), []).append(term)
            V -= sp.Add(*(_integral(sp.Add(*group), x) for group in groups.values()))
            if V.has(sp.Integral, sp.nan) or {g.func for g in V.atoms(sp.Function)} - ALLOWED:
                return None
    V = V.xreplace(back)
    exact = vanish(force.get(q, sp.S.Zero) + V.diff(q) for q in coordinates)
    return V if exact else None


def _apart(f: sp.Expr, nothing: sp.Dummy) -> sp.Expr:
    """Add nothing to squares of which roots are taken."""
    roots = [x for x in _roots_and_inverses(f) if not x.exp.is_Integer]
    squares = {x.base for x in roots if x.base.is_Pow and x.base.exp == 2}
    return f.xreplace({square: square + nothing for square in squares})


def _distances(term: sp.Expr, x: sp.Dummy) -> frozenset[sp.Expr]:
    """Return the sums of which roots, inverses and functions are taken, as far as x is in them."""
    inner = [a for f in term.atoms(sp.Function) for a in f.args]
    inner += [power.base for power in _roots_and_inverses(term)]
    inner = [a.base if a.is_Pow and a.exp.is_Rational else a for a in inner]
    return frozenset(a for a in inner if a.is_Add and a.has(x) and a.is_polynomial(x))


def _integral(group: sp.Expr, x: sp.Dummy) -> sp.Expr:
    """Integrate terms: by a distance of which they are a function times its slope, else by x."""
    distances = _distances(group, x)
    s, r = sp.Dummy("s", positive=True), sp.Dummy("r", positive=True)
    for distance in (d for d in distances if not d.diff(x).is_Number):
        rate = sp.cancel(group.xreplace({distance: s}) / sp.expand(distance.diff(x)))
        if sp.cancel(rate - rate.xreplace({x: -x})) == 0:  # on a line, from the origin
            rate = rate.xreplace({x: sp.sqrt(s)})
        if not rate.has(x):
            V = _elementary(sp.expand(2 * r * rate.xreplace({s: r**2})), r)
            return V.xreplace({r: sp.sqrt(distance)})
    for line in _lines(group, x):  # on a line, from one to the other
        z, slope = sp.Dummy("z", real=True), line.diff(x)
        moved = _multiplied_out(group.xreplace({x: (z - line.xreplace({x: sp.S.Zero})) / slope}))
        if len(moved.free_symbols) < len(group.free_symbols):
            return _integral(moved / slope, z).xreplace({z: line})
    bases = {power.base for power in _roots_and_inverses(group)}
    if any(len(base.atoms(sp.Dummy)) > 1 for base in bases & distances):
        return sp.Integral(group, x)  # SymPy may take for ever
    return _elementary(group, x)


def _lines(group: sp.Expr, x: sp.Dummy) -> list[sp.Expr]:
    """Return the sums of coordinates that stand in powers, linear in x."""
    sums = {power.base for power in group.atoms(sp.Pow) if power.base.is_Add}
    return sorted((a for a in sums if a.diff(x).is_Number and a.has(x)), key=sp.default_sort_key)


def _elementary(f: sp.Expr, x: sp.Dummy) -> sp.Expr:
    """Integrate terms one by one; all of them at once where exponentials are divided by x."""
    pairs = [term.as_independent(x, as_Add=False) for term in sp.Add.make_args(f)]
    V = sp.Add(*(factor * manualintegrate(rest, x) for factor, rest in pairs))
    if f.has(sp.exp) and {g.func for g in V.atoms(sp.Function)} - ALLOWED:
        with suppress(NotImplementedError):
            return risch_integrate(f, x)
    return V
