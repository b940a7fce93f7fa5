"""A structure as a table: what was found, why it holds, what it removes from a step."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from symsimpson.codegen.counting import Cost, cost
from symsimpson.codegen.kernels import unrolled
from symsimpson.codegen.pipeline import source
from symsimpson.discrete.equations import discretise
from symsimpson.discrete.reductions import Linear, Part, Routh
from symsimpson.display import markup
from symsimpson.mechanics.structure import Structure
from symsimpson.schemes.scheme import SIMPSON

__all__ = ["as_html", "as_text", "costs", "rows"]

#: Beyond so many coordinates operations are not counted for a report: that takes long.
COUNTED = 8
SCHEMES = ("simpson", "midpoint")
#: What is removed by a finding that the loops for large systems make no use of.
NOTHING = "nothing: loops take all coordinates together"
Row = tuple[str, str, str, str]
HEAD: Row = ("finding", "here", "because", "removes")


def rows(found: Structure) -> list[Row]:
    """List the findings: name, what holds here, the sentence that justifies it, what it removes."""
    names = [user.func.__name__ for user in found.system.coordinates]
    equations = discretise(found.system, SIMPSON)
    straight = unrolled(equations)

    def removed(what: str, kind: type[Part] | None = None) -> str:
        used = kind is None or any(isinstance(part, kind) for part in equations.parts)
        return what if straight and used else NOTHING

    mass = ", ".join(
        word for word, holds in (("constant", found.constant_mass),
                                 ("diagonal", found.diagonal_mass)) if holds
    )  # fmt: skip
    rows_of = _some(found.constant_rows)
    some_rows = bool(rows_of) and not found.constant_mass
    table: list[Row] = [("coordinates", _some(names), "", "")]
    if found.constant_mass:
        table.append(("mass matrix", mass, "no entry of M contains a coordinate",
                      "dM/dq and forces that depend on v"))  # fmt: skip
    else:
        here = ", ".join(word for word in (mass, "depends on q") if word)
        table.append(("mass matrix", here + (f", but for {rows_of}" if some_rows else ""),
                      "these rows of M contain no coordinate" if some_rows else "",
                      "their part of dM/dq" if some_rows else ""))  # fmt: skip
    if found.gyroscopic:
        table.append(("linear in v", "yes", "L has terms a(q).v", ""))
    if found.separable:
        table.append(("separable", "L = T(v) - V(q)", "M is constant and L has no terms a(q).v",
                      "the end of the path from Newton's unknowns"))  # fmt: skip
    if found.linear:
        table.append(
            (
                "linear",
                "forces linear in q",
                "second derivatives of V are constant",
                removed("Newton's method: a step is a product of shears", Linear),
            )
        )
    if found.cyclic:
        table.append(
            (
                "cyclic",
                _some(found.cyclic),
                "L does not contain them",
                removed("them from Newton's unknowns; their momenta are constants", Routh),
            )
        )
    if len(found.subsystems) > 1:
        groups = (", ".join(names[i] for i in s.coordinates) for s in found.subsystems)
        table.append(("subsystems", _some([f"({g})" for g in groups]), "no term of L joins them",
                      removed("their coupling: one small solve each")))  # fmt: skip
    if found.periodic:
        table.append(("angles", _some(found.periodic),
                      "only in sines and cosines of whole multiples", ""))  # fmt: skip
    zeros = ", ".join(f"{name} {zero} of {all_}" for name, (zero, all_) in found.zeros.items())
    table.append(("zeros", zeros, "these derivatives vanish identically",
                  "their terms, and fill in elimination"))  # fmt: skip
    for question in found.undecided:
        table.append(("undecided", question, "zero at every sample, not proved", "nothing"))
    for question in found.nearly:
        why = "by less than 1e-12: floats are taken for the numbers that they are"
        table.append(("nearly not", question, why, "nothing"))
    return table


def costs(found: Structure) -> list[tuple[str, Cost, Cost]] | None:
    """Return the costs of a step on the general path and on this one, for each scheme of the paper.

    None for systems so large that counting takes longer than a report should.
    """
    system = found.system
    if system.n > COUNTED:
        return None
    return [
        (scheme, cost(source(system, scheme, ())), cost(source(system, scheme)))
        for scheme in SCHEMES
    ]


def as_text(found: Structure) -> str:
    """Write the tables for a terminal."""
    table = rows(found)
    width = max(len(name) for name, *_ in table) + 2
    lines = []
    for name, here, because, removes in table:
        lines.append(f"{name:<{width}}{here}")
        if because:
            removed = f"; removes {removes}" if removes else ""
            lines += textwrap.wrap(
                f"because {because}{removed}", 78, initial_indent=" " * width,
                subsequent_indent=" " * width,
            )  # fmt: skip
    counted = _counted(found)
    return "\n".join([*lines, *(["", *_aligned(counted)] if counted else [])])


def as_html(found: Structure) -> str:
    """Write the tables for a notebook."""
    counted = _counted(found)
    return markup.table([HEAD, *rows(found)]) + (markup.table(counted) if counted else "")


def _counted(found: Structure) -> list[tuple[str, ...]]:
    measured = costs(found)
    if measured is None:
        return []
    head = ("a step, general > here", "unknowns", "operations an iteration", "at its end")
    return [
        head,
        *(
            (
                scheme,
                f"{before.unknowns} > {after.unknowns}",
                f"{before.iteration} > {after.iteration}",
                f"{before.closing} > {after.closing}",
            )
            for scheme, before, after in measured
        ),
    ]


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:6])
    return shown if len(names) <= 6 else f"{shown}, ... ({len(names)})"


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    return [
        "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    ]
