"""The header of a generated module: what it states of itself, read without executing it."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import StaleKernelError
from symsimpson.module.definitions import syntax
from symsimpson.module.interface import (
    ADJACENT,
    BLOCKS,
    INTERFACE,
    KEPT,
    OPTIONAL,
    PIVOTED,
    RENEWAL,
    RENEWED,
    TOLD,
)

__all__ = [
    "SIGNED",
    "Header",
    "digest",
    "equations_of",
    "held_equations_of",
    "read_header",
    "slopes_of",
]

#: The line above a module that holds the digest of what follows.
SIGNED = re.compile(r"^# sha256 of what follows: ([0-9a-f]{64})\n", re.MULTILINE)


@dataclass(frozen=True)
class Header:
    """The statements of a generated module about itself, read without executing it."""

    system: str
    scheme: str
    digest: str
    order: int
    degree: int
    newton_unknowns: int
    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
    defaults: tuple[float, ...]
    signs: tuple[str, ...]
    invariants: tuple[str, ...]
    real_everywhere: bool
    rows: int
    row_order: tuple[int, ...]
    column_order: tuple[int, ...]
    coordinate_order: tuple[int, ...]
    forces: tuple[str, ...]
    autonomous: bool
    inputs: tuple[str, ...]
    input_places: tuple[str, ...]
    conformal: bool
    constraints: tuple[str, ...]
    held_places: tuple[int, ...]
    varied_by: tuple[str, ...] | None
    retimed: bool
    layout: Mapping[str, int]
    functions: tuple[str, ...]

    @cached_property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    @cached_property
    def from_start(self) -> frozenset[str]:
        """Names of parameters that follow from the start of a run: E0 and the rate there."""
        return frozenset(self.parameters[-2:] if self.retimed else ())

    @property
    def nodes(self) -> int:
        """Number of nodes of a step."""
        return self.layout["NODES"]

    @property
    def conservative(self) -> bool:
        """Whether the energy is constant."""
        return self.autonomous and not self.forces

    @property
    def powers(self) -> int:
        """Number of values that change the energy: the powers of forces, and dL/dt behind them."""
        return len(self.forces) + (not self.autonomous)

    @cached_property
    def by_stages(self) -> bool:
        """Whether steps are iterated by velocities and forces at the nodes, which are lanes."""
        return "iterate" in self.functions

    @property
    def fast_sines(self) -> bool:
        """Whether kernels use the fast sine and cosine, which have no value for huge angles."""
        return "sincos" in self.functions

    @property
    def unrolled(self) -> bool:
        """Whether Newton's method is written out, without loops and pivots."""
        return PIVOTED in self.functions

    def room_for_tangents(self, count: int) -> int:
        """Return how many rows of the workspace so many variations of the state need."""
        return count * (3 * self.n + self.layout["UNKNOWNS"])

    def room_for_growth(self, count: int) -> tuple[int, int]:
        """Return how many rows say how so many variations grow; how many are needed in all."""
        rows = 2 * count + 2
        return rows, self.room_for_tangents(count) + rows + 2 + 2 * count**2

    @cached_property
    def told(self) -> NDArray[np.int64]:
        """The numbers of the layout that the driver must know, in its order."""
        more = {
            "STATE_END": self.layout["INCREMENT"] + self.layout["UNKNOWNS"],
            "DIMENSION": self.n,
            "MEASURED": self.degree * self.n,
            "ROWS": self.rows,
            "STEPS_A_CALL": 1 << 62 if self.autonomous and not self.inputs else 1,
        }
        none = {
            "INPUT": 0,
            "INPUT_STRIDE": 0,
            "TANGENT": self.rows,
            "KEPT": self.rows,
            "RENEWED": 0,
            "RENEWAL": 1,
        }
        if self.retimed:  # the time is stored beside states
            more["KEPT"] = self.layout["TIME"]
        return np.array([{**none, **self.layout, **more}[name] for name in TOLD], dtype=np.int64)

    def told_to_renew(self, count: int, every: int) -> NDArray[np.int64]:
        """Return the same for runs that make so many variations orthonormal after so many steps.

        What is stored beside their states is how these grow and stand to one another.
        """
        told = self.told.copy()
        told[KEPT] = self.rows + self.room_for_tangents(count)
        told[RENEWED], told[RENEWAL] = count, every
        return told


def equations_of(header: Header, run: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Read residual (d, n) and Jacobian (d, n, d, n) that the equations left in a workspace.

    Rows are those of the module; columns are brought into the order X_1..X_d.
    """
    at, n, d = header.layout, header.n, header.degree
    place = np.argsort(header.coordinate_order)
    unknown = (
        np.arange(d)[:, None] * at["EQUATION_ROW_STEP"] + place * at["EQUATION_PLACE_STEP"]
    ).ravel()
    residual = run.rows("RESIDUAL", d * n)[unknown].reshape(d, n)
    near = np.abs(place[:, None] - place) <= at["BAND"]
    inside = np.tile(near, (d, d))
    entries = unknown[:, None] * at["EQUATION_STRIDE"] + at["EQUATION_OFFSET"] + unknown
    matrix = run.rows("JACOBIAN", at["ROWS"] - at["JACOBIAN"])
    jacobian = np.where(inside, matrix[np.where(inside, entries, 0)], 0.0).reshape(d, n, d, n)
    return residual, jacobian[:, :, [header.column_order.index(k) for k in range(1, d + 1)]]


def held_equations_of(header: Header, run: Any, h: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Read residual and Jacobian with constraints: rows of phi and columns of mu come last.

    In the workspace they are divided by h, as what they stand beside.
    """
    at, n, d, m = header.layout, header.n, header.degree, len(header.constraints)
    own_residual, own = equations_of(header, run)
    place = np.array(header.held_places)
    place[:n] = place[np.argsort(header.coordinate_order)]
    blocks = np.arange(d)[:, None] * at["HELD_ROW_STEP"]
    of_q, of_mu = (blocks + some * at["HELD_PLACE_STEP"] for some in (place[:n], place[n:]))
    rows = np.concatenate([of_q.ravel(), of_mu.ravel()])
    order = [header.column_order.index(k) for k in range(1, d + 1)]
    columns = np.concatenate([of_q[order].ravel(), of_mu.ravel()])
    near = np.abs(rows[:, None] - columns) < d * (at["HELD_BAND"] + 1)
    entries = rows[:, None] * at["SOLVE_STRIDE"] + at["SOLVE_OFFSET"] + columns
    matrix = run.rows("JACOBIAN", at["ROWS"] - at["JACOBIAN"])
    jacobian = np.where(near, matrix[np.where(near, entries, 0)], h * 0)
    jacobian[: d * n, : d * n] += own.reshape(d * n, d * n)
    jacobian[d * n :] *= h
    jacobian[:, d * n :] *= h
    phi = run.rows("RESIDUAL", d * (n + m))[d * n :] * h
    return np.concatenate([own_residual.ravel(), phi]), jacobian


def slopes_of(header: Header, rows: NDArray[Any]) -> NDArray[Any]:
    """Read Phi, shape (..., m, n), from second derivatives of lambda.phi, shape (..., rows)."""
    at, n = header.layout, header.n
    place = np.array(header.held_places)
    behind = place[n:, None]
    place = place[np.argsort(header.coordinate_order)]
    near = np.abs(behind - place) <= at["HELD_BAND"]
    entries = behind * at["HELD_STRIDE"] + at["HELD_OFFSET"] + place
    return np.where(near, rows[..., np.where(near, entries, 0)], rows[..., :1, None] * 0)


def read_header(text: str, where: str) -> Header:
    """Read the constants of a generated module from its syntax tree.

    Raises
    ------
    StaleKernelError
        If the text is not a module that this version's generator wrote, unchanged.
    """
    _check_digest(text, where)
    constants: dict[str, Any] = {}
    functions: list[str] = []
    try:
        body = syntax(text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise StaleKernelError(
            f"{where}: this is no Python, so no module that symsimpson generated.\n"
            "It is damaged, or was made by somebody else. Generate it anew."
        ) from None
    for node in body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            value = node.value
            if isinstance(value, ast.Call) and value.args:  # array((...))
                value = value.args[0]
            try:
                constants[node.targets[0].id] = ast.literal_eval(value)
            except ValueError:
                continue
        elif isinstance(node, ast.FunctionDef):
            functions.append(node.name)
    if constants.get("INTERFACE") != INTERFACE:
        raise StaleKernelError(
            f"{where}: the module has kernel interface {constants.get('INTERFACE')}, "
            f"this symsimpson drives interface {INTERFACE}.\n"
            "Generate it anew: symsimpson generate, or symsimpson.generate(system, scheme)."
        )
    # explicit steps have no loops over coordinates, and so no order of them
    constants.setdefault("COORDINATE", tuple(range(len(constants["COORDINATES"]))))
    constants = {
        "FORCES": (),
        "AUTONOMOUS": True,
        "INPUTS": (),
        "INPUT_PLACES": (),
        "CONFORMAL": False,
        "HELD_BY": (),
        "HELD_PLACE": (),
        "VARIED_BY": None,
        "RETIMED": False,
        **constants,
    }
    names = {
        "system": "SYSTEM",
        "scheme": "SCHEME",
        "digest": "DIGEST",
        "order": "ORDER",
        "degree": "DEGREE",
        "newton_unknowns": "NEWTON_UNKNOWNS",
        "coordinates": "COORDINATES",
        "parameters": "PARAMETERS",
        "defaults": "DEFAULTS",
        "signs": "SIGNS",
        "invariants": "INVARIANTS",
        "real_everywhere": "REAL_EVERYWHERE",
        "rows": "ROWS",
        "row_order": "ROW_ORDER",
        "column_order": "COLUMN_ORDER",
        "coordinate_order": "COORDINATE",
        "forces": "FORCES",
        "autonomous": "AUTONOMOUS",
        "inputs": "INPUTS",
        "input_places": "INPUT_PLACES",
        "conformal": "CONFORMAL",
        "constraints": "HELD_BY",
        "held_places": "HELD_PLACE",
        "varied_by": "VARIED_BY",
        "retimed": "RETIMED",
    }
    blocks = {
        name: value
        for name, value in constants.items()
        if type(value) is int and re.fullmatch(r"[A-Z][A-Z_]+", name)
    }
    _check_layout(blocks, where)
    return Header(
        **{field: constants[name] for field, name in names.items()},
        layout=MappingProxyType(blocks),
        functions=tuple(functions),
    )


def _check_layout(layout: Mapping[str, int], where: str) -> None:
    """Check that blocks that the driver moves as one stand behind one another."""
    order = sorted((block for block in BLOCKS if block in layout), key=layout.__getitem__)
    for blocks in ADJACENT:
        if blocks[0] in OPTIONAL and blocks[0] not in order:
            continue
        first = order.index(blocks[0]) if blocks[0] in order else 0
        if tuple(order[first : first + len(blocks)]) != blocks:
            raise StaleKernelError(
                f"{where}: the blocks {', '.join(blocks)} of the workspace do not stand behind one "
                "another.\nGenerate the module anew."
            )


def digest(text: str) -> str:
    """Return the SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def _check_digest(text: str, where: str) -> None:
    found = SIGNED.search(text)
    if found is None:
        raise StaleKernelError(
            f"{where}: this is no module that symsimpson generated: its banner has no digest.\n"
            "Only generated modules are loaded, because loading executes them. Generate one with "
            "symsimpson.generate(system, scheme)."
        )
    if digest(text[found.end() :]) != found[1]:
        raise StaleKernelError(
            f"{where}: the module does not match the digest in its banner: it was edited or "
            "damaged.\nIts equations can no longer be trusted. Change the system, not the file, "
            "and generate it anew."
        )
