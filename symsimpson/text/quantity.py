"""Quantities that follow from a state: names, kernels, rows or matrices in the workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsimpson.support.array_types import Reals
from symsimpson.support.names import NameTable
from symsimpson.text.header import Header


def velocities_by(header: Header) -> str:
    """Return the kernel that gives the velocities of a state; a retimed start gives dq/dtau."""
    return "energy" if header.retimed else "start"


def by(kernel: str) -> Callable[[Header], str]:
    """Return what gives one kernel for all modules."""
    return lambda header: kernel


@dataclass(frozen=True)
class Quantity:
    """A quantity of states."""

    name: str  #: Of the attribute, of variables in files, and in ``run[name]`` if it is one number.
    doc: str  #: In words, as figures and files say it.
    block: str = ""  #: Where it stands in the workspace; "" if Python computes it.
    #: Takes a header, and returns the kernel that computes it; None for the state itself.
    kernel: Callable[[Header], str] | None = None
    #: What it has a number for each of; "" for a single number. Tables and files have single
    #: numbers, and those of coordinates.
    axis: str = ""
    prefix: str = ""  #: Stands before a name of these in the names of its numbers.
    #: Stands for it in kernels that observe expressions, with a number behind it if there is an
    #: axis; "" if no expression may contain it.
    symbol: str = ""
    like: str = ""  #: The quantity whose unit it has, unless it is given one.
    driven: bool = False  #: Whether it depends on the inputs at the state.

    def places(self, names: Any) -> Mapping[str, int]:
        """Return the place of each name that a user may give; of a single number there is none."""
        return self._axis(names).places if self.axis else {}

    def shown(self, names: Any) -> list[str]:
        """Return the names of its numbers."""
        return [f"{self.prefix}{x}" for x in self._axis(names).shown] if self.axis else [self.name]

    def _axis(self, names: Any) -> NameTable:
        named: NameTable = getattr(names, self.axis)
        return named


_TABLE = (
    Quantity("q", "position", "POSITION", axis="coordinates", symbol="q_"),
    Quantity("p", "conjugate momentum", "MOMENTUM", axis="coordinates", prefix="p_", symbol="p_"),
    Quantity(
        "v", "velocity", "VELOCITY", velocities_by, axis="coordinates", prefix="v_", symbol="v_"
    ),
    Quantity(
        "multipliers",
        "multipliers of constraints",
        "MULTIPLIER",
        by("multipliers"),
        axis="constraints",
        prefix="lambda_",
        symbol="l_",
        driven=True,
    ),
    Quantity("energy", "energy H", "ENERGY", by("energy"), symbol="energy"),
    Quantity(
        "kinetic_energy",
        "kinetic energy",
        "KINETIC",
        by("energy"),
        symbol="kinetic_energy",
        like="energy",
    ),
)
QUANTITIES = {quantity.name: quantity for quantity in _TABLE}
MULTIPLIERS = QUANTITIES["multipliers"]
#: Those with a number for each coordinate, and those of one number.
VECTORS = tuple(quantity for quantity in _TABLE if quantity.axis == "coordinates")
SCALARS = tuple(quantity for quantity in _TABLE if not quantity.axis)
#: Single numbers that expressions of users may contain.
OBSERVABLE = tuple(quantity for quantity in SCALARS if quantity.symbol)


def scalars_of(header: Header) -> tuple[Quantity, ...]:
    """Return the single numbers of a state; a Hamiltonian has no kinetic energy."""
    return tuple(x for x in SCALARS if not (header.canonical and x.block == "KINETIC"))


def equations_of(header: Header, run: Any) -> tuple[Reals, Reals]:
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
    return residual, jacobian[:, :, _columns(header)]


def _columns(header: Header) -> list[int]:
    """Return the block column of each of X_1..X_d."""
    order = header.tables["COLUMN_ORDER"]
    return [order.index(k) for k in range(1, header.degree + 1)]


def held_equations_of(header: Header, run: Any, h: Any) -> tuple[Reals, Reals]:
    """Read residual and Jacobian with constraints: rows of phi and columns of mu come last.

    In the workspace they are divided by h, as what they stand beside.
    """
    at, n, d, m = header.layout, header.n, header.degree, len(header.constraints)
    own_residual, own_jacobian = equations_of(header, run)
    place = np.array(header.tables["HELD_PLACE"])
    place[:n] = place[np.argsort(header.coordinate_order)]
    blocks, of_q, of_mu = np.arange(d)[:, None], *np.split(place * at["HELD_PLACE_STEP"], [n])
    of_q = blocks * at["HELD_ROW_STEP"] + of_q
    of_mu = at["HELD_SHIFT"] + blocks * at["HELD_PULL_STEP"] + of_mu
    rows = np.concatenate([of_q.ravel(), of_mu.ravel()])
    order = _columns(header)
    columns = np.concatenate([of_q[order].ravel(), of_mu.ravel()])
    near = np.abs(rows[:, None] - columns) < d * (at["HELD_BAND"] + 1)
    entries = rows[:, None] * at["SOLVE_STRIDE"] + at["SOLVE_OFFSET"] + columns
    matrix = run.rows("JACOBIAN", at["ROWS"] - at["JACOBIAN"])
    jacobian = np.where(near, matrix[np.where(near, entries, 0)], h * 0)
    jacobian[: d * n, : d * n] += own_jacobian.reshape(d * n, d * n)
    jacobian[d * n :] *= h
    jacobian[:, d * n :] *= h
    phi = run.rows("RESIDUAL", d * (n + m))[d * n :] * h
    return np.concatenate([own_residual.ravel(), phi]), jacobian


def slopes_of(header: Header, rows: Reals) -> Reals:
    """Read Phi, shape (..., m, n), from second derivatives of lambda.phi, shape (..., rows)."""
    at, n = header.layout, header.n
    place = np.array(header.tables["HELD_PLACE"], dtype=np.int32)
    behind = place[n:]
    place = place[np.argsort(header.coordinate_order)]
    c, i = np.nonzero(np.abs(behind[:, None] - place) <= at["HELD_BAND"])  # few, of long chains
    slopes = np.zeros((*rows.shape[:-1], len(behind), len(place)), dtype=rows.dtype)
    slopes[..., c, i] = rows[..., behind[c] * at["HELD_STRIDE"] + at["HELD_OFFSET"] + place[i]]
    return slopes
