"""The numbers of a scheme as expressions of a module."""

from __future__ import annotations

from typing import Any

from symsimpson.codegen.expression import Expression, Expressions
from symsimpson.schemes.scheme import Scheme

__all__ = ["SchemeNumbers"]

#: What belongs to the quadrature of a scheme.
_OF_QUADRATURE = ("nodes", "weights")


class SchemeNumbers:
    """Tables of a scheme and of its quadrature, under their own names."""

    A: tuple[tuple[Expression, ...], ...]
    B: tuple[tuple[Expression, ...], ...]
    stiffness: tuple[tuple[Expression, ...], ...]
    extrapolation: tuple[tuple[Expression, ...], ...]
    nodes: tuple[Expression, ...]
    weights: tuple[Expression, ...]
    points: tuple[Expression, ...]
    end_slope: tuple[Expression, ...]
    correction: tuple[Expression, ...]

    def __init__(self, scheme: Scheme, graph: Expressions) -> None:
        self._scheme, self._graph = scheme, graph

    def __getattr__(self, name: str) -> Any:
        if name not in type(self).__annotations__:
            raise AttributeError(name)
        owner = self._scheme.quadrature if name in _OF_QUADRATURE else self._scheme
        self.__dict__[name] = self._read(getattr(owner, name))
        return self.__dict__[name]

    def _read(self, table: Any) -> Any:
        if isinstance(table, tuple):
            return tuple(map(self._read, table))
        return self._graph.read(table)
