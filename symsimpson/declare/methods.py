"""Methods of SymPy's mechanics, read into the parts of a declaration."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.integrals.manualintegrate import manualintegrate
from sympy.integrals.risch import risch_integrate

from symsimpson.declare.checks import fail, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.expression_checks import SMOOTH
from symsimpson.declare.forces import read_inputs
from symsimpson.declare.identities import Identities
from symsimpson.declare.quadratic import rank
from symsimpson.errors import ModelWarning
from symsimpson.support.calling import warn

#: A generalised force, by coordinate; those on which it does not act are left out.
Force = dict[Any, sp.Expr]
#: Longer expressions are not integrated: SymPy may take for ever.
LONGEST_INTEGRAND = 400
#: Functions of a potential; a logarithm may not be defined where its derivative is.
ALLOWED = {*SMOOTH} - {sp.log}
#: Longer denominators of speeds are left as they are: SymPy may take for ever.
LONGEST_DENOMINATOR = 120


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
    if f.count_ops() >= LONGEST_INTEGRAND:
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


def read_kane(
    name: str, kane: Any, inputs: Sequence[sp.Expr]
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, Any], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the forces by name, and the constraints of both kinds.

    A body that rolls may have a velocity that is no derivative of a place in the coordinates. Then
    Lagrange's equations of T have terms that Kane's have not, p.(d/dt dv/dq' - dv/dq), and the same
    of the angular momentum. They become the force "rolling", which has no power. Raises ModelError
    if something that is needed is not in it, or cannot be written in velocities.
    """
    try:
        parts = kane.to_linearizer()
    except ValueError as error:
        raise fail(
            name,
            f"SymPy cannot take the KanesMethod apart: {' '.join(str(error).split())}",
            "Bodies and loads are in it once kanes_equations(bodies, loads) was called. Functions "
            "of time other than coordinates and speeds may stand in loads alone.",
        ) from None
    if len(parts.f_2) > len(parts.u) - len(parts.f_v):
        raise fail(
            name,
            "the KanesMethod has auxiliary speeds.",
            "They are zero in every motion, and bring forces of constraints into evidence. Leave "
            "u_auxiliary out: run['lambda_...'] has the multipliers of constraints.",
        )
    frame, held = kane._inertial, list(parts.f_c)
    coordinates, speeds, rows = _speeds(name, kane)
    known = Identities(name, "KanesMethod", coordinates, held)
    kinetic, rolling = _inertia(kane.bodies, frame, speeds, known)
    each = [generalised([load], frame, coordinates, speeds) for load in kane.loads or ()]
    given = sp.Add(*(body.potential_energy for body in kane.bodies)).xreplace(speeds)
    potential, loads = potential_of(each, coordinates, given, inputs, known.vanish)
    if given != 0 and not known.vanish((given - potential).diff(q) for q in coordinates):
        warn(
            f"system '{name}': the potential_energy of bodies is not that of the loads.\n"
            "It is left out: Kane's equations have loads alone. Apply its forces as loads, or set "
            "it to 0.",
            ModelWarning,
        )
    forces = {"loads": loads, "rolling": rolling}
    rows += [row.xreplace(speeds) for row in parts.f_v]
    forces = {key: force for key, force in forces.items() if force}
    return kinetic - potential, coordinates, forces, held, _others(rows, known)


def _speeds(name: str, kane: Any) -> tuple[tuple[Any, ...], dict[Any, sp.Expr], list[sp.Expr]]:
    """Return the coordinates, speeds in terms of velocities, and equations without a speed.

    Speeds that no kinematical equation has get coordinates of their own.
    """
    implicit = copy.copy(kane)
    implicit.explicit_kinematics = False
    kinematics = implicit.mass_matrix_kin * kane.q.diff(time) - implicit.forcing_kin
    used = [u for u in kane.u if kinematics.has(u)]
    more = {u: sp.Function(f"{u.func.__name__}_integral")(time) for u in kane.u if u not in used}
    with_speeds = [x for x in kinematics if x.has(*used)] if used else []
    solved = list(sp.linsolve(with_speeds, *used)) if used else [()]
    if not solved or any(x.has(*used) for x in solved[0]) or len(with_speeds) != len(used):
        raise fail(
            name,
            f"the {len(with_speeds)} kinematical equations do not say what the {len(used)} speeds "
            f"{spell(tuple(used))} are.",
            "Each speed is to follow from coordinates and velocities. Write as many equations as "
            "there are speeds, as u - (...), and what coordinates are held by, as q0*q0.diff() + "
            "... of a quaternion, as equations without a speed.",
        )
    speeds = {u: _shorter(x) for u, x in zip(used, solved[0], strict=True)}
    speeds |= {u: s.diff(time) for u, s in more.items()}
    return (*kane.q, *more.values()), speeds, [x for x in kinematics if x not in with_speeds]


def _shorter(speed: sp.Expr) -> sp.Expr:
    """Simplify a denominator, which mostly is one of squares of sines and cosines."""
    over, under = sp.fraction(sp.together(speed))
    return over / (sp.trigsimp(under) if 0 < under.count_ops() < LONGEST_DENOMINATOR else under)


def _inertia(
    bodies: Iterable[Any], frame: Any, speeds: Mapping[Any, sp.Expr], known: Identities
) -> tuple[sp.Expr, Force]:
    """Return T, and the terms that Lagrange's equations of it have and Kane's have not."""
    kinetic: list[sp.Expr] = []
    gaps: list[Force] = []
    for body in bodies:
        v = body.masscenter.vel(frame).xreplace(speeds)
        parts = [(v, body.mass * v)]
        if hasattr(body, "central_inertia"):
            w = body.frame.ang_vel_in(frame).xreplace(speeds)
            parts.append((w, body.central_inertia.dot(w)))
        for rate, momentum in parts:
            kinetic.append(momentum.dot(rate) / 2)
            turns = (rate.diff(q, frame, var_in_dcm=False).dt(frame) for q in known.rates)
            gap = [momentum.dot(turn).xreplace(speeds) for turn in turns]
            gap = [x - kinetic[-1].diff(q) for x, q in zip(gap, known.coordinates, strict=True)]
            if not known.idle(gap):
                gaps.append(dict(zip(known.coordinates, gap, strict=True)))
    total = added(gaps)
    return sp.Add(*kinetic), {q: f for q, f in total.items() if not known.vanish([f])}


def _others(rows: Sequence[sp.Expr], known: Identities) -> list[sp.Expr]:
    """Return the velocity constraints that do not follow from constraints of positions."""
    count = len(known.constraints)
    graph, matrix = known.rows([*(phi.diff(time) for phi in known.constraints), *rows])
    independent, kept = matrix[:count], []
    for equation, row in zip(rows, matrix[count:], strict=True):
        if rank(graph, [*independent, row]) > len(independent):
            independent.append(row)
            kept.append(equation)
    if count + len(kept) > len(rows):
        raise fail(
            known.name,
            "the velocity constraints do not hold the configuration constraints.",
            "Kane's equations hold velocities alone. Give the time derivative of each "
            "configuration constraint among velocity_constraints, too, or leave it out.",
        )
    return kept


def read_method(
    name: str, method: Any, inputs: Sequence[sp.Expr] = ()
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, Any], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the forces by name, and the constraints of both kinds.

    Raises ModelError if it is no LagrangesMethod and no KanesMethod, or one that lacks something.
    """
    driven = read_inputs(name, inputs, (), ())
    if hasattr(method, "kindiffdict"):
        return read_kane(name, method, driven)
    try:
        lagrangian, coordinates = method._L[0], tuple(method.q)
        held = list(method._hol_coneqs)
        frame, loads = method.inertial, method.forcelist or ()
        each = [generalised([load], frame, coordinates) for load in loads]
        rolling = list(method.coneqs)[len(held) :]
    except (AttributeError, TypeError, IndexError):
        raise fail(
            name,
            f"{type(method).__name__} is not a sympy.physics.mechanics.LagrangesMethod, nor a "
            "KanesMethod.",
            "Pass the method itself, as system.eom_method or joints.method, or use "
            "from_lagrangian(name, L, ...).",
        ) from None
    known = Identities(name, "LagrangesMethod", coordinates, held)
    potential, force = potential_of(each, coordinates, sp.S.Zero, driven, known.vanish)
    forces = {"forcelist": force} if force else {}
    return lagrangian - potential, coordinates, forces, held, rolling
