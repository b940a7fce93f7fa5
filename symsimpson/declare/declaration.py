"""Read the energies, constraints, forces and labels of a declaration, and check them together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.bodies import warn_of_lengths
from symsimpson.declare.checks import check_names, reject_model, spell
from symsimpson.declare.constraints import (
    check_constrained_mass,
    check_number,
    read_constraints,
    read_velocity_constraints,
    slopes,
    warn_of_integrable,
)
from symsimpson.declare.coordinates import momenta
from symsimpson.declare.declared import LARGE, Declared, Positions
from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.forces import check_used, read_forces
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.declare.quadratic import (
    QuadraticInVelocities,
    check_degenerate,
    check_homogeneous,
    check_mass_matrix,
    is_indefinite,
    quadratic_form,
    split_by_velocities,
)
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ZERO, Value, scale
from symsimpson.graph.read import tree_size
from symsimpson.support.names import did_you_mean, spelled
from symsimpson.text.quantity import SCALARS


def split_lagrangian(
    lagrangian: sp.Expr, parts: QuadraticInVelocities, symbols: Symbols
) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
    """Return T, a.v and V of a Lagrangian, without expanding an M of more than LARGE nodes.

    If the Lagrangian is not quadratic in the velocities, T has all terms that contain a velocity.
    """
    if not parts.quadratic:
        moving = {symbols.back[x] for x in symbols.v}
        still = sp.Add(
            *(x for x in sp.Add.make_args(lagrangian) if not x.atoms(sp.Derivative) & moving)
        )
        return lagrangian - still, sp.S.Zero, -still
    graph, to_user = symbols.graph, symbols.to_user
    linear = to_user(graph.add(graph.products(parts.a, symbols.numbers(symbols.v))))
    potential: sp.Expr = -to_user(parts.rest)
    entries = sum(tree_size(graph, value) for value in parts.M.values())
    if entries > LARGE:
        return lagrangian - linear + potential, linear, potential
    velocities = [symbols.back[x] for x in symbols.v]
    terms = (
        to_user(value) * velocities[i] * velocities[j] / (2 if i == j else 1)
        for (i, j), value in parts.M.items()
    )
    return sp.Add(*terms), linear, potential


def read_energies(
    name: str,
    coordinates: tuple[AppliedUndef, ...],
    parameters: Mapping[sp.Symbol, float],
    given: Declared,
) -> tuple[Plain, Positions, Mapping[str, sp.Expr]]:
    """Check a declaration, and return its graph, its positions and its invariants."""
    reject_here = partial(reject_model, name)
    s = Symbols(coordinates, parameters, given.inputs)

    def read(what: str, expression: Any, *allowed: Sequence[sp.Symbol]) -> Value:
        places = [symbol for group in (*allowed, s.q, s.a) for symbol in group]
        return read_expression(name, what, expression, s, s.known, places)

    def read_timed(what: str, expression: Any) -> Value:
        return read(what, expression, s.v, (s.t,))

    kinetic = read_timed("kinetic energy", given.kinetic)
    potential = read("potential", given.potential, (s.t,))
    linear = read_timed("gyroscopic term", given.gyroscopic)
    parts = split_by_velocities(name, "kinetic energy", kinetic, s)
    left = [*parts.a, parts.rest] if parts.quadratic else []
    prescribed = given.motion is not None
    prescribed |= any(s.graph.symbol(s.t.name)[1] in s.graph.nodes[n].symbols for _, n in left)
    if prescribed:  # a prescribed motion adds terms to T that belong to a and to V
        kinetic = quadratic_form(s.graph, parts.M, s.numbers(s.v))
        potential = s.graph.add([potential, scale(-1, parts.rest)])
        linear = s.graph.add([linear, *s.graph.products(parts.a, s.numbers(s.v))])
    elif not all(map(IdentityTest(s.graph, left).vanishes, left)):
        leftover = s.graph.add([*s.graph.products(parts.a, s.numbers(s.v)), parts.rest])
        if not parts.M and not any(c for c, _ in parts.a):
            reject_here(
                f"the kinetic energy {spell(given.kinetic)} contains no velocity.",
                "A velocity is the derivative of a coordinate. Write "
                f"{s.back[s.v[0]].expr}.diff() for the velocity of {s.back[s.v[0]].expr}.",
            )
        there, moving = (s.graph.nodes[n].symbols for _, n in (leftover, kinetic))
        places = zip(s.v, s.numbers(s.q), s.numbers(s.v), strict=True)
        still = [s.back[v].expr for v, q, rate in places if q in there and rate not in moving]
        meant = f"Did you mean {' or '.join(f'{x.func}.diff()' for x in still)}? " if still else ""
        reject_here(
            f"the kinetic energy is not a quadratic form in the velocities. It contains "
            f"{spell(s.to_user(leftover))}.",
            f"{meant}Move terms without velocities to the potential, with the opposite sign. Move "
            "linear terms to a Lagrangian: MechanicalSystem.from_lagrangian(name, L, ...).",
        )
    gyroscopic = split_by_velocities(name, "gyroscopic term", linear, s)
    constraints = read_constraints(name, given.constraints, s, lambda *x: read(*x, (s.t,)))

    def read_moving(what: str, expression: Any) -> Value:
        return read(what, expression, s.v, (s.t,), s.u)

    a, lagrangian = gyroscopic.a, None
    if not parts.quadratic:
        lagrangian = s.graph.add([kinetic, linear, scale(-1, potential)])
        parts = split_by_velocities(name, "Lagrangian", lagrangian, s)
        kinetic, a, potential = (
            quadratic_form(s.graph, parts.M, s.numbers(s.v)),
            parts.a,
            scale(-1, parts.rest),
        )
        check_homogeneous(name, lagrangian, s)

    rolling = read_velocity_constraints(
        name, given.velocity_constraints, constraints, s, read_moving
    )
    of_positions = slopes(s.graph, constraints.values(), s.numbers(s.q))
    rows = dict(zip(constraints, of_positions, strict=True))
    rows |= {key: list(row[:-1]) for key, row in rolling.items()}
    clock = s.graph.symbol(s.t.name)[1]
    driven = any(clock in s.graph.nodes[n].symbols for _, n in constraints.values())
    driven |= any(row[-1][0] for row in rolling.values())
    if not given.in_mode:  # in a mode, nothing may be left to move
        check_number(name, rows, s, driven=driven)
        warn_of_integrable(name, rolling, of_positions, s)
    defaults = [*parameters.values()]
    definite = not is_indefinite(s, parts.M, defaults)
    if rows:
        if not definite or lagrangian is not None:
            reject_here(
                "it has constraints, and its "
                + (
                    "mass matrix is indefinite."
                    if lagrangian is None
                    else "Lagrangian is not quadratic in the velocities."
                )
                + " Steps with constraints need a positive definite mass matrix M(q).",
                "Use coordinates that need no constraints.",
            )
        check_constrained_mass(name, parts.M, list(rows.values()), s)
    else:
        check_degenerate(name, QuadraticInVelocities(parts.M, a, ZERO), s)
        if not given.mass_checked:
            known = None if given.indefinite else [] if definite else defaults
            check_mass_matrix(name, parts.M, s, known)
    if gyroscopic.M or not IdentityTest(s.graph, [gyroscopic.rest]).vanishes(gyroscopic.rest):
        reject_here(
            f"the gyroscopic term {spell(given.gyroscopic)} is not linear in the velocities.",
            "It must have the form a(q).v. Move the other terms to T or V.",
        )

    forces = read_forces(name, coordinates, given.forces, given.dissipation, s, read_moving)
    if not given.in_mode:
        elements = (*given.contacts.values(), *given.friction.values())
        of_friction = set().union(*(x.free_symbols for x in elements))
        check_used(name, [u for u in given.inputs if u not in of_friction], s, forces)
    positions = read_positions(name, given, s, read)
    pairs = zip(momenta(*coordinates), s.p, strict=True)
    of_momenta = {user: s.graph.symbol(symbol.name) for user, symbol in pairs}
    for both in s.known.keys() & of_momenta.keys() if given.invariants is not None else ():
        reject_here(
            f"the parameter {both} is also the symbol of a momentum. An invariant that contains "
            "it would be ambiguous.",
            "Give the parameter another name.",
        )
    watch = s.known | of_momenta
    invariants = read_invariants(name, given.invariants)
    allowed = (*s.q, *s.v, *s.p, *s.a, s.t)
    values = {
        key: read_expression(name, f"invariant {key!r}", quantity, s, watch, allowed)
        for key, quantity in invariants.items()
    }
    plain = Plain(
        graph=s.graph,
        q=s.q,
        v=s.v,
        p=s.p,
        parameters=s.a,
        T=kinetic,
        M=dict(parts.M),
        a=a,
        V=potential,
        lagrangian=lagrangian,
        definite=definite,
        invariants=MappingProxyType(values),
        t=s.t,
        forces=forces,
        u=s.u,
        constraints=constraints,
        velocity_constraints=rolling,
    )
    warn_of_lengths(name, coordinates, [*given.constraints.values()] if given.constraints else [])
    names = [q.func.__name__ for q in coordinates]
    written_out = _explicit_momenta(plain, names)
    check_names(name, names, (key for key in invariants if key not in written_out))
    for key in (f"lambda_{key}" for key in rows):
        taken = {*names, *(str(a) for a in parameters), *invariants}
        # constraints of a list have numbers as names, and need not be found by name
        if key in taken and not key.removeprefix("lambda_").isdigit():
            reject_here(
                f"the multiplier of a constraint has the name {key!r} of another quantity. "
                f"run[{key!r}] would be ambiguous.",
                "Give the constraint another name.",
            )
    return plain, MappingProxyType(positions), sympified(invariants)


def _explicit_momenta(plain: Plain, names: Sequence[str]) -> set[str]:
    """Return the invariants that have both the name and the value of a momentum."""
    graph, v, p = plain.graph, plain.numbers(plain.v), plain.numbers(plain.p)
    keys = set()
    for i, x in enumerate(names):
        key = f"p_{x}"
        if key in plain.invariants:
            row = [plain.entry(i, j) for j in range(len(v))]
            momentum = graph.add([plain.a[i], *graph.products(row, v)])
            given: Value = plain.invariants[key]
            findings = IdentityTest(graph, [given, momentum, (1, p[i])])
            if any(findings.equal(given, other) for other in (momentum, (1, p[i]))):
                keys.add(key)
    return keys


def read_mapping(name: str, what: str, given: Any, example: str) -> Mapping[Any, Any]:
    """Return a mapping as it is, and an empty one for None."""
    if given is not None and not isinstance(given, Mapping):
        reject_model(
            name,
            f"the {what} are a {type(given).__name__}, not a mapping from names.",
            f"Give each of them a name, which runs use: {what}={example}.",
        )
    return given or {}


def read_invariants(name: str, given: Any) -> Mapping[str, Any]:
    """Check that invariants have names."""
    invariants = read_mapping(name, "invariants", given, "{'J': x**2}")
    for key in invariants:
        if not isinstance(key, str):
            reject_model(
                name,
                f"the invariant's name {key!r} is not a string.",
                "Write invariants={'angular momentum': ...}.",
            )
    return invariants


def sympified(invariants: Mapping[str, Any]) -> Mapping[str, sp.Expr]:
    """Return invariants that were read as SymPy expressions."""
    return MappingProxyType({key: sp.sympify(x) for key, x in invariants.items()})


def read_positions(
    name: str, given: Declared, symbols: Symbols, read: Callable[..., Value]
) -> dict[str, tuple[Any, ...]]:
    """Check the positions to draw: a point is a tuple, a body a tuple of corners."""
    positions: dict[str, tuple[Any, ...]] = {}
    for key, point in read_mapping(name, "positions", given.positions, "{'bob': (x, y)}").items():
        nested = isinstance(point, (tuple, list))
        body = nested and all(isinstance(x, (tuple, list, sp.MatrixBase)) for x in point)
        corners = point if body else [point]
        points: list[tuple[sp.Expr, ...]] = []
        for corner in corners:
            single = not isinstance(corner, (tuple, list, sp.MatrixBase))
            components = (corner,) if single else tuple(corner)
            if not 1 <= len(components) <= 3:
                reject_model(
                    name,
                    f"the position {key!r} has {len(components)} components.",
                    "Pass one to three Cartesian components for a point.",
                )
            for component in components:
                read(f"position {key!r}", component, (symbols.t,))
            points.append(tuple(sp.sympify(c) for c in components))
        positions[str(key)] = tuple(points) if body else points[0]
    return positions


def read_units(
    name: str, given: Mapping[Any, Any] | None, coordinates: Iterable[Any], others: Iterable[Any]
) -> dict[str, str]:
    """Check units, and add units of velocities and scalars.

    The ``others`` are further quantities that may have a unit: parameters, inputs, invariants
    and points.
    """
    names = [spelled(q) for q in coordinates]
    known = [*names, *(f"{x}_{q}" for x in "vp" for q in names), *map(spelled, others), "t"]
    known += [x.name for x in SCALARS]
    units: dict[str, str] = {}
    labels = "Units are labels, written as strings: units={'x': 'm', 't': 's'}."
    if given is not None and not isinstance(given, Mapping):
        reject_model(name, f"units is {type(given).__name__}, not a mapping.", labels)
    for key, unit in (given or {}).items():
        quantity = spelled(key)
        if quantity not in known:
            reject_model(
                name,
                f"units contains {quantity!r}, which the system does not have."
                f"{did_you_mean(quantity, known)}",
                "Quantities with units are coordinates, momenta and velocities (p_ and v_ before a "
                "coordinate), parameters, inputs, invariants, points, 't', "
                f"{', '.join(x.name for x in SCALARS)}.",
            )
        if quantity in units:
            what = f"units contains {quantity} twice, by name and by symbol."
            reject_model(name, what, "Give it once.")
        if not isinstance(unit, str):
            reject_model(name, f"the unit of {quantity} is {unit!r}, not a string.", labels)
        units[quantity] = unit
    for q in names if "t" in units else ():
        if q in units:
            units.setdefault(f"v_{q}", f"{units[q]}/{units['t']}")
    for scalar in SCALARS:
        if scalar.like in units:
            units.setdefault(scalar.name, units[scalar.like])
    return units
