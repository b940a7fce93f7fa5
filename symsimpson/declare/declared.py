"""The fields of a declared system, its digest, and values that users pass for it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, ClassVar, TypeAlias

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import time
from symsimpson.declare.plain import Plain, Symbols
from symsimpson.errors import reject
from symsimpson.graph.read import tree_size
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.literals import float_literals
from symsimpson.support.names import NameTable, is_masked, read_mapping, spelled

Positions = Mapping[str, Sequence[Any]]
Matrix: TypeAlias = sp.ImmutableDenseMatrix
#: Parts of a Lagrangian with more nodes than this, as trees, are not rewritten.
LARGE = 2000


@dataclass(frozen=True, eq=False, repr=False)
class Declared:
    """The fields of a :class:`MechanicalSystem`, without its checks and methods."""

    name: str
    coordinates: tuple[AppliedUndef, ...] = field(kw_only=True)
    kinetic: sp.Expr = field(kw_only=True)
    potential: sp.Expr = field(kw_only=True)
    parameters: Mapping[sp.Symbol, float] = field(kw_only=True, default_factory=dict)
    positions: Positions | None = field(kw_only=True, default=None)
    invariants: Mapping[str, sp.Expr] | None = field(kw_only=True, default=None)
    gyroscopic: sp.Expr = field(kw_only=True, default=sp.S.Zero)
    indefinite: bool = field(kw_only=True, default=False)
    forces: Mapping[Any, Any] | None = field(kw_only=True, default=None)
    dissipation: sp.Expr | None = field(kw_only=True, default=None)
    inputs: tuple[sp.Expr, ...] = field(kw_only=True, default=())
    constraints: Mapping[str, sp.Expr] = field(kw_only=True, default_factory=dict)
    velocity_constraints: Mapping[str, sp.Expr] = field(kw_only=True, default_factory=dict)
    units: Mapping[Any, str] = field(kw_only=True, default_factory=dict)
    prescribed: Mapping[Any, sp.Expr] = field(kw_only=True, default_factory=dict)
    contacts: Mapping[str, Any] = field(kw_only=True, default_factory=dict)
    friction: Mapping[str, Any] = field(kw_only=True, default_factory=dict)
    in_mode: ClassVar[bool] = False  # True for the system of one mode of contacts and friction
    mass_checked: ClassVar[bool] = False  # True if M is known to be regular: M/g of a retimed one
    plain: Plain = field(init=False)
    seconds: dict[str, float] = field(init=False)
    #: The motion of coordinates that are prescribed, and the forces that it takes.
    motion: Any = field(init=False, default=None)
    #: The modes of contacts and friction; None without either.
    modes: Any = field(init=False, default=None)

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
        """True if T and V exceed LARGE nodes, so that SymPy's output omits them."""
        plain = self.plain
        return sum(tree_size(plain.graph, value) for value in (plain.T, plain.V)) > LARGE


def compute_digest(system: Declared) -> str:
    """Return the SHA-256 of the names and equations of a system, without parameter values."""
    plain = system.plain
    forces = [value for force in plain.forces.values() for value in force]
    values = [plain.T, *plain.energies, *plain.invariants.values(), *forces]
    values += plain.constraint_values
    nodes = plain.graph.descendants(n for _, n in values)
    place = {n: k for k, n in enumerate(nodes)}

    def spelled(n: int) -> str:
        kind, parts, _ = plain.graph.nodes[n]
        match kind:
            case "sum":
                return str([(str(c), place[m]) for c, m in parts])
            case "product":
                return str([(place[m], str(e)) for m, e in parts])
            case "function":
                return str([parts[0], *((str(c), place[m]) for c, m in parts[1:])])
        return str(parts)

    content = [
        system.name,
        [str(q) for q in system.coordinates],
        [sp.srepr(a) for a in system.parameters],
        sorted(plain.M),
        [(plain.graph.nodes[n].kind, spelled(n)) for n in nodes],
        [(str(c), place[n]) for c, n in values],
        list(plain.invariants),
        *([list(plain.forces)] if plain.forces else []),
        *([list(map(str, system.inputs))] if system.inputs else []),
        *([["constraints", *plain.constraints]] if plain.constraints else []),
        *([["of velocities", *rolling]] if (rolling := plain.velocity_constraints) else []),
        *([[repr(system.contacts), repr(system.friction)]] if system.modes is not None else []),
    ]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def read_vector(system: Declared, name: str, given: Any) -> Floats:
    """Read one number for each coordinate, in order or by name."""
    table = NameTable("coordinate", [spelled(q) for q in system.coordinates])
    try:
        ordered = table.in_order(name, given)
        vector = np.array(None if is_masked(ordered) else ordered, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        vector = np.empty(0)
    if vector.shape != (system.n,) or not np.isfinite(vector).all():
        reject(
            f"{name} is {given!r}, not {system.n} finite numbers.",
            remedy=f"Pass one number for each of {', '.join(table.shown)}.",
        )
    return vector


def read_values(
    name: str, what: str, defaults: Mapping[Any, Any], given: Mapping[Any, Any] | None
) -> list[float]:
    """Read values by symbol or name, and return them in the order of the defaults."""
    table = NameTable(what, [spelled(key) for key in defaults])
    values = [float(x) for x in defaults.values()]
    for place, value in table.values_by_place(read_mapping(name, given, what[0]), name).items():
        try:
            values[place] = np.nan if is_masked(value) else float(value)
        except (TypeError, ValueError, OverflowError):
            values[place] = np.nan
        if not np.isfinite(values[place]):
            reject(
                f"the {what} {table.shown[place]} is {value!r}, not a finite number.",
                where=name,
                remedy="Pass a number.",
            )
    return values


def points_of(system: Declared, t: Reals, q: Reals, values: Reals) -> dict[str, Floats]:
    """Evaluate the declared positions at times t of shape (...) and positions q of shape (..., n).

    A point has the shape (..., 2) or (..., 3), a body (..., corners, 2 or 3). The result is
    empty if no positions were declared.
    """
    positions = system.positions or {}
    columns = [np.asarray(x, dtype=np.float64) for x in (t, q, values)]
    numbers = [columns[0], *(x[..., k] for x in columns[1:] for k in range(x.shape[-1]))]
    shape = columns[1].shape[:-1]
    points = {}
    # cached by expression, because two systems are equal if only their positions differ
    arguments = (time, *system.coordinates, *system.parameters)
    places = _position_function(arguments, tuple(positions.values()))(*numbers) if positions else []
    for (name, given), corners in zip(positions.items(), places, strict=True):
        rows = [
            np.stack([np.broadcast_to(axis, shape) for axis in corner], axis=-1)
            for corner in corners
        ]
        single = not isinstance(given[0], tuple)
        points[name] = np.asarray(rows[0] if single else np.stack(rows, axis=-2), dtype=np.float64)
    return points


@lru_cache(maxsize=64)
def _position_function(
    arguments: tuple[sp.Basic, ...], positions: tuple[Any, ...]
) -> Callable[..., Any]:
    """Return a function of t, positions and parameters that computes all corners.

    Names that Python does not accept would make SymPy replace symbols one by one, so the
    function uses symbols of its own.
    """
    plain = {x: sp.Symbol(f"x_{k}") for k, x in enumerate(arguments)}
    corners = [
        [
            [x.xreplace(plain) for x in corner]
            for corner in (given if isinstance(given[0], tuple) else [given])
        ]
        for given in positions
    ]
    function: Callable[..., Any] = sp.lambdify([*plain.values()], float_literals(corners), "numpy")
    return function
