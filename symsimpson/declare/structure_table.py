"""The table of a structure: each property, its reason, and the work that it saves."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from symsimpson.support import markup

Row = tuple[str, str, str, str]
HEAD: Row = ("finding", "here", "because", "removes")


def rows(structure: Any) -> list[Row]:
    """Return a row for each property: name, value, reason, and what it removes from a step."""
    names = [user.func.__name__ for user in structure.system.coordinates]
    words = {"constant": structure.constant_mass, "diagonal": structure.diagonal_mass}
    mass = ", ".join(word for word, holds in words.items() if holds)
    rows_of = _list_names(structure.constant_rows)
    some_rows = bool(rows_of) and not structure.constant_mass
    table: list[Row] = []

    def add(name: str, here: str, because: str = "", removes: str = "") -> None:
        table.append((name, here, because, removes))

    add("coordinates", _list_names(names))
    plain = structure.plain
    if plain.hamiltonian is not None:
        rank, n = structure.momentum_rank, structure.n
        regular = "regular" if rank == n else "singular, so that no Lagrangian exists"
        add("H_pp", f"rank {rank} of {n}", f"the second derivatives by momenta are {regular}")
    elif not plain.quadratic:
        add("mass matrix", "depends on v", "L is not quadratic in the velocities")
    elif structure.constant_mass:
        add(
            "mass matrix",
            mass,
            "no entry of M contains a coordinate",
            "dM/dq and forces that depend on v",
        )
    else:
        here = ", ".join(word for word in (mass, "depends on q") if word)
        add(
            "mass matrix",
            here + (f", except in the rows of {rows_of}" if some_rows else ""),
            "these rows of M contain no coordinate" if some_rows else "",
            "their part of dM/dq" if some_rows else "",
        )
    if not plain.definite:
        why = "kinetic energies have both signs"
        add("M", "indefinite", why)
    if structure.gyroscopic and plain.quadratic:
        add("linear in v", "yes", "L has terms a(q).v")
    if structure.forced:
        add("forces", _list_names(structure.forced), "they are declared beside L")
    if structure.system.constraints:
        add(
            "constraints",
            _list_names(list(structure.system.constraints)),
            f"phi(q) = 0; degrees of freedom: {structure.system.degrees_of_freedom}",
        )
    if structure.system.velocity_constraints:
        free = structure.system.velocity_degrees_of_freedom
        add(
            "velocity constraints",
            _list_names(list(structure.system.velocity_constraints)),
            f"A v = b; velocities that are free: {free}",
        )
    if structure.damping is not None:
        add(
            "damping",
            "f = -2 gamma p",
            "all forces are proportional to the momenta",
            "nothing by default; exploit=('all', 'conformal') uses it",
        )
    if not structure.autonomous:
        add("time", "yes", "L or a force contains t")
    if structure.separable:
        energies = "L = T(v) - V(q)" if structure.autonomous else "L = T(v) - V(t, q)"
        why = "M is constant and L has no terms a(q).v"
        if plain.hamiltonian is not None:
            energies, why = "H = T(p) + V(q)", "no second derivative mixes q and p"
        add(
            "separable",
            energies,
            f"{why}, and no force contains v" if structure.forced else why,
            ""
            if plain.constraint_names or plain.hamiltonian is not None
            else "the end of the path from Newton's unknowns",
        )
    if structure.linear:
        add(
            "linear",
            "forces linear in q",
            "second derivatives of V are constant",
            "Newton's method: a step is a product of shears",
        )
    affine = [names[i] for s in structure.subsystems if s.affine for i in s.coordinates]
    if affine:
        add(
            "affine",
            _list_names(affine),
            "equations are linear in q and v, with constant coefficients",
            "Newton's method: a step is solved with factors of the run",
        )
    if structure.cyclic:
        add(
            "cyclic",
            _list_names(structure.cyclic),
            "L and the forces do not contain them, and no force acts on them"
            if structure.forced
            else "L does not contain them",
            "them from Newton's unknowns; their momenta are constants",
        )
    if len(structure.subsystems) > 1:
        groups = (", ".join(names[i] for i in s.coordinates) for s in structure.subsystems)
        add(
            "subsystems",
            _list_names([f"({g})" for g in groups]),
            "no term of L joins them" + (", and no force" if structure.forced else ""),
            "their coupling: one small solve each",
        )
    if structure.periodic:
        add(
            "angles",
            _list_names(structure.periodic),
            "only in sines and cosines of whole multiples",
        )
    zeros = ", ".join(f"{name} {zero} of {all_}" for name, (zero, all_) in structure.zeros.items())
    add(
        "zeros",
        zeros,
        "these derivatives vanish identically",
        "their terms, and the entries that elimination would fill in",
    )
    for question in structure.undecided:
        add("undecided", question, "zero at every sample, but not proved", "nothing")
    for question in structure.nearly:
        why = "by less than 1e-12, because floats count with their exact values"
        add("nearly not", question, why, "nothing")
    return table


def as_text(structure: Any) -> str:
    """Write the table for a terminal."""
    table = rows(structure)
    width = max(len(name) for name, *_ in table) + 2
    lines = []
    for name, here, because, removes in table:
        lines.append(f"{name:<{width}}{here}")
        if because:
            removed = f"; this removes {removes}" if removes else ""
            lines += textwrap.wrap(
                f"because {because}{removed}",
                78,
                initial_indent=" " * width,
                subsequent_indent=" " * width,
            )
    return "\n".join(lines)


def as_html(structure: Any) -> str:
    """Write the table for a notebook."""
    return markup.table([HEAD, *rows(structure)])


def _list_names(names: Sequence[str]) -> str:
    """List up to six names, and the number of all if there are more."""
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown}, ... ({len(names)})"
