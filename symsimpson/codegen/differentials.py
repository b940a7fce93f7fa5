"""Kernels that differentiate a step: nodes, with the quantities that change there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any, Self

from symsimpson.codegen.expression import Expression
from symsimpson.codegen.ir import Call, Function, Row, Statement, Store
from symsimpson.codegen.levels import Level
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.template import Point

__all__ = ["GO_TO_NODE", "Differentials", "cost_of_time", "few_columns", "point_of_node", "sizes"]

#: With more products than this, variations are solved for one by one.
MOST_TERMS = 4000

_HERE = ("W", "node", "lane")
#: What says where in the step a node is.
GO_TO_NODE = Call("go_to_node", ("W", "h", "node", "lane"))
#: Derivatives by parameters, and where they stand.
_BLOCKS = (("NODE_F_A", "F_a"), ("NODE_P_A", "P_a"))


@dataclass(frozen=True)
class Differentials:
    """Makes the parts of such kernels."""

    low: Lowering
    loops: LoopKernels
    places: tuple[int, ...]  #: Coordinates in the order in which they are stored.
    following: bool  #: Whether increments of some coordinates follow from those of the others.
    in_order: bool  #: Whether the matrix of all unknowns needs no exchange of rows.

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that are varied."""
        return self.low.varied

    @property
    def costly(self) -> bool:
        """Whether there is a running cost."""
        return self.low.equations.cost is not None

    def if_varied(self, *statements: Statement) -> tuple[Statement, ...]:
        """Return statements where parameters are varied."""
        return statements if self.varied else ()

    def if_costly(self, *statements: Statement) -> tuple[Statement, ...]:
        """Return statements where there is a running cost."""
        return statements if self.costly else ()

    def path_known(self) -> tuple[Statement, ...]:
        """Find the increments that follow from the others, which are those of the step."""
        return (*self.loops.all_rows(), Call("solve_following")) if self.following else ()

    def parameter_slopes(self) -> tuple[Statement, ...]:
        """Find and keep the derivatives of F and P by parameters at a node, with its weight."""
        grown = (Call("grow_slopes", _HERE),) if self.loops.damped else ()
        return self.if_varied(
            *self.at(GO_TO_NODE),
            Call("parameter_slopes"),
            *grown,
            Call("keep_parameter_slopes", _HERE),
        )

    def at(self, place: Statement) -> tuple[Statement, ...]:
        """Say where in the step a point is, if it is differentiated by its size."""
        return (place,) if self.low.sized else ()

    def at_state(self, place: int) -> tuple[Statement, ...]:
        """Find derivatives by parameters at the start of a step, or at its end."""
        state = Call("go_to_state", ("W", "h", str(place), "lane"))
        return self.if_varied(*self.at(state), Call("parameter_slopes"))

    def timed(self) -> Self:
        """Return the same with times at nodes, if the running cost asks for them."""
        if not cost_of_time(self.low):
            return self
        return replace(self, loops=replace(self.loops, autonomous=False))

    def tables(self) -> dict[str, object]:
        """Return where the derivatives of F and P by parameters stand that are not zero.

        Those of a parameter stand one after the other; their coordinates by place.
        """
        tables: dict[str, object] = {"VARIED": len(self.varied)}
        for block, what in _BLOCKS if self.varied else ():
            rows, name = _not_zero(self.low, self.places, what), block.removeprefix("NODE_")
            first = accumulate(
                sum(parameter == varied for parameter, _ in rows) for varied in self.varied
            )
            tables |= {f"{name}_FROM": (0, *first), f"{name}_PLACE": (*(s for _, s in rows), 0)}
        return tables

    def functions(self) -> list[Function]:
        """Return what is evaluated at a node."""
        functions = [_slopes(self.low, self.places)] if self.varied else []
        if self.varied and self.loops.held:
            functions.append(_constraint_slopes(self.low, self.places))
            functions += _rate_slopes(self.low)
        return [*functions, _cost(self.low, self.places)] if self.costly else functions


def cost_of_time(low: Lowering) -> bool:
    """Return whether a running cost depends on the time."""
    cost, plain = low.equations.cost, low.equations.plain
    return cost is not None and cost.depends(plain.t)


def few_columns(low: Lowering) -> bool:
    """Return whether the derivative of a step is worth to be computed as a whole."""
    n, size, stages = low.n, low.equations.unknowns.size, low.equations.scheme.stages
    columns = 2 * n + len(low.varied)
    return columns * (size**2 + 2 * stages * n**2) + size**3 / 3 <= MOST_TERMS


def sizes(low: Lowering, *, by_columns: bool) -> dict[str, Any]:
    """Return numbers that the sizes of what derivatives of a step have follow from."""
    if low.equations.varied is None:
        return {}
    slopes = [1 + len(_not_zero(low, range(low.n), what)) for _, what in _BLOCKS]
    return {
        **dict(zip(("f_slopes", "p_slopes"), slopes, strict=True)),
        "differentiated": True,
        "by_columns": by_columns,
        "costly": low.equations.cost is not None,
        "second": low.equations.second,
        "sized": low.sized,
        "curvatures": _count(low, "node"),
        "point_curvatures": _count(low, "point"),
        "varied": len(low.varied),
    }


def _count(low: Lowering, what: str) -> int:
    """Count the second derivatives that do not vanish."""
    return len(low.curvatures.places(what)) if low.equations.second else 0


def _not_zero(low: Lowering, places: Sequence[int], what: str) -> list[tuple[str, int]]:
    """List the derivatives that do not vanish: by which parameter, and at which place."""
    return [
        (name, s)
        for name in low.varied
        for s, a in enumerate(places)
        if not low.slopes.vanishes(what, a, name)
    ]


def point_of_node(low: Lowering) -> Point:
    """Return the node at hand, as loops have it."""
    return Point("i", low.node_q, low.node_v, low.node_t, low.node_u, step=low.step)


def _slopes(low: Lowering, places: tuple[int, ...]) -> Function:
    """Write the derivatives of F and P by the parameters that are varied, at a node."""
    stores = [
        Store(Row(block, k), low.slopes.entry(point_of_node(low), "slopes", what, places[s], name))
        for block, what in _BLOCKS
        for k, (name, s) in enumerate(_not_zero(low, places, what))
    ]
    doc = "Derivatives of F and P by the parameters that are varied, at a node."
    return Function("parameter_slopes", doc, low.statements(stores, (Level.ITERATION,)))


def _constraint_slopes(low: Lowering, places: tuple[int, ...]) -> Function:
    """Write the derivatives of phi and Phi^T lambda by parameters, at a control point."""
    point = replace(point_of_node(low), suffix="c", multipliers=low.multipliers)
    count, stores = len(low.multipliers), []
    for j, name in enumerate(low.varied):
        for c in range(count):
            value = low.slopes.entry(point, "slopes", "phi_a", c, name)
            stores.append(Store(Row("CONSTRAINT_A", j * count + c), value))
        for s, a in enumerate(places):
            value = low.slopes.entry(point, "slopes", "pull_a", a, name)
            stores.append(Store(Row("CONSTRAINT_QA", j * low.n + s), value))
    doc = "Derivatives of phi and of Phi^T lambda by parameters, at a control point."
    return Function("constraint_parameter_slopes", doc, low.statements(stores, (Level.ITERATION,)))


def _rate_slopes(low: Lowering) -> list[Function]:
    """Write the derivatives of A v - b and of b by parameters, at a point."""
    plain, point = low.equations.plain, replace(point_of_node(low), suffix="c")
    rolling = range(len(plain.constraints), len(plain.held))
    wanted = {"rate": "A v - b"} if rolling else {}
    wanted |= {"carried": "b"} if plain.carried else {}
    functions = []
    for name, what in wanted.items():
        key = "rate_a" if name == "rate" else "b_a"
        stores = [
            Store(
                Row("RATE_A", j * len(rolling) + k),
                low.slopes.entry(point, "slopes", key, c, parameter),
            )
            for j, parameter in enumerate(low.varied)
            for k, c in enumerate(rolling)
        ]
        doc = f"Derivatives of {what} by the parameters that are varied, at a point."
        lines = low.statements(stores, (Level.ITERATION,))
        functions.append(Function(f"{name}_parameter_slopes", doc, lines))
    return functions


def _cost(low: Lowering, places: tuple[int, ...]) -> Function:
    """Write a running cost and its derivatives, at a node."""
    keys: list[tuple[str, *tuple[int | str, ...]]] = [("g",)]
    keys += [(what, a) for what in ("g_q", "g_v") for a in places]
    keys += [("g_a", name) for name in low.varied]
    values: list[Expression] = [low.cost.entry(point_of_node(low), "cost", *key) for key in keys]
    stores = [Store(Row("NODE_COST", k), value) for k, value in enumerate(values)]
    doc = "The running cost and its derivatives, at a node."
    return Function("cost_slopes", doc, low.statements(stores, (Level.ITERATION,)))
