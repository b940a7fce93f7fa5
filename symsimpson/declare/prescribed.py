"""Coordinates whose motion is prescribed, and the forces that this takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.checks import reject_model, spell
from symsimpson.declare.coordinates import time
from symsimpson.declare.declared import Declared
from symsimpson.declare.index_one import IndexOneFunction
from symsimpson.support.array_types import Floats, Reals
from symsimpson.support.literals import float_literals
from symsimpson.support.names import spelled


class PrescribedMotion:
    """Coordinates as functions of the time, and the system in which they are constrained."""

    def __init__(
        self,
        whole: Callable[[], Declared],
        again: Callable[[], Declared],
        motions: Mapping[AppliedUndef, sp.Expr],
    ) -> None:
        self._make, self.motions = whole, dict(motions)
        #: Declares the system once more, for copies.
        self.again = again
        names = [spelled(q) for q in motions]
        #: What runs know by name.
        self.names = (*names, *(f"v_{x}" for x in names), *(f"force_{x}" for x in names))

    @cached_property
    def _whole(self) -> Declared:
        """The system with all coordinates, and with constraints for the prescribed ones."""
        return self._make()

    @cached_property
    def _equations(self) -> IndexOneFunction:
        return IndexOneFunction(self._whole.plain)

    def values(
        self, key: str, system: Declared, states: tuple[Reals, ...], inputs: Reals
    ) -> Floats:
        """Return a quantity at states t, q and v, with values of parameters; see ``names``.

        The force is positive in the direction of the coordinate.
        """
        t, q, v, parameters = (np.asarray(x, dtype=np.float64) for x in states)
        columns = [parameters[..., k] for k in range(parameters.shape[-1])]
        moving = self._motions(system, t, columns)
        if key in moving:
            return np.broadcast_to(moving[key], q.shape[:-1]).astype(np.float64)
        q1 = next(x for x in self.motions if key == f"force_{spelled(x)}")
        n, place = self._whole.n, list(self._whole.constraints).index(prescribed_name(q1))
        known = {spelled(x): (q[..., k], v[..., k]) for k, x in enumerate(system.coordinates)}
        known |= {spelled(x): (moving[spelled(x)], moving[f"v_{spelled(x)}"]) for x in self.motions}
        pairs = [known[spelled(x)] for x in self._whole.coordinates]
        shape = q.shape[:-1]
        every = (
            np.stack([np.broadcast_to(x, shape) for x in side], axis=-1)
            for side in zip(*pairs, strict=True)
        )
        positions, velocities = every
        at = self._equations(t, positions, velocities, parameters, inputs)
        m = at.W.shape[-2]
        matrix = np.zeros((*shape, n + m, n + m))
        matrix[..., :n, :n], matrix[..., n:, :n] = at.M, at.W
        matrix[..., :n, n:] = np.swapaxes(at.W, -1, -2)
        right = np.concatenate([at.push, -at.curve], axis=-1)
        multipliers = np.linalg.solve(matrix, right[..., None])[..., n:, 0]
        return np.asarray(-multipliers[..., place])

    def _motions(self, system: Declared, t: Floats, columns: list[Any]) -> dict[str, Any]:
        """Return the prescribed coordinates and their velocities, by name."""
        arguments = {x: sp.Symbol(f"x_{k}") for k, x in enumerate((time, *system.parameters))}
        given = {spelled(q): x for q, x in self.motions.items()}
        given |= {f"v_{name}": x.diff(time) for name, x in given.items()}
        written = float_literals([x.xreplace(arguments) for x in given.values()])
        positions = sp.lambdify([*arguments.values()], written, "numpy")(t, *columns)
        return dict(zip(given, positions, strict=True))


def prescribed_values(
    key: str, system: Declared, states: tuple[Reals, ...], inputs: Reals
) -> Floats:
    """Return a prescribed coordinate, its velocity or its force; see :class:`PrescribedMotion`."""
    values: Floats = system.motion.values(key, system, states, inputs)
    return values


def prescribed_name(q: AppliedUndef) -> str:
    """Return the name of the constraint that replaces a prescribed motion."""
    return f"motion of {spelled(q)}"


def read_prescribed(
    name: str, given: Any, coordinates: Any, parameters: Mapping[sp.Symbol, float]
) -> dict[AppliedUndef, sp.Expr]:
    """Check that prescribed coordinates are functions of the time and of parameters."""
    if not isinstance(given, Mapping):
        reject_model(
            name,
            f"prescribed is a {type(given).__name__}, not a mapping from coordinates.",
            "Write prescribed={x: sp.sin(symsimpson.time)}.",
        )
    motions: dict[AppliedUndef, sp.Expr] = {}
    names = {spelled(x): x for x in coordinates}
    for key, motion in given.items():
        q = names.get(key, key) if isinstance(key, str) else key
        if q not in coordinates:
            reject_model(
                name,
                f"prescribed contains {q}, which is not one of the coordinates "
                f"{', '.join(map(spelled, coordinates))}.",
                "List it among the coordinates. The system then has one fewer.",
            )
        expression = sp.sympify(motion)
        if not isinstance(expression, sp.Expr) or expression.atoms(AppliedUndef):
            reject_model(
                name,
                f"the prescribed motion of {spelled(q)}, {spell(expression)}, contains a "
                "coordinate.",
                "Write a function of symsimpson.time and of parameters. If it depends on other "
                f"coordinates, declare the constraint {spelled(q)} - ... = 0.",
            )
        if unknown := expression.free_symbols - {time, *parameters}:
            reject_model(
                name,
                f"the prescribed motion of {spelled(q)} contains {min(map(str, unknown))}, which "
                "is no parameter.",
                "Give it a value in parameters=. Inputs cannot prescribe a motion.",
            )
        motions[q] = expression
    if len(motions) == len(coordinates):
        reject_model(
            name,
            "the motions of all coordinates are prescribed, so nothing is left to compute.",
            "Leave one coordinate free. For the forces alone, declare constraints={...}.",
        )
    return motions


def substitute(given: Any, motions: Mapping[AppliedUndef, sp.Expr]) -> Any:
    """Replace prescribed coordinates in expressions, and in mappings and sequences of them."""
    if isinstance(given, Mapping):
        left = {k: substitute(x, motions) for k, x in given.items() if k not in motions}
        return {k: x for k, x in left.items() if x != {}}
    if isinstance(given, (list, tuple)):
        return type(given)(substitute(x, motions) for x in given)
    if hasattr(given, "replaced"):  # a contact, or friction
        return given.replaced(lambda x: substitute(x, motions))
    if not isinstance(given, (sp.Basic, sp.MatrixBase)):
        return given
    moved = given.xreplace({q.diff(time): x.diff(time) for q, x in motions.items()})
    return moved.xreplace(dict(motions))
