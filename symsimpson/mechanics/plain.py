"""A system in symbols of our own, so that nothing derived depends on what a user calls things."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, TypeAlias

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.physics.mechanics import dynamicsymbols

__all__ = ["Plain", "Symbols", "unfrozen"]

Matrix: TypeAlias = sp.ImmutableDenseMatrix


@dataclass(frozen=True)
class Plain:
    """A system in plain symbols: L = v.M(q).v/2 + a(q).v - V(q).

    ``q``, ``v``, ``p`` and ``parameters`` are real symbols with names of our own, so that nothing
    that is derived from them depends on what a user calls things.
    """

    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Symbol, ...]
    p: tuple[sp.Symbol, ...]
    parameters: tuple[sp.Symbol, ...]
    mass: Matrix
    gyroscopic: tuple[sp.Expr, ...]
    potential: sp.Expr
    invariants: Mapping[str, sp.Expr]

    def __reduce__(self) -> tuple[Any, ...]:
        return unfrozen(self)


def unfrozen(value: Any) -> tuple[Any, ...]:
    """Tell pickle to call the constructor again; what is read-only is handed over as a dict."""
    given = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    plain = {k: dict(x) if isinstance(x, Mapping) else x for k, x in given.items()}
    kind: Any = type(value)
    return partial(kind, **plain), ()


class Symbols:
    """The user's symbols and the plain ones that stand for them, both ways."""

    def __init__(
        self, coordinates: Sequence[AppliedUndef], parameters: Mapping[sp.Symbol, float]
    ) -> None:
        t = dynamicsymbols._t
        n = len(coordinates)
        self.q = tuple(sp.Symbol(f"q_{i}", real=True) for i in range(n))
        self.v = tuple(sp.Symbol(f"v_{i}", real=True) for i in range(n))
        self.p = tuple(sp.Symbol(f"p_{i}", real=True) for i in range(n))
        self.a = tuple(_real(f"a_{i}", a) for i, a in enumerate(parameters))
        self.replace: dict[sp.Basic, sp.Symbol] = {
            **{q.diff(t): v for q, v in zip(coordinates, self.v, strict=True)},
            **dict(zip(coordinates, self.q, strict=True)),
            **dict(zip(parameters, self.a, strict=True)),
        }
        self.back: dict[sp.Basic, sp.Basic] = {own: user for user, own in self.replace.items()}

    def restore(self, plain: sp.Expr) -> sp.Expr:
        """Write a plain expression in the user's symbols."""
        return plain.xreplace(self.back)


def _real(name: str, user: sp.Symbol) -> sp.Symbol:
    """Give a real symbol with the sign that the user's symbol is assumed to have."""
    signs = ("positive", "negative", "nonnegative", "nonpositive", "nonzero")
    assumed = {sign: True for sign in signs if getattr(user, f"is_{sign}")}
    return sp.Symbol(name, real=True, **assumed)
