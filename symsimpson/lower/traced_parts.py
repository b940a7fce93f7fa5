"""Traces of library texts for a part of a system, as if it were a system."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

from symsimpson.declare.quadratic import connected_groups
from symsimpson.discrete.reductions import Routh
from symsimpson.lower.constraint_functions import constraint_stores
from symsimpson.lower.expression import Expression
from symsimpson.lower.facts import common_sizes, equation_constants, node_tables
from symsimpson.lower.ir import Row, Store
from symsimpson.lower.lower import Lowering
from symsimpson.lower.specialise import collect_called
from symsimpson.lower.storage import Border, Storage, node_stride
from symsimpson.lower.template import JetTemplate, Point
from symsimpson.lower.terms_of_l import BLOCKS, FUNCTIONS, cyclic_values, jet_entries, position
from symsimpson.lower.trace import ExactTable, Trace
from symsimpson.text.library import kernel_sources, library_sources
from symsimpson.text.table import TABLE, Sizes
from symsimpson.text.workspace_layout import layout

#: What functions compute, as titles of sections.
TITLES = {
    "node {node}": "at_node jet forces gradient cyclic_point drift kick linear_drift linear_kick",
    "node {node}, weighted": "weigh_node accumulate",
    "residual D_k L_d": "assemble_residual",
    "Jacobian D_m D_k L_d": "assemble_entries join_equations",
    "residual and Jacobian": "constant_mass_equations",
    "node {node}: cyclic coordinates": "cyclic_node",
    "multipliers": "cyclic_bases cyclic_multipliers cyclic_matrix",
    "velocities of cyclic coordinates": "cyclic_velocities",
    "node {node}: at constant momenta": "reduce_jet",
    "compensated sums": "find_cyclic_impulse close_step close_composed path_end",
    "predictor": "cyclic_ends cyclic_checks measure_prediction predict",
    "elimination": "solve_in_pairs factor_in_order",
    "without inner control points": "condense",
    "end of the step": "move_end solve_in_order",
    "update": "update_increments",
    "increments": "straight_path",
    "momentum": "momentum",
    "energy": "kinetic_energy potential",
    "velocity": "mass factor_mass solve_mass border_mass factor_held solve_held",
    "end of the path": "find_straight_path correct_end",
    "path": "enter_stage",
    "forces": "stage_force",
    "velocities": "stage_velocity",
    "start": "path_start",
    "control point {node}": "at_point assemble_constraint",
    "stiffness": "stiffen",
    "projection": "take_momentum",
}
SECTIONS = {name: title for title, names in TITLES.items() for name in names.split()}
#: Names of values in rows: of a coordinate, at a node.
ROWS = {
    "NODE_POSITION": "{q}_{node}",
    "NODE_VELOCITY": "v_{q}_{node}",
    "NODE_TIME": "t_{node}",
    "NODE_L_VV": "M_{index}_{node}",
    "STAGE_Q": "shift_{node}",
    "ROW": "R_{block}_{q}",
    "STEP_F": "F_{q}_{block}_w",
    "STEP_P": "P_{q}_{block}_w",
    "RESIDUAL": "R_{row}",
    "START_SLOPES": "R_q_{index}",
    "END_SLOPES": "E_{index}",
    "CONDENSED": "S_{index}",
    "MOMENTUM": "p_{q}",
    "VELOCITY": "v_{q}",
    "INCREMENT": "{q}_X{next}",
    "CYCLIC_D": "D_{cyclic}",
    "CYCLIC_INVERSE": "inv_D_{cyclic}",
    "CYCLIC_P": "mu_{cyclic}",
    "CYCLIC_V": "v_{cyclic}",
    "CYCLIC_LAMBDA": "lambda_{index}",
    "MULTIPLIER": "nu_{index}",
}
#: Blocks with a row for each coordinate, and with one for each increment.
OF_COORDINATES = (
    *("POSITION", "POSITION_LOW", "MOMENTUM", "MOMENTUM_LOW", "VELOCITY", "MASS_DIAGONAL"),
    *("OWN_CORRECTION", "OWN_INCREMENT"),
)
OF_INCREMENTS = ("INCREMENT", "PREDICTED")
#: Rows that only change in lanes that are active.
MOVING = (*OF_COORDINATES[:4], *OF_INCREMENTS, "MASS_DIAGONAL")
#: Outputs of the jet that do not depend on velocities.
RESTING = frozenset(["a", "M", "V"])


class TracedPart:
    """The trace of a step of some coordinates.

    The part has a workspace of its own, as if there were no other coordinates. Rows of base symbols
    of the system are set at the beginning. Texts set all other rows.
    """

    #: Names of values in rows, by blocks.
    patterns: Mapping[str, str] = ROWS

    def __init__(
        self,
        low: Lowering,
        coordinates: Sequence[int],
        functions: Iterable[str],
        facts: Mapping[str, object],
        tables: Mapping[str, object],
        blocks: Mapping[str, Any] | None = None,
        reduction: Routh | Border | None = None,
    ) -> None:
        self.low, self.coordinates = low, (*coordinates,)
        routh = reduction if isinstance(reduction, Routh) else None
        self.held = held = reduction if isinstance(reduction, Border) else None
        self._n, eqs = len(self.coordinates), low.equations
        scheme, unknowns = eqs.scheme, eqs.unknowns
        storage = Storage.dense(self._n)
        self._routh, self._cyclic = routh, routh.cyclic if routh is not None else ()
        kinds = ("assembled", "constant_mass", "dragged", "timed", "damped", "decaying", "retimed")
        facts = {**facts, "PAIRED": self._pairs is not None}
        size = scheme.degree * self._n + unknowns.others_size
        large: dict[str, Any] = {  # large enough for all texts
            "n": self._n,
            "unknowns": size,
            "entries": self._n**2,
            "bordered": held.storage.node_size if held else 0,
            "jacobian": 2 * size**2,
            "pivots": self._n,
        }
        large |= common_sizes(low, held, routh) | dict.fromkeys(kinds, True)
        large["canonical"] = low.equations.plain.hamiltonian is not None
        sizes = Sizes(**{**large, **(blocks or {})})
        self._first, _ = layout(sizes)
        self._count = {x.name: int(x.size(sizes)) for x in TABLE}
        self._blocks = [(self._first[name], name) for name, count in self._count.items() if count]
        self._base: dict[int, Expression] = {}
        numbers: dict[str, Any] = {
            **eqs.tables,
            **node_tables(scheme),
            **storage.node_constants(),
            **equation_constants(storage, scheme.degree, held),
            "MASS_BAND": max(self._n - 1, 0),
            **self._mass_tables(),
            "DIMENSION": self._n,
            "DEGREE": scheme.degree,
            "NODES": scheme.stages,
            "UNKNOWNS": size,
            "INPUTS": len(low.names.inputs),
            "INPUT_STRIDE": node_stride(eqs),
            "ROW_ORDER": eqs.rows,
            "COLUMN_ORDER": eqs.columns,
            **tables,
        }
        names = {
            name: ExactTable(value) if isinstance(value, tuple) else value
            for name, value in numbers.items()
        }
        evaluations: dict[str, Callable[..., None]] = {
            name: partial(self._evaluate, parts) for name, (_, parts) in FUNCTIONS.items()
        }
        evaluations["cyclic_mass"] = self._evaluate_cyclic
        if held is not None:
            names_ = ("constrain", "constraint_slopes", "hold_velocities", "rates")
            evaluations |= {name: partial(self._constrain, name) for name in names_}
        texts = collect_called(functions, {**library_sources(), **kernel_sources()}, facts).values()
        known = self._first | names | evaluations
        self.trace = Trace(low.graph, texts, known, self._row_name, self._spell_index, SECTIONS)

    @cached_property
    def _pairs(self) -> tuple[tuple[int, ...], ...] | None:
        """The places of two coordinates that M couples with no other; None if M has other blocks.

        If M is definite, only two coordinates are a pair, because L D L^T suits all others.
        """
        plain, place = self.low.equations.plain, {a: s for s, a in enumerate(self.coordinates)}
        if plain.definite:
            return ((0, 1),) if self._n == 2 else None
        inside = [(place[i], place[j]) for i, j in plain.M if i in place and j in place]
        blocks = connected_groups(self._n, inside)
        return tuple(tuple(block) for block in blocks if len(block) == 2)

    def _mass_tables(self) -> dict[str, Any]:
        """Return the tables of pairs and of single coordinates for solutions with M."""
        pairs = self._pairs or ()
        paired = {s for pair in pairs for s in pair}
        small = {"SINGULAR": Fraction(1, 2**40)}
        return {
            **small,
            "PAIRS": pairs,
            "ALONE": tuple(s for s in range(self._n) if s not in paired),
        }

    # -- rows

    def begin(self) -> None:
        """Clear all rows, then set the rows of base symbols of the system."""
        self.trace.rows.values = {}
        for node in range(self.low.equations.scheme.stages if self.low.names.inputs else 0):
            self.low.inputs(node)
        for symbol, row in self.low.rows.items():
            place = self._place(row)
            if place is not None:
                self.trace.rows.values[place] = symbol
        self._base = dict(self.trace.rows.values)
        if "GROWTH" in self._first and self.low.equations.plain.rate is not None:
            self.set_rows("GROWTH", self.low.growth_factors())

    def _place(self, row: Row) -> int | None:
        """Return the row of the part for a row of the system; None if the part has none."""
        index, name = row.index, row.block
        if name not in self._first or not isinstance(index, int):
            return None
        if name in (*OF_COORDINATES, *OF_INCREMENTS):
            block, a = divmod(index, self.low.n)
            if block < self.low.equations.scheme.degree:
                if a not in self.coordinates:
                    return None
                index = block * self._n + self.coordinates.index(a)
        elif name not in ("INPUT", "PARAMETER", "PIVOT_SCALE"):
            return None
        return self._first[name] + index

    def run(self, function: str, *arguments: Expression | int) -> None:
        """Execute a text with these arguments between the workspace and the lane."""
        self.trace.run(function, *arguments, 0)

    def run_step(self, function: str) -> None:
        """Execute a text of a step, which takes h and t."""
        self.run(function, self.low.h, self.low.t)

    def name_rows(
        self, block: str, count: int, hints: Sequence[str] = (), section: str = ""
    ) -> list[Expression]:
        """Return the current values of the first rows of a block, with names."""
        names = hints or [self.name_of(block, k) for k in range(count)]
        define, section = self.low.graph.define, section or self.trace.section
        return [define(name, self.row(block, k), section) for k, name in enumerate(names)]

    def row(self, block: str, index: int = 0) -> Expression:
        """Return the current value of a row, without a name."""
        return self.low.graph.of(self.trace.rows.raw(self._first[block] + index))

    def has(self, block: str) -> bool:
        """Return whether a text has set the first row of a block."""
        return self._first.get(block, -1) in self.trace.rows.values

    def set_row(self, block: str, index: int, value: Expression) -> None:
        """Set a row to a value."""
        self.trace.rows.values[self._first[block] + index] = value

    def copy_rows(self, other: TracedPart, blocks: Iterable[str]) -> None:
        """Copy rows of the coordinates that another part has, too."""
        for block in blocks:
            for s, a in enumerate(other.coordinates):
                if a in self.coordinates:
                    self.set_row(block, self.coordinates.index(a), other.row(block, s))

    def mass_pivots(self) -> list[Expression]:
        """Return the pivots of M with names, or the determinants of blocks of an indefinite M."""
        pivots = self.diagonal("NODE_L_VV", self._n)
        first = {i for i, _ in self._pairs or ()} if not self.low.equations.plain.definite else ()
        return [pivot for i, pivot in enumerate(pivots) if i not in first]

    def diagonal(self, block: str, count: int) -> list[Expression]:
        """Return the diagonal of a matrix, with names."""
        define, section = self.low.graph.define, self.trace.section
        return [define("pivot", self.row(block, i * (count + 1)), section) for i in range(count)]

    def restore_momenta(self, unmoved: Any) -> None:
        """Restore the rows of momenta on which nothing acts."""
        for s, a in enumerate(self.coordinates):
            if self.row("RESIDUAL", s) == (unmoved[a] if unmoved else 0):
                for block in ("MOMENTUM", "MOMENTUM_LOW"):
                    self.set_row(block, s, self._base[self._first[block] + s])

    def map_symbols(self, blocks: Iterable[str]) -> dict[Expression, Expression]:
        """Map symbols of the system to the current values of their rows."""
        rows = (self._first[block] + s for block in blocks for s in range(self._n))
        return {self._base[row]: self.low.graph.of(self.trace.rows.raw(row)) for row in rows}

    def stores(
        self,
        blocks: Iterable[str],
        suffix: str,
        section: str,
        unknowns: Iterable[tuple[int, int]] | None = None,
    ) -> list[Store]:
        """Return stores of the rows of blocks that have changed; of increments, of some of them."""
        low, values, stores = self.low, self.trace.rows.values, []
        place = low.equations.unknowns.place
        wanted = None if unknowns is None else {place(m, a) for m, a in unknowns}
        for block in blocks:
            first = self._first.get(block, 0)
            for index in range(self._count[block]):
                row = self._system_row(block, index)
                old, new = self._base.get(first + index), values.get(first + index)
                unwanted = block in OF_INCREMENTS and wanted is not None and row.index not in wanted
                if new is None or unwanted or (old is not None and old == new):
                    continue
                name = self.name_of(block, index) + suffix
                value = low.graph.define(name, low.graph.of(new), section)
                stores.append(Store(row, value, moving=block in MOVING))
        return stores

    def _system_row(self, block: str, index: int) -> Row:
        """Return the row of the system for a row of the part."""
        k, s = divmod(index, self._n)
        if block in OF_INCREMENTS and k < self.low.equations.scheme.degree:
            return Row(block, k * self.low.n + self.coordinates[s])
        return Row(block, self.coordinates[s] if block in OF_COORDINATES else index)

    def _row_name(self, row: int) -> str:
        """Name the value of a row."""
        first, block = self._blocks[bisect(self._blocks, (row, "~")) - 1]
        return self.name_of(block, row - first)

    def name_of(self, block: str, index: int) -> str:
        """Name the value of a row of a block."""
        k, s = divmod(index, self._n)
        eqs = self.low.equations
        if block == "JACOBIAN":
            solved = self._n - len(self._cyclic)
            if self.held is not None:  # the matrix of the nodes follows the matrix of all unknowns
                whole = self.held.storage.unknowns(eqs.scheme.degree)
                row, column = divmod(index, whole)
                if row < whole:
                    return f"A_{row}_{column}"
                index -= whole**2
            row, column = divmod(index, solved * eqs.scheme.degree)
            first = self._unknown(row, eqs.rows, solved)
            return f"J_{first}_{self._unknown(column, eqs.columns, solved)}"
        pattern = self.patterns.get(block, f"{block.lower()}_{index}")
        equation = self._unknown(index, eqs.rows, self._n)
        here = self.trace.place or "start"
        names: dict[str, object] = {
            "q": self._spell_index("s", s),
            "block": k,
            "next": k + 1,
            "row": equation,
            "node": here,
        }
        if self._cyclic:
            i, r = divmod(index, len(self._cyclic))
            names["cyclic"] = f"{self.low.names.coordinates[self._cyclic[r]]}_{i}"
        return pattern.format(index=index, **names)

    def _unknown(self, index: int, points: Sequence[int], count: int) -> str:
        """Name a row or a column of equations: a control point, and one of some coordinates."""
        k, s = divmod(index, count)
        return f"{points[k]}_{self._spell_index('s', s)}" if k < len(points) else str(index)

    def _spell_index(self, index: str, value: int) -> str:
        """Name a loop index of a text: a coordinate, or a number."""
        if index in ("s", "a", "b") and value < self._n:
            return self.low.names.coordinates[self.coordinates[value]]
        return str(value)

    # -- the system at a point

    def _evaluate(self, parts: Sequence[str], W: Any, lane: int) -> None:
        """Set rows to entries of the jet at the point that the rows of the node describe."""
        low, n = self.low, self._n
        moving = not RESTING.issuperset(parts) or not low.equations.plain.quadratic
        point = self.point(moving=moving)
        section, place = self.trace.section, self.coordinates
        rows = self.trace.rows.values
        dragged = low.equations.plain.dragged
        for what, index, (entry, *at) in jet_entries(parts, n, dragged=dragged):
            row = self._first[BLOCKS[what]] + position(index, n)
            where = (place[i] for i in at)
            value = partial(low.template.entry, point, section, entry, *where)
            rows[row] = rows[row] + value() if what == "V" else value

    def _evaluate_cyclic(self, W: Any, node: int, lane: int) -> None:
        """Set rows to M of cyclic coordinates at the point, and to their momenta at v_y = 0."""
        assert self._routh is not None
        size, section = len(self._cyclic), self.trace.section
        point, template = self.point(moving=True), self.low.template
        for block, index, value in cyclic_values(self.low, template, self._routh, point, section):
            self.set_row(block, position((node, *index), size), value)

    def _constrain(self, function: str, W: Any, lane: int) -> None:
        """Set rows to constraints at the point that the rows of the node describe."""
        low, held = self.low, self.held
        assert held is not None
        rows = self.trace.rows.values
        if function.startswith("constrain"):
            cleared = range(held.storage.node_size)
            rows |= {self._first["CONSTRAINT_QQ"] + entry: 0 for entry in cleared}
        point = self.point(moving=True, template=low.constraint_jet)
        stores = constraint_stores(low, held, range(self._n), point, self.trace.section)
        for store in stores[function]:
            rows[self._first[store.row.block] + int(store.row.index)] = store.value

    def point(self, *, moving: bool, template: JetTemplate | None = None) -> Point:
        """Return the point that the rows of a node describe."""
        low, n = self.low, range(self._n)
        q, v = ([low.nothing] * low.n for _ in range(2))
        count = range(self.held.count if self.held and template else 0)
        # a text that does not go to a node does not tell its time, nor inputs there
        blocks = {"NODE_POSITION": n, "NODE_VELOCITY": n if moving else (), "NODE_TIME": range(1)}
        blocks |= {"NODE_INPUT": range(len(low.names.inputs)), "MULTIPLIER": count}
        here = {name: self._values_of(name, rows) for name, rows in blocks.items()}
        for values, name in ((q, "NODE_POSITION"), (v, "NODE_VELOCITY")):
            for a, value in zip(self.coordinates, here[name], strict=False):
                values[a] = value
        (t,) = here["NODE_TIME"] or (None,)
        moves, place = tuple(v) if moving else None, self.trace.place or "start"
        point = Point(place, tuple(q), moves, t, here["NODE_INPUT"], here["MULTIPLIER"])
        return (template or low.template).at(point)

    def set_rows(self, block: str, values: Iterable[Any]) -> None:
        """Set the first rows of a block to values, or to functions that are called when read."""
        for k, value in enumerate(values):
            self.trace.rows.values[self._first[block] + k] = value

    def _values_of(self, block: str, places: Iterable[int]) -> tuple[Expression, ...]:
        """Return the values of those rows of a block that are set."""
        W, first = self.trace.rows, self._first.get(block, 0)
        rows = [first + k for k in places if first + k in W.values]
        return tuple(self.low.graph.of(W[row, 0]) for row in rows)
