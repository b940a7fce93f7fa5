"""What a system has and lacks, found by exact algebra."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import sympy as sp

if TYPE_CHECKING:
    from symsimpson.mechanics.system import MechanicalSystem

__all__ = ["Structure", "analyse"]


@dataclass(frozen=True)
class Structure:
    """Findings about a system; each holds for every value of q and of the parameters.

    Attributes
    ----------
    n : int
        Number of coordinates.
    constant_mass : bool
        M does not depend on q.
    diagonal_mass : bool
        M has no entries off its diagonal.
    gyroscopic : bool
        L has terms linear in the velocities.
    cyclic : tuple of str
        Coordinates that L does not depend on: their momenta are constant.
    zeros : mapping from str to (int, int)
        For L_q, L_qq, L_qv and L_vv, the entries that vanish identically and all entries.
    """

    n: int
    constant_mass: bool
    diagonal_mass: bool
    gyroscopic: bool
    cyclic: tuple[str, ...]
    zeros: dict[str, tuple[int, int]]

    def rows(self) -> list[tuple[str, str]]:
        """List the findings as pairs of name and text."""
        mass = ("constant" if self.constant_mass else "depends on q") + (
            ", diagonal" if self.diagonal_mass else ""
        )
        skipped = ", ".join(f"{name} {zero} of {all_}" for name, (zero, all_) in self.zeros.items())
        return [
            ("coordinates", str(self.n)),
            ("mass matrix", mass),
            ("terms linear in v", "yes" if self.gyroscopic else "none"),
            ("cyclic coordinates", ", ".join(self.cyclic) or "none"),
            ("zeros never computed", skipped),
        ]

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in rows)

    def _repr_html_(self) -> str:
        cells = "".join(f"<tr><th>{name}</th><td>{text}</td></tr>" for name, text in self.rows())
        return f"<table>{cells}</table>"


def analyse(system: MechanicalSystem) -> Structure:
    """Find out what a system has and lacks.

    A finding is made only where SymPy's differentiation gives an exact zero.
    """
    from symsimpson.discrete.jet import derive_jet

    plain = system.plain
    jet = derive_jet(plain)
    lagrangian = jet.lagrangian
    zeros = {
        name: (sum(entry == 0 for entry in entries), len(entries))
        for name, entries in {
            "L_q": list(jet.L_q),
            "L_qq": list(jet.L_qq),
            "L_qv": list(jet.L_qv),
            "L_vv": list(plain.mass),
        }.items()
    }
    return Structure(
        n=system.n,
        constant_mass=plain.mass.free_symbols.isdisjoint(plain.q),
        diagonal_mass=all(
            sp.expand(plain.mass[i, j]) == 0 for i in range(system.n) for j in range(i)
        ),
        gyroscopic=any(a != 0 for a in plain.gyroscopic),
        cyclic=tuple(
            user.func.__name__
            for user, q in zip(system.coordinates, plain.q, strict=True)
            if q not in lagrangian.free_symbols
        ),
        zeros=zeros,
    )
