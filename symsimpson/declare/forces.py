"""Forces, dissipation and inputs of a declaration, read into a graph."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from math import isqrt
from typing import Any, NoReturn

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.plain import Symbols
from symsimpson.declare.quadratic import sample
from symsimpson.errors import ModelWarning
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import ZERO, Value
from symsimpson.graph.rebuild import rebuild
from symsimpson.support.calling import warn

#: Names of the forces of Rayleigh's function, and of the sum of all forces.
DISSIPATION, TOTAL = "dissipation", "total"
#: Keys of ``run.work`` that no force may have.
OTHERS = (TOTAL, "constraints")
#: Relative size below which a double counts as zero at a random point.
NOTHING = 1e-9

Read = Callable[[str, Any], Value]
Forces = Mapping[Any, Any]


def read_forces(
    name: str,
    coordinates: Sequence[AppliedUndef],
    forces: Forces | None,
    dissipation: Any,
    symbols: Symbols,
    read: Read,
) -> dict[str, tuple[Value, ...]]:
    """Read the forces of a system, then the forces -dR/dv of its dissipation R(t, q, v).

    The function ``read`` checks an expression and reads it; its first argument names the
    expression. The result has a row for each force: its components, in the order of the
    coordinates. Forces that are zero are removed.
    """
    place = {q: i for i, q in enumerate(coordinates)}
    components: dict[str, list[Value]] = {}
    for key, coordinate, expression in _iterate_components(name, forces, coordinates):
        if coordinate not in place:
            _reject_coordinate(name, coordinate, coordinates)
        what = f"force on {spell(coordinate)}"
        value = read(what, expression)
        row = components.setdefault(key, [ZERO] * len(coordinates))
        row[place[coordinate]] = value
    if dissipation is not None:
        if DISSIPATION in components:
            _reject_name(name, DISSIPATION)
        value = read("dissipation", dissipation)
        v = symbols.numbers(symbols.v)
        if symbols.graph.nodes[value[1]].symbols.isdisjoint(v) and value[0]:
            reject_model(
                name,
                f"the dissipation {spell(dissipation)} depends on no velocity. Its forces are the "
                "derivatives f = -dR/dv.",
                "Write R = c*q.diff()**2/2 for f = -c v. Or declare the force itself: "
                "forces={q: -c*q.diff()}.",
            )
        slopes = gradient(symbols.graph, value, v)
        if value[0] and all(symbols.graph.nodes[n].symbols.isdisjoint(v) for _, n in slopes):
            reject_model(
                name,
                f"the dissipation {spell(dissipation)} is linear in velocities. Its forces -dR/dv "
                "do not depend on velocities, so they damp nothing.",
                "Write R = c*q.diff()**2/2 for f = -c v. Or declare a constant force in forces=.",
            )
        components[DISSIPATION] = [(-c, n) for c, n in slopes]
        if value[0] and sp.sympify(dissipation).xreplace(symbols.replace).is_extended_nonpositive:
            warn(
                f"system '{name}': the dissipation {spell(dissipation)} is negative. Its forces "
                "-dR/dv drive the motion instead of damping it.\nWrite R = c*q.diff()**2/2 with "
                "c > 0 for f = -c v. Declare forces that drive with forces={...}.",
                ModelWarning,
            )
    smooth = iter(
        _regularise_roots(symbols, [value for row in components.values() for value in row])
    )
    rows = {key: tuple(next(smooth) for _ in row) for key, row in components.items()}
    return {key: row for key, row in rows.items() if any(c for c, _ in row)}


def _regularise_roots(symbols: Symbols, values: Sequence[Value]) -> list[Value]:
    """Rewrite roots of squared speeds, as in drag, so that they have slopes at speed 0.

    sqrt(s) becomes sqrt(s + Tiny). Its slope at s = 0 is 0/sqrt(Tiny) instead of 0/0. For other
    s the sum rounds to s. Expressions that divide by s or by its root are left unchanged, because
    they have no value at rest.
    """
    graph, v = symbols.graph, {*symbols.numbers(symbols.v)}
    roots: set[int] = set()
    divided: set[int] = set()
    for n in graph.descendants(m for _, m in values):
        kind, parts, _ = graph.nodes[n]
        if kind == "function" and parts[0] == "pow":
            roots.add(parts[1][1])
        for m, e in parts if kind == "product" else ():
            if e < 0:
                divided.add(m)
            elif e.denominator > 1:  # the slope of a root below sqrt is infinite
                others = (graph.nodes[k].symbols for k, _ in parts if k != m)
                if 2 * e >= 1 or not v.isdisjoint(set().union(*others)):
                    roots.add(m)
    smooth = _select_touching_zero(symbols, sorted(roots - divided))
    return rebuild(graph, values, {m: graph.add([(1, m), graph.constant("Tiny")]) for m in smooth})


def _select_touching_zero(symbols: Symbols, nodes: Iterable[int]) -> list[int]:
    """Return the nodes that are quadratic forms in velocities with the minimum 0."""
    graph, speeds = symbols.graph, symbols.numbers(symbols.v)
    slopes: dict[int, list[Value]] = {}
    for n in nodes:
        present = [x for x in speeds if x in graph.nodes[n].symbols]
        if present:
            slopes[n] = gradient(graph, (1, n), present)
            slopes[n] += [x for y in [*slopes[n]] for x in gradient(graph, y, present)]
    touching = [*slopes]
    for sampled in sample(symbols, [x for n, row in slopes.items() for x in ((1, n), *row)]):
        numbers, least = iter(sampled), {}
        for n, row in slopes.items():
            value, *rest = islice(numbers, len(row) + 1)
            size = isqrt(len(row))
            slope, curve = np.array(rest[:size]), np.reshape(rest[size:], (size, size))
            if np.isfinite([value, *rest]).all() and np.linalg.eigvalsh(curve)[0] >= -NOTHING:
                lowest = slope @ np.linalg.pinv(curve, rcond=NOTHING) @ slope / 2
                least[n] = abs(value - lowest) <= NOTHING * abs(value)
        touching = [n for n in touching if least.get(n)]
    return touching


def read_inputs(
    name: str, inputs: Any, coordinates: Sequence[AppliedUndef], parameters: Iterable[sp.Symbol]
) -> tuple[sp.Expr, ...]:
    """Check that inputs are distinct symbols or functions of time; raise ModelError if not."""
    reject_here = partial(reject_model, name)
    if isinstance(inputs, (sp.Symbol, AppliedUndef)):
        inputs = (inputs,)
    if isinstance(inputs, (str, set, frozenset, Mapping)) or not isinstance(inputs, Iterable):
        reject_here(
            f"the inputs are {spell(inputs)!r}, not a tuple of symbols.",
            "Write u = sympy.Symbol('u') and inputs=(u,). Each run provides the values: "
            "integrate(..., inputs={'u': values}).",
        )
    taken = {q.func.__name__: "a coordinate" for q in coordinates}
    taken |= {a.name: "a parameter" for a in parameters}
    for u in (symbols := tuple(inputs)):
        function = isinstance(u, AppliedUndef) and u.args == (time,)
        if not function and (not isinstance(u, sp.Symbol) or u == time):
            reject_here(
                f"the input {spell(u)!r} is neither a symbol nor a function of time.",
                "Make it with sympy.Symbol('u') or sympy's dynamicsymbols('u'), and use it in a "
                "force.",
            )
        if u.is_real is False or u.is_integer:
            reject_here(
                f"the input {spell(u)} is declared {'an integer' if u.is_integer else 'not real'}. "
                "A run accepts any real value for it.",
                "Make it with sympy.Symbol(name, real=True).",
            )
        input_name = u.func.__name__ if function else u.name
        if input_name in taken:
            reject_here(
                f"two symbols have the name '{input_name}': an input and {taken[input_name]}.",
                "Rename one of them.",
            )
        taken[input_name] = "another input"
    return symbols


def check_used(
    name: str, inputs: Sequence[sp.Expr], symbols: Symbols, forces: Mapping[str, tuple[Value, ...]]
) -> None:
    """Reject an input that no force contains."""
    nodes = symbols.graph.nodes
    used = {s for force in forces.values() for _, n in force for s in nodes[n].symbols}
    for u in inputs:
        if symbols.known[u][1] not in used:
            reject_model(
                name,
                f"no force contains the input {spell(u)}, so its values would change nothing.",
                "Use it in forces={...}, or remove it.",
            )


def _iterate_components(
    name: str, forces: Forces | None, coordinates: Sequence[AppliedUndef]
) -> Iterator[tuple[str, Any, Any]]:
    """Yield each component: the name of the force, its coordinate and the expression."""
    if forces is None:
        return
    if not isinstance(forces, Mapping):
        reject_model(
            name,
            f"the forces are {spell(forces)!r}, not a mapping.",
            "Write forces={q: -c*q.diff()}. Or give each force a name: "
            "forces={'drag': {q: -c*q.diff()}}.",
        )
    taken: set[str] = set()
    for key, value in forces.items():
        force_name = key.func.__name__ if key in coordinates else ""
        if isinstance(key, str):
            force_name = key
        if force_name in taken or force_name in (*OTHERS, DISSIPATION):
            _reject_name(name, force_name)
        taken.add(force_name)
        if not isinstance(key, str):
            yield force_name, key, value
            continue
        if not isinstance(value, Mapping):
            way = f"forces={{{key!r}: {{q: ...}}}}, with the coordinate itself for q"
            if key in (q.func.__name__ for q in coordinates):
                way = f"forces={{{key}: ...}}, with the coordinate itself, not its name"
            reject_model(
                name,
                f"the force {key!r} is {spell(value)}, not a mapping from coordinates.",
                f"Name the coordinates on which it acts: {way}.",
            )
        yield from ((key, coordinate, part) for coordinate, part in value.items())


def _reject_name(name: str, key: str) -> NoReturn:
    reject_model(
        name,
        f"two forces would have the name {key!r}. run.work[{key!r}] would be ambiguous.",
        "A force declared by coordinate has the coordinate's name. The force of the dissipation is "
        f"called {DISSIPATION!r}. The names {' and '.join(map(repr, OTHERS))} are reserved.",
    )


def _reject_coordinate(name: str, given: Any, coordinates: Sequence[AppliedUndef]) -> NoReturn:
    names = ", ".join(spell(q) for q in coordinates)
    velocity = isinstance(given, sp.Derivative)
    reject_model(
        name,
        f"there is a force on {spell(given)}, which is not a coordinate of the system.",
        f"A generalised force acts on one of the coordinates {names}. Its power is the force times "
        "the velocity of that coordinate."
        + (f" Write forces={{{spell(given.expr)}: ...}}." if velocity else ""),
    )
