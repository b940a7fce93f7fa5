"""Rotations by unit quaternions, and joints: plain expressions for energies and constraints.

A quaternion has its scalar part first and turns from the body to space. Rates and rotations are
those of ``ReferenceFrame.orient_quaternion`` in SymPy: polynomials, without a pole and without a
sine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import coordinates, time
from symsimpson.errors import ModelError


def read_scalar(what: str, given: Any) -> sp.Expr:
    """Read a number or an expression; text is not evaluated.

    Raises ModelError if it is neither.
    """
    try:
        scalar = sp.sympify(given, strict=True)
    except (sp.SympifyError, AttributeError, TypeError):
        scalar = None
    if not isinstance(scalar, sp.Expr) or scalar.is_Matrix:
        raise ModelError(
            f"{what} is {given!r}, neither a number nor an expression.\n"
            "Text is never evaluated here. Write it with SymPy symbols and numbers, unquoted."
        )
    return scalar


def quaternion(name: str) -> tuple[AppliedUndef, ...]:
    """Make four coordinates, the components of a quaternion.

    Parameters
    ----------
    name : str
        The coordinates are called ``<name>0`` to ``<name>3``.

    Returns
    -------
    tuple of sympy functions of time
        The scalar part first. They turn a body where their squares add up to one: a constraint.

    Raises
    ------
    ModelError
        If the name is not an identifier.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.quaternion("q")
    (q0(t), q1(t), q2(t), q3(t))
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ModelError(
            f"the quaternion's name {name!r} is no name.\nWrite q = symsimpson.quaternion('q')."
        )
    return coordinates(" ".join(f"{name}{i}" for i in range(4)))


def rotation_matrix(q: Sequence[Any]) -> sp.ImmutableDenseMatrix:
    """Return the matrix that turns components of vectors in the body into those in space.

    Parameters
    ----------
    q : sequence of four expressions
        A unit quaternion, the scalar part first.

    Returns
    -------
    sympy matrix, 3 by 3
        Of the second degree in q. Its transpose is SymPy's ``body.dcm(space)``.

    Raises
    ------
    ModelError
        If there are not four.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.rotation_matrix((1, 0, 0, 0))
    Matrix([
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1]])
    """
    a, b, c, d = _four(q)
    return sp.ImmutableDenseMatrix(
        [
            [a**2 + b**2 - c**2 - d**2, 2 * (b * c - a * d), 2 * (a * c + b * d)],
            [2 * (b * c + a * d), a**2 - b**2 + c**2 - d**2, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (a * b + c * d), a**2 - b**2 - c**2 + d**2],
        ]
    )


def body_rates(q: Sequence[Any], rates: Sequence[Any] | None = None) -> sp.ImmutableDenseMatrix:
    """Return the angular velocity in the body, in terms of a quaternion.

    Parameters
    ----------
    q : sequence of four expressions
    rates : sequence of four expressions, optional
        The time derivatives of q; those of coordinates unless given.

    Returns
    -------
    sympy matrix, 3 by 1
        2 conj(q) q', without its scalar part.

    Raises
    ------
    ModelError
        If there are not four.

    Examples
    --------
    >>> import symsimpson as ss
    >>> q = ss.quaternion("q")
    >>> ss.body_rates(q, (0, 0, 0, 1))[2]
    2*q0(t)
    """
    a, b, c, d = _four(q)
    u, x, y, z = _four([s.diff(time) for s in _four(q)] if rates is None else rates)
    rates_of_axes = [
        2 * (a * x - b * u - c * z + d * y),
        2 * (a * y + b * z - c * u - d * x),
        2 * (a * z - b * y + c * x - d * u),
    ]
    return sp.ImmutableDenseMatrix(rates_of_axes)


def coincide(first: Any, second: Any) -> list[sp.Expr]:
    """Return the constraints of a ball joint: the components of first - second, each zero.

    Parameters
    ----------
    first, second : sequences of expressions
        Components of the points, as :meth:`RigidBody.point` gives them.

    Returns
    -------
    list of sympy expressions
        The differences of the components.

    Raises
    ------
    ModelError
        If they have different numbers of components.

    Examples
    --------
    >>> import symsimpson as ss
    >>> x, y = ss.coordinates("x y")
    >>> ss.coincide((x, y), (1, 2))
    [x(t) - 1, y(t) - 2]
    """
    a, b = map(read_components, (first, second))
    if len(a) != len(b):
        raise ModelError(
            f"a point with {len(a)} components and one with {len(b)} cannot coincide.\n"
            "Give both in the same space."
        )
    return [x - y for x, y in zip(a, b, strict=True)]


def read_components(point: Any) -> list[sp.Expr]:
    """Read the components of a point: a sequence or a matrix."""
    components = _listed(point)
    if components is None:
        raise ModelError(
            f"a point has components, and {point!r} has none.\n"
            "Write them in a row: coincide((x, y), (1, 2)), or body.point((0, 0, 1))."
        )
    return [read_scalar("a component of a point", x) for x in components]


def _listed(given: Any) -> list[Any] | None:
    """Return the parts of a sequence or a matrix, which has no iterator; None of anything else."""
    try:
        return None if isinstance(given, str) else list(given)
    except TypeError:
        return None


def _four(q: Sequence[Any]) -> tuple[sp.Expr, sp.Expr, sp.Expr, sp.Expr]:
    """Read the four components of a quaternion."""
    components = _listed(q)
    parts = tuple(read_scalar("a component of a quaternion", x) for x in components or ())
    if len(parts) != 4:
        raise ModelError(
            f"a quaternion has four components, and {q!r} has {len(parts) or 'none'}.\n"
            "Make one: q = symsimpson.quaternion('q')."
        )
    return parts
