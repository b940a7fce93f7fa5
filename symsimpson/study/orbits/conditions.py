"""Conditions on the initial state of an orbit, and the map that closes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
import sympy as sp

from symsimpson.declare.coordinates import time
from symsimpson.errors import reject
from symsimpson.run.state_costs import StateCost
from symsimpson.study.orbits.boundary_path import ENERGY, PERIOD
from symsimpson.study.orbits.flow import SMALL, Flow
from symsimpson.support.array_types import Floats
from symsimpson.support.names import did_you_mean, read_mapping, spelled


@dataclass(frozen=True)
class Condition:
    """A quantity of a state or of the orbit, and its value."""

    name: str
    value: float
    cost: StateCost | None = None  #: None for the energy and the period.
    other: StateCost | None = None  #: Subtracted from the first one.

    def row(
        self, flow: Flow, z: Floats, period: float, values: Floats, end: float | None = None
    ) -> tuple[float, Floats]:
        """Return the deviation, and its derivatives by the state, the period and unknowns.

        The state z is the initial one, or that at the time ``end``.
        """
        n, k = flow.n, len(flow.places)
        slopes = np.zeros(2 * n + 1 + k)
        if self.name == PERIOD and self.cost is None:
            slopes[2 * n] = flow.parts
            return flow.parts * period - self.value, slopes
        if self.cost is None:
            slopes[: 2 * n] = flow.energy_gradient(z, values)
            for j, place in enumerate(flow.places):
                moved = np.zeros_like(values)
                moved[place] = SMALL * (abs(values[place]) or 1.0)
                up, down = (flow.energy(z[None], values + s * moved)[0] for s in (1, -1))
                slopes[2 * n + 1 + j] = (up - down) / (2 * moved[place])
            return float(flow.energy(z[None], values)[0]) - self.value, slopes
        total = -self.value
        for cost, sign in ((self.cost, 1.0), (self.other, -1.0)):
            if cost is not None:
                t = np.array([float(flow.spec.t0) if end is None else end])
                steps = np.array([0.0 if end is None else flow.steps])
                here = cost.slopes(steps, t, z[None, :n], z[None, n:], values)
                by_unknown = here.parameters[0]
                if len(by_unknown) > k:  # by h, with which the time of the end moves
                    slopes[2 * n] += sign * by_unknown[0] / flow.steps
                total += sign * float(here.value[0])
                slopes[: 2 * n] += sign * here.state[0]
                slopes[2 * n + 1 :] += sign * by_unknown[len(by_unknown) - k :]
        return total, slopes


def read_conditions(flow: Flow, what: str, given: Any) -> tuple[Condition, ...]:
    """Read a mapping from coordinates, velocities, expressions, "energy" or "period" to values."""
    conditions = read_mapping(what, given, flow.program.coordinates[0]).items()
    return tuple(read_condition(flow, what, key, value) for key, value in conditions)


def read_condition(flow: Flow, what: str, key: Any, value: Any) -> Condition:
    """Read a quantity and its value, a number or an expression."""
    program, name = flow.program, spelled(key) if isinstance(key, str) else str(key)
    number = float(value) if isinstance(value, Real) or getattr(value, "is_number", False) else None
    if number is not None and not np.isfinite(number):
        reject(f"{what}[{name!r}] is {value!r}.", remedy="Pass a finite number.")
    if name in (ENERGY, PERIOD) and name not in (*program.coordinates, *program.parameters):
        if number is None:
            reject(f"{what}[{name!r}] is {value!r}.", remedy="Pass a number.")
        why = "the energy of this system is not constant."
        free = program.header.conservative
        if name == PERIOD:
            why, free = "the period follows from parameters or events.", flow.free_period
        if not free:
            reject(why, where=program.system, remedy=f"Remove {name!r} from {what}.")
        return Condition(name, number)
    cost = StateCost(program, f"{what}[{name}]", key)
    if number is not None:
        return Condition(name, number, cost)
    return Condition(name, 0.0, cost, StateCost(program, f"{what}[{name}]", value))


@dataclass(frozen=True)
class Closing:
    """The map that closes an orbit: q = R q0 + shift, p = R^-T p0.

    ``shift`` depends on parameters and on ``symbols``, which are unknowns beside the parameters.
    """

    R: Floats  #: Shape (n, n).
    shift: tuple[sp.Expr, ...]
    symbols: tuple[sp.Symbol, ...]  #: Unknowns that are no parameters.
    parameters: tuple[sp.Symbol, ...]  #: All parameters of the system.
    order: int  #: The least power of R that is the identity; 1 if there is none up to 60.

    @property
    def matrix(self) -> Floats:
        """The map of (q, p), shape (2 n, 2 n)."""
        none = np.zeros_like(self.R)
        return np.block([[self.R, none], [none, np.linalg.inv(self.R).T]])

    @property
    def moves(self) -> bool:
        """Whether a shift is not zero."""
        return any(x != 0 for x in self.shift)

    def at(self, values: Floats, extra: Floats) -> tuple[Floats, Floats]:
        """Return the shift of (q, p), and its derivatives by all parameters and symbols."""
        names, n = (*self.parameters, *self.symbols), len(self.R)
        shift, slopes = np.zeros(2 * n), np.zeros((2 * n, len(names)))
        if self.moves:
            point, whole = dict(zip(names, (*values, *extra), strict=True)), sp.Matrix(self.shift)
            by_name = whole.jacobian(sp.Matrix(1, len(names), names))
            shift[:n] = np.array(whole.subs(point), dtype=np.float64).ravel()
            slopes[:n] = np.array(by_name.subs(point), dtype=np.float64)
        return shift, slopes


def read_closing(program: Any, given: Any, unknowns: Sequence[Any]) -> Closing:
    """Read ``conditions``: the final value of each coordinate as an expression of the first state.

    Raises InputError for an expression that is not affine in the coordinates.
    """
    coordinates, parameters = program.declared.coordinates, tuple(program.declared.parameters)
    symbols = tuple(x for x in unknowns if x not in parameters)
    R, shift = np.eye(len(coordinates)), [sp.S.Zero] * len(coordinates)
    velocities = [q.diff(time) for q in coordinates]
    given = read_mapping("conditions", given, program.coordinates[0])
    for key, value in given.items():
        place, name = program.names.coordinates.place(key), spelled(key)
        if isinstance(value, str):
            reject(
                f"conditions[{name}] is the text {value!r}.",
                remedy="Texts are never evaluated: write it with the symbols themselves.",
            )
        if key in velocities:
            continue
        if place is None:
            reject(
                f"conditions contains {name!r}, which is not a coordinate."
                f"{did_you_mean(name, program.coordinates)}",
                remedy=f"The coordinates are {', '.join(program.coordinates)}.",
            )
        whole = sp.expand(sp.sympify(value))
        row = [whole.coeff(q) for q in coordinates]
        rest = sp.expand(whole - sum(c * q for c, q in zip(row, coordinates, strict=True)))
        allowed = {*parameters, *symbols}
        if not all(c.is_number for c in row) or not rest.free_symbols <= allowed or rest.has(time):
            reject(
                f"conditions[{name}] is {value}.",
                where=program.system,
                why="The final state has to be an affine function of the initial coordinates, "
                "with numbers as factors.",
                remedy="List other symbols in unknowns=, if they are no parameters.",
            )
        R[place], shift[place] = [float(c) for c in row], rest
    for place in (k for k, v in enumerate(velocities) if v in given):
        value = given[velocities[place]]
        if sp.expand(value - sum(R[place].tolist() * np.array(velocities))) != 0:
            reject(
                f"conditions gives {velocities[place]} the final value {value}.",
                where=program.system,
                why="Velocities change as their coordinates do.",
                remedy="Give conditions for coordinates only.",
            )
    if abs(np.linalg.det(R)) < 1e-12:
        reject(
            "conditions maps different initial states to the same final state.",
            where=program.system,
            remedy="Give each coordinate an expression of its own.",
        )
    powers = (np.linalg.matrix_power(R, k) for k in range(1, 61))
    order = next((k for k, x in enumerate(powers, 1) if np.allclose(x, np.eye(len(R)))), 1)
    return Closing(R, tuple(shift), symbols, parameters, order)
