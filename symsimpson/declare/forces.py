"""Forces, dissipation and inputs: read, checked, by name and by coordinate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from math import isqrt
from typing import Any

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.checks import fail, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.plain import Symbols
from symsimpson.declare.quadratic import samples
from symsimpson.errors import ModelWarning
from symsimpson.graph.derive import gradient
from symsimpson.graph.nodes import ZERO, Value
from symsimpson.graph.rebuild import rebuilt
from symsimpson.support.calling import warn

#: Names of the forces that Rayleigh's function gives, and of the sum of all.
DISSIPATION, TOTAL = "dissipation", "total"
#: Names of what is no force but does work, too.
OTHERS = (TOTAL, "constraints")
#: Numbers below this, relative to others, are zero at random points of doubles.
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
    """Read forces by coordinate or by name, then the forces -dR/dv of the dissipation R(t, q, v).

    ``name`` is the name of the system. ``read`` checks an expression and reads it; its first
    argument says what the expression is. Each named force has its components in the order of the
    coordinates.
    """
    place = {q: i for i, q in enumerate(coordinates)}
    components: dict[str, list[Value]] = {}
    for key, coordinate, expression in _components(name, forces, coordinates):
        if coordinate not in place:
            raise _nowhere(name, coordinate, coordinates)
        what = f"force on {spell(coordinate)}"
        value = read(what, expression)
        row = components.setdefault(key, [ZERO] * len(coordinates))
        row[place[coordinate]] = value
    if dissipation is not None:
        if DISSIPATION in components:
            raise _taken(name, DISSIPATION)
        value = read("dissipation", dissipation)
        v = symbols.numbers(symbols.v)
        if symbols.graph.nodes[value[1]].symbols.isdisjoint(v) and value[0]:
            raise fail(
                name,
                f"the dissipation {spell(dissipation)} depends on no velocity.",
                "The forces are its derivatives, f = -dR/dv: write R = c*q.diff()**2/2 for f = -c "
                "v, or give the force itself with forces={q: -c*q.diff()}.",
            )
        slopes = gradient(symbols.graph, value, v)
        if value[0] and all(symbols.graph.nodes[n].symbols.isdisjoint(v) for _, n in slopes):
            raise fail(
                name,
                f"the dissipation {spell(dissipation)} is linear in velocities: its forces -dR/dv "
                "do not depend on them, and damp nothing.",
                "Write R = c*q.diff()**2/2 for f = -c v, or a constant force in forces=.",
            )
        components[DISSIPATION] = [(-c, n) for c, n in slopes]
        if value[0] and sp.sympify(dissipation).xreplace(symbols.replace).is_extended_nonpositive:
            warn(
                f"system '{name}': the dissipation {spell(dissipation)} is negative, so that its "
                "forces -dR/dv drive the motion and do not damp it.\nWrite R = c*q.diff()**2/2 "
                "with c > 0 for f = -c v; or give forces that drive by forces={...}.",
                ModelWarning,
            )
    smooth = iter(_smooth_at_rest(symbols, [value for row in components.values() for value in row]))
    rows = {key: tuple(next(smooth) for _ in row) for key, row in components.items()}
    return {key: row for key, row in rows.items() if any(c for c, _ in row)}


def _smooth_at_rest(symbols: Symbols, values: Sequence[Value]) -> list[Value]:
    """Write roots of squared speeds, as in drag, with slopes where the speed is 0.

    sqrt(s) becomes sqrt(s + Tiny), whose slope is 0/sqrt(Tiny) there and not 0/0; elsewhere the sum
    is s, rounded. What is divided by s or its root has no value at rest, and keeps none.
    """
    graph, v = symbols.graph, {*symbols.numbers(symbols.v)}
    roots: set[int] = set()
    divided: set[int] = set()
    for n in graph.reached(m for _, m in values):
        kind, parts, _ = graph.nodes[n]
        if kind == "function" and parts[0] == "pow":
            roots.add(parts[1][1])
        for m, e in parts if kind == "product" else ():
            if e < 0:
                divided.add(m)
            elif e.denominator > 1:  # of lower roots alone slopes are infinite
                others = (graph.nodes[k].symbols for k, _ in parts if k != m)
                if 2 * e >= 1 or not v.isdisjoint(set().union(*others)):
                    roots.add(m)
    smooth = _touching_zero(symbols, sorted(roots - divided))
    return rebuilt(graph, values, {m: graph.add([(1, m), graph.constant("Tiny")]) for m in smooth})


def _touching_zero(symbols: Symbols, nodes: Iterable[int]) -> list[int]:
    """Return the nodes that are quadratic forms in velocities whose least value is 0."""
    graph, speeds = symbols.graph, symbols.numbers(symbols.v)
    slopes: dict[int, list[Value]] = {}
    for n in nodes:
        present = [x for x in speeds if x in graph.nodes[n].symbols]
        if present:
            slopes[n] = gradient(graph, (1, n), present)
            slopes[n] += [x for y in [*slopes[n]] for x in gradient(graph, y, present)]
    touching = [*slopes]
    for sampled in samples(symbols, [x for n, row in slopes.items() for x in ((1, n), *row)]):
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
    """Check that inputs are distinct symbols, or functions of time, with names of their own.

    Raises ModelError.
    """
    refuse = partial(fail, name)
    if isinstance(inputs, (sp.Symbol, AppliedUndef)):
        inputs = (inputs,)
    if isinstance(inputs, (str, set, frozenset, Mapping)) or not isinstance(inputs, Iterable):
        raise refuse(
            f"the inputs are {spell(inputs)!r}, not a tuple of symbols.",
            "Write u = sympy.Symbol('u') and inputs=(u,): their values are given to each run, in "
            "integrate(..., inputs={'u': values}).",
        )
    taken = {q.func.__name__: "a coordinate" for q in coordinates}
    taken |= {a.name: "a parameter" for a in parameters}
    for u in (symbols := tuple(inputs)):
        function = isinstance(u, AppliedUndef) and u.args == (time,)
        if not function and (not isinstance(u, sp.Symbol) or u == time):
            raise refuse(
                f"the input {spell(u)!r} is neither a symbol nor a function of time.",
                "Make it with sympy.Symbol('u') or sympy's dynamicsymbols('u'), and use it in "
                "the forces.",
            )
        if u.is_real is False or u.is_integer:
            raise refuse(
                f"the input {spell(u)} is declared {'an integer' if u.is_integer else 'not real'}.",
                "A run may give it any real value. Make it with sympy.Symbol(name, real=True).",
            )
        input_name = u.func.__name__ if function else u.name
        if input_name in taken:
            raise refuse(
                f"two symbols of one name, '{input_name}': an input and {taken[input_name]}.",
                "Rename one of them.",
            )
        taken[input_name] = "another input"
    return symbols


def check_used(
    name: str, inputs: Sequence[sp.Expr], symbols: Symbols, forces: Mapping[str, tuple[Value, ...]]
) -> None:
    """Refuse an input that stands in no force; raises ModelError."""
    nodes = symbols.graph.nodes
    used = {s for force in forces.values() for _, n in force for s in nodes[n].symbols}
    for u, n in zip(inputs, symbols.numbers(symbols.u), strict=True):
        if n not in used:
            raise fail(
                name,
                f"the input {spell(u)} stands in no force.",
                "Its values would change nothing. Write it into forces={...}, or leave it out.",
            )


def _components(
    name: str, forces: Forces | None, coordinates: Sequence[AppliedUndef]
) -> Iterator[tuple[str, Any, Any]]:
    """Return each component: the force's name, the coordinate it acts on, the expression."""
    if forces is None:
        return
    if not isinstance(forces, Mapping):
        raise fail(
            name,
            f"the forces are {spell(forces)!r}, not a mapping.",
            "Write forces={q: -c*q.diff()}, by coordinate, or with names of their own: "
            "forces={'drag': {q: -c*q.diff()}}.",
        )
    taken: set[str] = set()
    for key, value in forces.items():
        force_name = key.func.__name__ if key in coordinates else ""
        if isinstance(key, str):
            force_name = key
        if force_name in taken or force_name in (*OTHERS, DISSIPATION):
            raise _taken(name, force_name)
        taken.add(force_name)
        if not isinstance(key, str):
            yield force_name, key, value
            continue
        if not isinstance(value, Mapping):
            way = f"forces={{{key!r}: {{q: ...}}}}, with the coordinate itself for q"
            if key in (q.func.__name__ for q in coordinates):
                way = f"forces={{{key}: ...}}, with the coordinate itself, not its name"
            raise fail(
                name,
                f"the force {key!r} is {spell(value)}, not a mapping from coordinates.",
                f"Say on which coordinates it acts: {way}.",
            )
        yield from ((key, coordinate, part) for coordinate, part in value.items())


def _taken(name: str, key: str) -> Exception:
    return fail(
        name,
        f"two forces would have the name {key!r}.",
        f"run.work[{key!r}] could be either. A force given by coordinate has the coordinate's "
        f"name, that of the dissipation is {DISSIPATION!r}; {' and '.join(map(repr, OTHERS))} are "
        "taken.",
    )


def _nowhere(name: str, given: Any, coordinates: Sequence[AppliedUndef]) -> Exception:
    names = ", ".join(spell(q) for q in coordinates)
    velocity = isinstance(given, sp.Derivative)
    return fail(
        name,
        f"there is a force on {spell(given)}, which is no coordinate of the system.",
        f"A generalised force belongs to a coordinate, one of {names}: its power is the force "
        "times that coordinate's velocity."
        + (f" Write forces={{{spell(given.expr)}: ...}}." if velocity else ""),
    )
