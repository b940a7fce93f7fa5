"""The declaration of a system, as all that reads it takes it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.graph.read import tree_size
from symsimpson.mechanics.plain import Plain, Symbols

__all__ = ["LARGE", "Declared"]

Matrix: TypeAlias = sp.ImmutableDenseMatrix
#: Parts of a Lagrangian with more nodes than this, as trees, are left as they are written.
LARGE = 2000


class Declared:
    """Parts of a system as a user declared them; :class:`MechanicalSystem` describes them."""

    name: str
    coordinates: tuple[AppliedUndef, ...]
    kinetic: sp.Expr
    potential: sp.Expr
    gyroscopic: sp.Expr
    parameters: Mapping[sp.Symbol, float]
    positions: Mapping[str, Any] | None
    invariants: Mapping[str, sp.Expr] | None
    forces: Mapping[Any, Any] | None
    dissipation: sp.Expr | None
    inputs: tuple[sp.Expr, ...]
    constraints: Mapping[str, sp.Expr]
    velocity_constraints: Mapping[str, sp.Expr]
    units: Mapping[Any, str]
    mass_checked: ClassVar[bool]
    plain: Plain

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @property
    def lagrangian(self) -> sp.Expr:
        """L = T + a.v - V in the user's own symbols."""
        return self.kinetic + self.gyroscopic - self.potential

    @cached_property
    def mass_matrix(self) -> Matrix:
        """M(q), n by n, in the user's own symbols: the Hessian of T in the velocities."""
        back = Symbols(self.coordinates, self.parameters).back
        return Matrix(self.plain.mass.xreplace(dict(back)))

    @property
    def too_large_for_sympy(self) -> bool:
        """Whether T and V together exceed LARGE nodes: they are left out of SymPy's output."""
        plain = self.plain
        return sum(tree_size(plain.graph, value) for value in (plain.T, plain.V)) > LARGE
