"""Rigid bodies with unit quaternions, whose equations have no singular orientation.

The first component of a quaternion is its scalar part. It turns vectors from the body to space.
Rates and rotations agree with ``ReferenceFrame.orient_quaternion`` of SymPy. They are polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike
from sympy.core.function import AppliedUndef

from symsimpson.declare.coordinates import coordinates, time
from symsimpson.declare.orientation import ROUNDED, multiply, read_array, read_orientation
from symsimpson.errors import ModelError, ModelWarning, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explain_methods, warn

#: Relative error of moments of inertia, which people write with two digits or more.
WRITTEN = 1e-2

#: Names of all bodies by their quaternions.
_bodies: dict[tuple[AppliedUndef, ...], str] = {}


def read_scalar(what: str, given: Any) -> sp.Expr:
    """Read a number or an expression, but no text."""
    try:
        scalar = sp.sympify(given, strict=True)
    except (sp.SympifyError, AttributeError, TypeError):
        scalar = None
    if not isinstance(scalar, sp.Expr) or scalar.is_Matrix:
        reject(
            f"{what} is {given!r}, neither a number nor an expression.",
            why="The package never evaluates text.",
            remedy="Write SymPy symbols and numbers without quotes.",
            error=ModelError,
        )
    return scalar


def quaternion(name: str) -> tuple[AppliedUndef, ...]:
    """Make four coordinates, the components of a quaternion.

    Parameters
    ----------
    name : str
        First part of the names of the coordinates, ``<name>0`` to ``<name>3``.

    Returns
    -------
    tuple of sympy functions of time
        The four components, the scalar part first. They describe a rotation if the sum of
        their squares is one, which is a constraint.

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
        reject(
            f"the quaternion's name {name!r} is no name.",
            remedy="Write q = symsimpson.quaternion('q').",
            error=ModelError,
        )
    return coordinates(" ".join(f"{name}{i}" for i in range(4)))


def rotation_matrix(q: Sequence[Any]) -> sp.ImmutableDenseMatrix:
    """Return the matrix that converts the components of a vector from body axes to space axes.

    Parameters
    ----------
    q : sequence of four expressions
        A unit quaternion, the scalar part first.

    Returns
    -------
    sympy matrix, 3 by 3
        A quadratic polynomial in q. Its transpose is SymPy's ``body.dcm(space)``.

    Raises
    ------
    ModelError
        If q does not have four components.

    Examples
    --------
    >>> import symsimpson as ss
    >>> ss.rotation_matrix((1, 0, 0, 0))
    Matrix([
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1]])
    """
    a, b, c, d = _read_quaternion(q)
    return sp.ImmutableDenseMatrix(
        [
            [a**2 + b**2 - c**2 - d**2, 2 * (b * c - a * d), 2 * (a * c + b * d)],
            [2 * (b * c + a * d), a**2 - b**2 + c**2 - d**2, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (a * b + c * d), a**2 - b**2 - c**2 + d**2],
        ]
    )


def body_rates(q: Sequence[Any], rates: Sequence[Any] | None = None) -> sp.ImmutableDenseMatrix:
    """Return the angular velocity of a quaternion, in body axes.

    Parameters
    ----------
    q : sequence of four expressions
        A unit quaternion, the scalar part first.
    rates : sequence of four expressions, optional
        The time derivatives of q. The default is ``.diff()`` of each component.

    Returns
    -------
    sympy matrix, 3 by 1
        The vector part of 2 conj(q) q'.

    Raises
    ------
    ModelError
        If q or its rates do not have four components.

    Examples
    --------
    >>> import symsimpson as ss
    >>> q = ss.quaternion("q")
    >>> ss.body_rates(q, (0, 0, 0, 1))[2]
    2*q0(t)
    """
    a, b, c, d = _read_quaternion(q)
    u, x, y, z = _read_quaternion(
        [s.diff(time) for s in _read_quaternion(q)] if rates is None else rates
    )
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
        Components of the two points, for example from :meth:`RigidBody.point`.

    Returns
    -------
    list of sympy expressions
        The differences of the components.

    Raises
    ------
    ModelError
        If the points have different numbers of components.

    Examples
    --------
    >>> import symsimpson as ss
    >>> x, y = ss.coordinates("x y")
    >>> ss.coincide((x, y), (1, 2))
    [x(t) - 1, y(t) - 2]
    """
    a, b = map(read_components, (first, second))
    if len(a) != len(b):
        reject(
            f"a point with {len(a)} components and one with {len(b)} cannot coincide.",
            remedy="Pass two points with the same number of components.",
            error=ModelError,
        )
    return [x - y for x, y in zip(a, b, strict=True)]


def read_components(point: Any) -> list[sp.Expr]:
    """Read the components of a point from a sequence or a matrix."""
    components = _to_list(point)
    if components is None:
        reject(
            f"a point has components, but {point!r} has none.",
            remedy="Write a sequence: coincide((x, y), (1, 2)), or body.point((0, 0, 1)).",
            error=ModelError,
        )
    return [read_scalar("a component of a point", x) for x in components]


def _to_list(given: Any) -> list[Any] | None:
    """Return the entries of a sequence or a matrix, and None for other objects."""
    try:
        return None if isinstance(given, str) else list(given)
    except TypeError:
        return None


def _read_quaternion(q: Sequence[Any]) -> tuple[sp.Expr, sp.Expr, sp.Expr, sp.Expr]:
    """Read the four components of a quaternion."""
    components = _to_list(q)
    parts = tuple(read_scalar("a component of a quaternion", x) for x in components or ())
    if len(parts) != 4:
        reject(
            f"a quaternion has four components, but {q!r} has {len(parts) or 'none'}.",
            remedy="Make a quaternion: q = symsimpson.quaternion('q').",
            error=ModelError,
        )
    return parts


def warn_of_lengths(
    system: str, coordinates: Sequence[AppliedUndef], constraints: Sequence[sp.Expr]
) -> None:
    """Warn of quaternions of bodies that no constraint contains."""
    constrained = {q for phi in constraints for q in sp.sympify(phi).atoms(AppliedUndef)}
    for components, body in _bodies.items():
        if constrained.isdisjoint(components) and {*components} <= {*coordinates}:
            warn(
                f"system '{system}': no constraint keeps the quaternion of the body {body!r} at "
                "length 1, so its length changes during the motion.\nDeclare the system with "
                "constraints=[*body.constraints].",
                ModelWarning,
            )


@explain_methods(also=("__init__",))
class RigidBody:
    """A rigid body: coordinates, kinetic energy and the constraint of a unit quaternion.

    Without a mass, the body turns about a fixed point, the origin of space and of the body. With
    a mass, it moves freely, and its origin is the centre of mass.

    Parameters
    ----------
    name : str
        First part of the names of its coordinates: ``<name>_q0`` to ``<name>_q3`` and, with a
        mass, ``<name>_x``, ``<name>_y``, ``<name>_z``.
    inertia : three expressions, or a symmetric 3 by 3 matrix
        Moments of inertia about the origin of the body, in body axes.
    mass : expression, optional
        The mass. The default None declares a body that turns about a fixed point.
    fourth : expression, optional
        The inertia J0 in T = (w.J.w + J0 w0^2)/2, which belongs to changes of the quaternion's
        length. The motion does not depend on J0, and errors of a step hardly do. The default is
        a third of the trace of J.

    Attributes
    ----------
    quaternion : tuple of four sympy functions
        The components of the quaternion, the scalar part first.
    position : tuple of three sympy functions
        The position of the centre of mass. It is empty for a body without a mass.

    Raises
    ------
    ModelError
        If the inertia is neither three moments nor a symmetric matrix, or has a negative moment.

    Warns
    -----
    ModelWarning
        If a principal moment is greater than the sum of the other two, which is impossible for a
        body.

    Notes
    -----
    w = 2 conj(q) q' is the angular velocity in body axes. Its scalar part w0 = 2 q.q' vanishes if
    q has length 1.

    Examples
    --------
    A heavy top on its tip:

    >>> import sympy as sp, symsimpson as ss
    >>> m, g, l = sp.symbols("m g l", positive=True)
    >>> body = ss.RigidBody("top", inertia=(1, sp.Rational(3, 2), sp.Rational(4, 5)))
    >>> top = ss.MechanicalSystem(
    ...     "top", coordinates=body.coordinates, kinetic=body.kinetic,
    ...     potential=m*g*l*body.to_space((0, 0, 1))[2], constraints=body.constraints,
    ...     parameters={m: 1.0, g: 9.81, l: 0.1})
    >>> q0, v0 = body.state(angles=(0.0, 1.0, 0.0), angular_velocity=(0.0, 0.0, 4.0))
    >>> top.degrees_of_freedom, q0.round(3).tolist(), v0.round(3).tolist()
    (3, [0.878, 0.479, 0.0, 0.0], [0.0, 0.0, -0.959, 1.755])
    """

    def __init__(self, name: str, inertia: Any, mass: Any = None, *, fourth: Any = None) -> None:
        self.name = name
        self.mass = None if mass is None else read_scalar(f"the mass of {name!r}", mass)
        self.quaternion = quaternion(f"{name}_q")
        _bodies[tuple(self.quaternion)] = name
        place = " ".join(f"{name}_{axis}" for axis in "xyz")
        self.position: tuple[AppliedUndef, ...] = coordinates(place) if mass is not None else ()
        self.inertia = _read_inertia(name, inertia)
        self.fourth = self.inertia.trace() / 3
        if fourth is not None:
            self.fourth = read_scalar(f"the fourth moment of {name!r}", fourth)

    def __repr__(self) -> str:
        return f"RigidBody({self.name!r})"

    @property
    def coordinates(self) -> tuple[AppliedUndef, ...]:
        """The four components of the quaternion, then the position of a body that moves."""
        return (*self.quaternion, *self.position)

    @cached_property
    def angular_velocity(self) -> sp.ImmutableDenseMatrix:
        """The angular velocity in body axes, 3 by 1."""
        return body_rates(self.quaternion)

    @cached_property
    def rotation(self) -> sp.ImmutableDenseMatrix:
        """The matrix from body axes to space axes, 3 by 3."""
        return rotation_matrix(self.quaternion)

    @cached_property
    def kinetic(self) -> sp.Expr:
        """The kinetic energy, a polynomial in the quaternion and its velocity."""
        w = self.angular_velocity
        length = 2 * sum((q * q.diff() for q in self.quaternion), sp.S.Zero)
        turning = (w.T * self.inertia * w)[0] / 2 + self.fourth * length**2 / 2
        speed = sum((x.diff() ** 2 for x in self.position), sp.S.Zero)
        return turning + (sp.S.Zero if self.mass is None else self.mass * speed / 2)

    @property
    def constraints(self) -> tuple[sp.Expr, ...]:
        """The constraint (q.q - 1)/2 = 0 of the quaternion."""
        return ((sum((q**2 for q in self.quaternion), sp.S.Zero) - 1) / 2,)

    def to_space(self, vector: Sequence[Any]) -> sp.ImmutableDenseMatrix:
        """Convert a vector from body axes to space axes; the result is 3 by 1."""
        components = read_components(vector)
        if len(components) != 3:
            reject(
                f"a vector in the body {self.name!r} has {len(components)} components, not three.",
                remedy="Write (x, y, z).",
                error=ModelError,
            )
        return sp.ImmutableDenseMatrix(self.rotation * sp.Matrix(components))

    def point(self, place: Sequence[Any]) -> sp.ImmutableDenseMatrix:
        """Return the position in space of a point of the body, 3 by 1.

        Use it for joints, potentials and points to draw.

        Examples
        --------
        >>> import symsimpson as ss
        >>> rod = ss.RigidBody("rod", inertia=(1, 1, 0), mass=2)
        >>> rod.point((0, 0, 0)).T
        Matrix([[rod_x(t), rod_y(t), rod_z(t)]])
        """
        centre = sp.Matrix(list(self.position) or [0, 0, 0])
        return sp.ImmutableDenseMatrix(centre + self.to_space(place))

    def state(
        self,
        *,
        angles: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        position: ArrayLike = (0.0, 0.0, 0.0),
        velocity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> tuple[Floats, Floats]:
        """Return an initial state as numbers.

        Pass at most one of angles, rotation and quaternion. The default is the orientation in
        which body axes are space axes.

        Parameters
        ----------
        angles : array_like, shape (3,), optional
            Euler angles (phi, theta, psi) in radians: turns about z, the new x, and the new z.
        rotation : array_like, shape (3, 3), optional
            The rotation matrix from body axes to space axes.
        quaternion : array_like, shape (4,), optional
            A unit quaternion, the scalar part first.
        angular_velocity : array_like, shape (3,)
            The angular velocity in body axes. The default is zero.
        position, velocity : array_like, shape (3,)
            Position and velocity of the centre of mass in space. The default is zero.

        Returns
        -------
        q0, v0 : ndarray, shape (4,) or (7,)
            Values of the coordinates and of their velocities.

        Raises
        ------
        InputError
            If you pass more than one orientation, or an argument is invalid.
        """
        q = read_orientation(angles, rotation, quaternion)
        w = np.concatenate([[0.0], read_array("angular_velocity", angular_velocity, (3,))])
        turning = multiply(q, w) / 2
        if self.mass is None:
            if np.any(position) or np.any(velocity):
                reject(
                    f"the body {self.name!r} turns about a fixed point and has no position.",
                    remedy="Let it move: RigidBody(name, inertia, mass).",
                )
            return q, turning
        place = read_array("position", position, (3,))
        speed = read_array("velocity", velocity, (3,))
        return np.concatenate([q, place]), np.concatenate([turning, speed])


def _read_inertia(name: str, given: Any) -> sp.ImmutableDenseMatrix:
    """Check moments of inertia, and return them as a 3 by 3 matrix."""
    try:
        parts = [] if isinstance(given, str) else given
        parts = parts.tolist() if hasattr(parts, "tolist") else list(parts)
        if len(parts) == 3 and not any(isinstance(x, (list, tuple)) for x in parts):
            parts = [[x if i == j else 0 for j in range(3)] for i, x in enumerate(parts)]
        what = f"an inertia of {name!r}"
        matrix = sp.ImmutableDenseMatrix([[read_scalar(what, x) for x in row] for row in parts])
        if matrix.shape == (3, 3) and matrix == matrix.T:
            least, excess = _check_moments(matrix)
            if least < 0 or any(moment.is_negative for moment in matrix.diagonal()):
                reject(
                    f"the body {name!r} has a negative moment of inertia.",
                    why="Moments are integrals of squared distances.",
                    remedy="Check the signs.",
                    error=ModelError,
                )
            if excess > 0:
                warn(
                    f"a principal moment of inertia of {name!r} is greater than the sum of the "
                    "other two.\nThis is impossible for a body, but the run computes its motion. "
                    "Check the numbers, and the axes and the point of reference.",
                    ModelWarning,
                )
            return matrix
    except (TypeError, ValueError, sp.SympifyError):
        pass
    reject(
        f"the inertia of {name!r} is neither three moments nor a symmetric 3 by 3 matrix.",
        remedy="Write inertia=(I1, I2, I3), or a symmetric matrix.",
        error=ModelError,
    )


def _check_moments(matrix: sp.ImmutableDenseMatrix) -> tuple[float, float]:
    """Return a negative principal moment, and the excess of the greatest over the other two.

    A result is zero if it is within round-off error, or if moments are not numbers.
    """
    if not all(x.is_number and x.is_finite for x in matrix):
        return 0.0, 0.0
    first, second, third = np.linalg.eigvalsh(np.array(matrix, dtype=np.float64))
    excess, size = third - second - first, max(abs(first), third)
    return first if -first > ROUNDED * size else 0.0, excess if excess > WRITTEN * size else 0.0
