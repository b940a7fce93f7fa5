"""Read a LagrangesMethod or a KanesMethod of SymPy into the parts of a declaration."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.integrals.manualintegrate import manualintegrate
from sympy.integrals.risch import risch_integrate

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.expression_checks import SMOOTH
from symsimpson.declare.forces import read_inputs
from symsimpson.declare.identities import Identities
from symsimpson.declare.quadratic import rank
from symsimpson.errors import ModelWarning
from symsimpson.support.calling import warn
from symsimpson.support.names import counted

#: A generalised force by coordinate, without the coordinates on which it does not act.
Force = dict[Any, sp.Expr]
#: Longest expression to integrate, in operations: SymPy may not terminate on longer ones.
LONGEST_INTEGRAND = 400
#: Functions of a potential. A logarithm may be undefined where its derivative is defined.
ALLOWED = {*SMOOTH} - {sp.log}
#: Longest denominator to simplify, in operations: SymPy may not terminate on longer ones.
LONGEST_DENOMINATOR = 120


def generalised_force(
    loads: Iterable[Any],
    inertial: Any,
    coordinates: Sequence[Any],
    speeds: Mapping[Any, sp.Expr] | None = None,
) -> Force:
    """Return the generalised force of loads: for each q, the sum of load . d(velocity)/dq'.

    A load is a pair of a point and a force, or of a frame and a torque. The mapping ``speeds``
    has the generalised speeds of a KanesMethod in terms of the velocities of coordinates.
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


def split_potential(
    each: Sequence[Force],
    coordinates: Sequence[AppliedUndef],
    declared: sp.Expr,
    inputs: Sequence[sp.Expr],
    vanish: Callable[[Iterable[sp.Expr]], bool],
) -> tuple[sp.Expr, Force]:
    """Split loads into a potential V and the generalised force that remains besides -dV/dq.

    The velocity-independent part of a load belongs to V if it is -dV/dq, alone or together with
    other loads. The ``declared`` potential energy is V if it belongs to all loads.
    V contains neither inputs nor the time. The function ``vanish`` tests whether expressions are
    zero identically.
    """
    still = {q.diff(time): 0 for q in coordinates}
    static = [{q: f.xreplace(still) for q, f in force.items()} for force in each]
    whole = add_forces(static)
    if declared != 0 and vanish(whole.get(q, 0) + declared.diff(q) for q in coordinates):
        V, conservative = declared, static
    else:
        V, conservative, others = sp.S.Zero, [], []
        for force in static:
            part = _integrate(force, coordinates, inputs, vanish)
            if part is None:
                others.append(force)
            else:
                V, conservative = V + part, [*conservative, force]
        part = _integrate(add_forces(others), coordinates, inputs, vanish)
        if part is not None:
            V, conservative = V + part, static
    left = add_forces([*each, *({q: -f for q, f in force.items()} for force in conservative)])
    return V, {q: f for q, f in left.items() if not vanish([f])}


def add_forces(forces: Iterable[Force]) -> Force:
    """Add forces by coordinate, and expand short sums so that terms cancel."""
    terms: dict[Any, list[sp.Expr]] = {}
    for force in forces:
        for q, f in force.items():
            terms.setdefault(q, []).append(f)
    return {q: _expand(sp.Add(*parts)) for q, parts in terms.items()}


def _expand(f: sp.Expr) -> sp.Expr:
    """Expand a short sum, but not the arguments of roots, inverses and functions."""
    if f.count_ops() >= LONGEST_INTEGRAND:
        return f
    inner = {part: sp.Dummy() for part in (*f.atoms(sp.Function), *_roots_and_inverses(f))}
    outer = f.xreplace(inner)
    return sp.expand(outer).xreplace({dummy: part for part, dummy in inner.items()})


def _roots_and_inverses(f: sp.Expr) -> list[sp.Pow]:
    """Return the powers in an expression whose exponent is not a positive integer."""
    return [x for x in f.atoms(sp.Pow) if not (x.exp.is_Integer and x.exp.is_positive)]


def _integrate(
    force: Force,
    coordinates: Sequence[AppliedUndef],
    inputs: Sequence[sp.Expr],
    vanish: Callable[[Iterable[sp.Expr]], bool],
) -> sp.Expr | None:
    """Return V with f = -dV/dq, or None if no V exists or SymPy does not find one."""
    plain = {q: sp.Dummy(q.func.__name__, real=True) for q in coordinates}
    # SymPy turns the root of a square into an absolute value, which has no slope
    nothing = sp.Dummy("nothing", positive=True)
    f = [_guard_roots(sp.sympify(force.get(q, 0)), nothing).xreplace(plain) for q in coordinates]
    driven = [x.atoms(AppliedUndef) | (x.free_symbols & {time, *inputs}) for x in f]
    if any(driven) or any(x.has(sp.nan, sp.zoo) for x in f):
        return None
    V = sp.S.Zero
    back = {dummy: q for q, dummy in plain.items()} | {nothing: sp.S.Zero}
    for x, part in zip(plain.values(), f, strict=True):
        slope = part + V.diff(x)
        if not vanish([slope.xreplace(back)]):
            # terms with the same distances may have a V together but not separately
            groups: dict[frozenset[sp.Expr], list[sp.Expr]] = {}
            for term in sp.Add.make_args(_expand(slope)):
                groups.setdefault(_distances(term, x), []).append(term)
            V -= sp.Add(*(_integral(sp.Add(*group), x) for group in groups.values()))
            if V.has(sp.Integral, sp.nan) or {g.func for g in V.atoms(sp.Function)} - ALLOWED:
                return None
    V = V.xreplace(back)
    exact = vanish(force.get(q, sp.S.Zero) + V.diff(q) for q in coordinates)
    return V if exact else None


def _guard_roots(f: sp.Expr, nothing: sp.Dummy) -> sp.Expr:
    """Add ``nothing`` to squares under roots, so that SymPy does not make absolute values."""
    roots = [x for x in _roots_and_inverses(f) if not x.exp.is_Integer]
    squares = {x.base for x in roots if x.base.is_Pow and x.base.exp == 2}
    return f.xreplace({square: square + nothing for square in squares})


def _distances(term: sp.Expr, x: sp.Dummy) -> frozenset[sp.Expr]:
    """Return the sums that contain x, as arguments of roots, inverses and functions."""
    inner = [a for f in term.atoms(sp.Function) for a in f.args]
    inner += [power.base for power in _roots_and_inverses(term)]
    inner = [a.base if a.is_Pow and a.exp.is_Rational else a for a in inner]
    return frozenset(a for a in inner if a.is_Add and a.has(x) and a.is_polynomial(x))


def _integral(group: sp.Expr, x: sp.Dummy) -> sp.Expr:
    """Integrate terms by x, with the substitution r^2 = distance where a distance allows it."""
    distances = _distances(group, x)
    s, r = sp.Dummy("s", positive=True), sp.Dummy("r", positive=True)
    for distance in (d for d in distances if not d.diff(x).is_Number):
        rate = sp.cancel(group.xreplace({distance: s}) / sp.expand(distance.diff(x)))
        if sp.cancel(rate - rate.xreplace({x: -x})) == 0:  # the distance is that to the origin
            rate = rate.xreplace({x: sp.sqrt(s)})
        if not rate.has(x):
            V = _elementary(sp.expand(2 * r * rate.xreplace({s: r**2})), r)
            return V.xreplace({r: sp.sqrt(distance)})
    for line in _lines(group, x):  # the distance is that of two points on a line
        z, slope = sp.Dummy("z", real=True), line.diff(x)
        moved = _expand(group.xreplace({x: (z - line.xreplace({x: sp.S.Zero})) / slope}))
        if len(moved.free_symbols) < len(group.free_symbols):
            return _integral(moved / slope, z).xreplace({z: line})
    bases = {power.base for power in _roots_and_inverses(group)}
    if any(len(base.atoms(sp.Dummy)) > 1 for base in bases & distances):
        return sp.Integral(group, x)  # SymPy may not terminate
    return _elementary(group, x)


def _lines(group: sp.Expr, x: sp.Dummy) -> list[sp.Expr]:
    """Return the bases of powers that are sums linear in x."""
    sums = {power.base for power in group.atoms(sp.Pow) if power.base.is_Add}
    return sorted((a for a in sums if a.diff(x).is_Number and a.has(x)), key=sp.default_sort_key)


def _elementary(f: sp.Expr, x: sp.Dummy) -> sp.Expr:
    """Integrate term by term, or all terms together for an exponential divided by x."""
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

    A rolling body may have a velocity that is not the derivative of a position in the
    coordinates. Then Lagrange's equations of T have terms p.(d/dt dv/dq' - dv/dq) that Kane's
    equations lack, and similar terms of the angular momentum. The force "rolling", which has no
    power, cancels them.
    """
    try:
        parts = kane.to_linearizer()
    except ValueError as error:
        reject_model(
            name,
            f"SymPy cannot read the KanesMethod: {' '.join(str(error).split())}",
            "Call kanes_equations(bodies, loads) first: it adds bodies and loads. Functions of "
            "time other than coordinates and speeds may appear in loads only.",
        )
    if len(parts.f_2) > len(parts.u) - len(parts.f_v):
        reject_model(
            name,
            "the KanesMethod has auxiliary speeds. They are zero in every motion, and serve to "
            "compute constraint forces.",
            "Remove u_auxiliary. The multipliers of constraints are run['lambda_...'].",
        )
    frame, configuration = kane._inertial, list(parts.f_c)
    coordinates, speeds, rows = _solve_speeds(name, kane)
    known = Identities(name, "KanesMethod", coordinates, configuration)
    kinetic, rolling = _kinetic_energy(kane.bodies, frame, speeds, known)
    each = [generalised_force([load], frame, coordinates, speeds) for load in kane.loads or ()]
    declared = sp.Add(*(body.potential_energy for body in kane.bodies)).xreplace(speeds)
    potential, loads = split_potential(each, coordinates, declared, inputs, known.vanish)
    if declared != 0 and not known.vanish((declared - potential).diff(q) for q in coordinates):
        warn(
            f"system '{name}': the potential_energy of the bodies differs from the potential of "
            "the loads.\nIt is ignored, because Kane's equations contain loads only. Apply its "
            "forces as loads, or set it to 0.",
            ModelWarning,
        )
    forces = {"loads": loads, "rolling": rolling}
    rows += [row.xreplace(speeds) for row in parts.f_v]
    forces = {key: force for key, force in forces.items() if force}
    rows = _select_independent(rows, known)
    return kinetic - potential, coordinates, forces, configuration, rows


def _solve_speeds(
    name: str, kane: Any
) -> tuple[tuple[Any, ...], dict[Any, sp.Expr], list[sp.Expr]]:
    """Return the coordinates, speeds in terms of velocities, and equations without a speed.

    A speed that no kinematical equation contains becomes the velocity of a new coordinate.
    """
    implicit = copy.copy(kane)
    implicit.explicit_kinematics = False
    kinematics = implicit.mass_matrix_kin * kane.q.diff(time) - implicit.forcing_kin
    used = [u for u in kane.u if kinematics.has(u)]
    more = {u: sp.Function(f"{u.func.__name__}_integral")(time) for u in kane.u if u not in used}
    with_speeds = [x for x in kinematics if x.has(*used)] if used else []
    solved = list(sp.linsolve(with_speeds, *used)) if used else [()]
    if not solved or any(x.has(*used) for x in solved[0]) or len(with_speeds) != len(used):
        reject_model(
            name,
            f"{counted(len(with_speeds), 'kinematical equation')} cannot determine "
            f"{counted(len(used), 'speed')} {spell(tuple(used))}. Each speed must follow from "
            "coordinates and velocities.",
            "Write as many equations as there are speeds, in the form u - (...). Write constraints "
            "of the coordinates as equations without a speed, for example q0*q0.diff() + ... for a "
            "quaternion.",
        )
    speeds = {u: _simplify_denominator(x) for u, x in zip(used, solved[0], strict=True)}
    speeds |= {u: s.diff(time) for u, s in more.items()}
    return (*kane.q, *more.values()), speeds, [x for x in kinematics if x not in with_speeds]


def _simplify_denominator(speed: sp.Expr) -> sp.Expr:
    """Simplify a denominator, which often is a sum of squares of sines and cosines."""
    over, under = sp.fraction(sp.together(speed))
    return over / (sp.trigsimp(under) if 0 < under.count_ops() < LONGEST_DENOMINATOR else under)


def _kinetic_energy(
    bodies: Iterable[Any], frame: Any, speeds: Mapping[Any, sp.Expr], known: Identities
) -> tuple[sp.Expr, Force]:
    """Return T, and the terms that Lagrange's equations of T have and Kane's equations lack."""
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
            if not known.does_no_work(gap):
                gaps.append(dict(zip(known.coordinates, gap, strict=True)))
    total = add_forces(gaps)
    return sp.Add(*kinetic), {q: f for q, f in total.items() if not known.vanish([f])}


def _select_independent(rows: Sequence[sp.Expr], known: Identities) -> list[sp.Expr]:
    """Return the velocity constraints that do not follow from constraints of positions."""
    count = len(known.constraints)
    graph, matrix = known.rows([*(phi.diff(time) for phi in known.constraints), *rows])
    independent, selected = matrix[:count], []
    for equation, row in zip(rows, matrix[count:], strict=True):
        if rank(graph, [*independent, row]) > len(independent):
            independent.append(row)
            selected.append(equation)
    if count + len(selected) > len(rows):
        reject_model(
            known.name,
            "the velocity constraints do not imply the configuration constraints. Kane's equations "
            "constrain velocities only.",
            "Add the time derivative of each configuration constraint to velocity_constraints, or "
            "remove the configuration constraint.",
        )
    return selected


def read_method(
    name: str, method: Any, inputs: Sequence[sp.Expr] = ()
) -> tuple[sp.Expr, tuple[Any, ...], dict[Any, Any], list[sp.Expr], list[sp.Expr]]:
    """Return L, the coordinates, the forces by name, and the constraints of both kinds.

    Reject an object that is neither a LagrangesMethod nor a KanesMethod.
    """
    driven = read_inputs(name, inputs, (), ())
    if hasattr(method, "kindiffdict"):
        return read_kane(name, method, driven)
    try:
        lagrangian, coordinates = method._L[0], tuple(method.q)
        configuration = list(method._hol_coneqs)
        frame, loads = method.inertial, method.forcelist or ()
        each = [generalised_force([load], frame, coordinates) for load in loads]
        rolling = list(method.coneqs)[len(configuration) :]
    except (AttributeError, TypeError, IndexError):
        reject_model(
            name,
            f"{type(method).__name__} is neither a sympy.physics.mechanics.LagrangesMethod nor a "
            "KanesMethod.",
            "Pass the method itself, for example system.eom_method or joints.method. Or use "
            "from_lagrangian(name, L, ...).",
        )
    known = Identities(name, "LagrangesMethod", coordinates, configuration)
    potential, force = split_potential(each, coordinates, sp.S.Zero, driven, known.vanish)
    forces = {"forcelist": force} if force else {}
    return lagrangian - potential, coordinates, forces, configuration, rolling
