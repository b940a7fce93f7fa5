"""Accelerations and multipliers at states, from the twice differentiated constraints (index 1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.declare.constraints import accelerations
from symsimpson.declare.plain import ConstraintRows, Plain
from symsimpson.graph.nodes import Graph, Value
from symsimpson.graph.read import to_lines
from symsimpson.graph.rebuild import rebuild
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.contact_values import Counts, IndexOne
from symsimpson.support.literals import float_literals


class IndexOneFunction:
    """Evaluates the equations M v' = push, W v' = -curve of a system with more rows.

    ``gaps`` are further constraints of positions, and ``rows`` further velocity constraints, each
    followed by b. Both are values of ``graph``, which has plain symbols, as are ``limits``: for
    each row, its limit at its speed, the symbol ``speed``, and then the static ones.
    """

    def __init__(
        self,
        plain: Plain,
        graph: Graph | None = None,
        gaps: Sequence[Value] = (),
        rows: Sequence[tuple[Value, ...]] = (),
        limits: Sequence[Value] = (),
        speed: sp.Symbol | None = None,
    ) -> None:
        into = Graph() if graph is None else graph
        held = plain.write_constraints(into)
        every = ConstraintRows((*held.phi, *gaps), (*held.rows, *rows))
        L, *f = rebuild(plain.graph, [plain.L, *plain.f], {}, into)
        n, m = len(plain.q), len(every.phi) + len(every.rows)
        q, v = (into.numbers(x.name for x in group) for group in (plain.q, plain.v))
        (time,) = into.numbers([plain.t.name])
        terms = accelerations(into, L, every, f, (q, v, time))
        entries = [plain.entry(i, j) for i in range(n) for j in range(n)]
        mass = rebuild(plain.graph, [*entries, *plain.a], {}, into)
        symbols = plain.symbols if speed is None else (*plain.symbols, speed)
        known = {into.symbol(x.name)[1]: x for x in symbols}
        known[into.constant("Tiny")[1]] = sp.S.Zero

        def compiled(wanted: Sequence[Value], more: Sequence[sp.Symbol] = ()) -> Callable[..., Any]:
            arguments = [plain.t, *plain.q, *plain.v, *plain.parameters, *plain.u, *more]
            lines, results = float_literals(to_lines(into, wanted, known))
            return sp.lambdify(arguments, results, "numpy", cse=lambda _: (lines, results))

        slopes = [x for row in terms.rows for x in row]
        blocks = mass[: n * n], slopes, terms.push, terms.curve, terms.rates, gaps, mass[n * n :]
        self._dynamics = compiled([x for block in blocks for x in block])
        self._ends = np.cumsum([len(block) for block in blocks])[:-1]
        self._limits = [compiled([x], () if speed is None else (speed,)) for x in limits]
        self._shapes = [(n, n), (m, n), (n,), (m,), (m,), (len(gaps),), (n,)]
        self.counts = Counts(len(held.phi), len(gaps), len(held.rows), len(rows))

    def __call__(self, t: Any, q: Reals, v: Reals, values: Reals, inputs: Reals) -> IndexOne:
        """Evaluate at states of shape (..., n), with parameters and inputs of shape (..., m).

        Complex numbers give derivatives, by a small imaginary part.
        """
        kind = np.result_type(np.float64, *map(np.asarray, (t, q, v, values)))
        columns: list[Any] = [np.asarray(t, dtype=kind)]
        for x in (q, v, values, inputs):
            numbers = np.asarray(x, dtype=kind)
            columns += [numbers[..., k] for k in range(numbers.shape[-1])]
        shape = np.shape(q)[:-1]
        with np.errstate(all="ignore"):  # values that are not finite are found later
            rows = _stack(self._dynamics(*columns), shape)
            parts = [
                part.reshape(*shape, *size)
                for part, size in zip(
                    np.split(rows, self._ends, axis=-1), self._shapes, strict=True
                )
            ]
            elements = self.counts.element_rows
            speeds = np.abs(parts[4][..., elements.start : elements.stop])
            number = len(elements)
            limits = [
                limit(*columns, speeds[..., k % number])[0] for k, limit in enumerate(self._limits)
            ]
        M, W, push, curve, rates, values_of_gaps, momenta = parts
        numbers_of = _stack(limits, shape)
        return IndexOne(M, W, push, curve, rates, values_of_gaps, numbers_of, momenta)


def _stack(numbers: Sequence[Any], shape: tuple[int, ...]) -> Floats:
    """Stack numbers and arrays along a new last axis."""
    if not numbers:
        return np.zeros((*shape, 0))
    if not shape:
        return np.array(numbers) * 1.0
    return np.stack([np.broadcast_to(x, shape) for x in numbers], axis=-1) * 1.0
