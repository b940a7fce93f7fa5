"""Rigid bodies that turn by unit quaternions, without a pole.

The first component of a quaternion is its scalar part; the quaternion turns from the body to space.
Rates and rotations are those of ``ReferenceFrame.orient_quaternion`` in SymPy: polynomials without
sines.
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
from symsimpson.errors import ModelError, ModelWarning, reject
from symsimpson.support.array_types import Floats
from symsimpson.support.calling import explaining, warn

#: A quaternion or a rotation matrix may be off by so much.
ROUNDED = 1e-9
#: Moments are written in two digits or more.
WRITTEN = 1e-2


#: The quaternions of bodies that were made, and the names of these.
_made: dict[tuple[AppliedUndef, ...], str] = {}


def read_scalar(what: str, given: Any) -> sp.Expr:
    """Read a number or an expression; text is not evaluated.

    Raises ModelError if it is neither.
    """
    try:
        scalar = sp.sympify(given, strict=True)
    except (sp.SympifyError, AttributeError, TypeError):
        scalar = None
    if not isinstance(scalar, sp.Expr) or scalar.is_Matrix:
        reject(
            f"{what} is {given!r}, neither a number nor an expression.",
            remedy="Text is not evaluated. Write SymPy symbols and numbers without quotes.",
            error=ModelError,
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
        reject(
            f"the quaternion's name {name!r} is no name.",
            remedy="Write q = symsimpson.quaternion('q').",
            error=ModelError,
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
        reject(
            f"a point with {len(a)} components and one with {len(b)} cannot coincide.",
            remedy="Give both in the same space.",
            error=ModelError,
        )
    return [x - y for x, y in zip(a, b, strict=True)]


def read_components(point: Any) -> list[sp.Expr]:
    """Read the components of a point: a sequence or a matrix."""
    components = _listed(point)
    if components is None:
        reject(
            f"a point has components, and {point!r} has none.",
            remedy="Write them in a row: coincide((x, y), (1, 2)), or body.point((0, 0, 1)).",
            error=ModelError,
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
        reject(
            f"a quaternion has four components, and {q!r} has {len(parts) or 'none'}.",
            remedy="Make one: q = symsimpson.quaternion('q').",
            error=ModelError,
        )
    return parts


def warn_of_lengths(
    system: str, coordinates: Sequence[AppliedUndef], constraints: Sequence[sp.Expr]
) -> None:
    """Warn of quaternions of bodies whose length nothing holds."""
    held = {q for phi in constraints for q in sp.sympify(phi).atoms(AppliedUndef)}
    for quaternion_of, body in _made.items():
        if held.isdisjoint(quaternion_of) and {*quaternion_of} <= {*coordinates}:
            warn(
                f"system '{system}': nothing holds the quaternion of the body {body!r} at length "
                "1, so that it is stretched where the body turns.\nDeclare the system with "
                "constraints=[*body.constraints].",
                ModelWarning,
            )


@explaining(also=("__init__",))
class RigidBody:
    """A rigid body: coordinates, kinetic energy and the constraint of a unit quaternion.

    Without a mass it turns about a fixed point, the origin of space and of the body. With one it
    moves freely, and its origin is the centre of mass.

    Parameters
    ----------
    name : str
        Begins the names of its coordinates, ``<name>_q0`` to ``<name>_q3`` and, with a mass,
        ``<name>_x``, ``<name>_y``, ``<name>_z``.
    inertia : three expressions, or a symmetric 3 by 3 matrix
        Moments of inertia about the origin of the body, in axes of the body.
    mass : expression, optional
    fourth : expression, optional
        The inertia J0 of the length of the quaternion, T = (w.J.w + J0 w0^2)/2. The motion does
        not depend on it; the errors of a step hardly do. A third of the trace of J unless given.

    Raises
    ------
    ModelError
        If the inertia is no three moments and no symmetric matrix, or has a negative moment.

    Warns
    -----
    ModelWarning
        If a principal moment is greater than the sum of the other two, which no body has.

    Notes
    -----
    w = 2 conj(q) q' is the angular velocity in the body, and its scalar part w0 = 2 q.q' vanishes
    where q has length 1.

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
        _made[tuple(self.quaternion)] = name
        place = " ".join(f"{name}_{axis}" for axis in "xyz")
        self.position: tuple[AppliedUndef, ...] = coordinates(place) if mass is not None else ()
        self.inertia = _inertia(name, inertia)
        self.fourth = self.inertia.trace() / 3
        if fourth is not None:
            self.fourth = read_scalar(f"the fourth moment of {name!r}", fourth)

    def __repr__(self) -> str:
        return f"RigidBody({self.name!r})"

    @property
    def coordinates(self) -> tuple[AppliedUndef, ...]:
        """The quaternion, and after it the position of the centre of mass, if it moves."""
        return (*self.quaternion, *self.position)

    @cached_property
    def angular_velocity(self) -> sp.ImmutableDenseMatrix:
        """The angular velocity in the body, 3 by 1."""
        return body_rates(self.quaternion)

    @cached_property
    def rotation(self) -> sp.ImmutableDenseMatrix:
        """The matrix from the body to space, 3 by 3."""
        return rotation_matrix(self.quaternion)

    @cached_property
    def kinetic(self) -> sp.Expr:
        """The kinetic energy."""
        w = self.angular_velocity
        length = 2 * sum((q * q.diff() for q in self.quaternion), sp.S.Zero)
        turning = (w.T * self.inertia * w)[0] / 2 + self.fourth * length**2 / 2
        speed = sum((x.diff() ** 2 for x in self.position), sp.S.Zero)
        return turning + (sp.S.Zero if self.mass is None else self.mass * speed / 2)

    @property
    def constraints(self) -> tuple[sp.Expr, ...]:
        """That the quaternion has length one."""
        return ((sum((q**2 for q in self.quaternion), sp.S.Zero) - 1) / 2,)

    def to_space(self, vector: Sequence[Any]) -> sp.ImmutableDenseMatrix:
        """Return the components in space of a vector given in the body, 3 by 1."""
        components = read_components(vector)
        if len(components) != 3:
            reject(
                f"a vector in the body {self.name!r} has {len(components)} components, not three.",
                remedy="Write (x, y, z).",
                error=ModelError,
            )
        return sp.ImmutableDenseMatrix(self.rotation * sp.Matrix(components))

    def point(self, place: Sequence[Any]) -> sp.ImmutableDenseMatrix:
        """Return where in space a point of the body is, 3 by 1: for joints, potentials, drawings.

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
        """Return numbers to start from; the body is as in space unless one of the first is given.

        Parameters
        ----------
        angles : array_like, shape (3,), optional
            Euler angles (phi, theta, psi): turns about z, the new x, and the new z.
        rotation : array_like, shape (3, 3), optional
        quaternion : array_like, shape (4,), optional
        angular_velocity : array_like, shape (3,)
            In the body.
        position, velocity : array_like, shape (3,)
            Of the centre of mass, in space.

        Returns
        -------
        q0, v0 : ndarray, shape (4,) or (7,)

        Raises
        ------
        InputError
            If more than one of the first is given, or it is no rotation.
        """
        given = [x is not None for x in (angles, rotation, quaternion)]
        if sum(given) > 1:
            reject("angles, rotation and quaternion exclude one another.", remedy="Pass one.")
        if angles is not None:
            q = _from_angles(_numbers("angles", angles, (3,)))
        elif rotation is not None:
            q = _from_matrix(_numbers("rotation", rotation, (3, 3)))
        else:
            q = _numbers("quaternion", (1, 0, 0, 0) if quaternion is None else quaternion, (4,))
        size = float(np.linalg.norm(q))
        if not abs(size - 1) <= ROUNDED:
            reject(f"the quaternion has the length {size:.12g}, not 1.", remedy="Normalise it.")
        q = q / size
        w = np.concatenate([[0.0], _numbers("angular_velocity", angular_velocity, (3,))])
        turning = _product(q, w) / 2
        if self.mass is None:
            if np.any(position) or np.any(velocity):
                reject(
                    f"the body {self.name!r} turns about a fixed point, and has no position.",
                    remedy="Give it a mass, RigidBody(name, inertia, mass), to let it move.",
                )
            return q, turning
        place, speed = _numbers("position", position, (3,)), _numbers("velocity", velocity, (3,))
        return np.concatenate([q, place]), np.concatenate([turning, speed])


def _inertia(name: str, given: Any) -> sp.ImmutableDenseMatrix:
    try:
        parts = [] if isinstance(given, str) else given
        parts = parts.tolist() if hasattr(parts, "tolist") else list(parts)
        if len(parts) == 3 and not any(isinstance(x, (list, tuple)) for x in parts):
            parts = [[x if i == j else 0 for j in range(3)] for i, x in enumerate(parts)]
        what = f"an inertia of {name!r}"
        matrix = sp.ImmutableDenseMatrix([[read_scalar(what, x) for x in row] for row in parts])
        if matrix.shape == (3, 3) and matrix == matrix.T:
            least, excess = _moments(matrix)
            if least < 0 or any(moment.is_negative for moment in matrix.diagonal()):
                reject(
                    f"the body {name!r} has a moment of inertia that is negative.",
                    remedy="Moments are integrals of squares of distances: look at the signs.",
                    error=ModelError,
                )
            if excess > 0:
                warn(
                    f"a principal moment of inertia of {name!r} is greater than the sum of the "
                    "other two.\nNo masses have such moments, though the motion is computed: look "
                    "at the numbers, and at the axes and the point that they are about.",
                    ModelWarning,
                )
            return matrix
    except (TypeError, ValueError, sp.SympifyError):
        pass
    reject(
        f"the inertia of {name!r} is neither three moments nor a symmetric 3 by 3 matrix.",
        remedy="Write inertia=(I1, I2, I3).",
        error=ModelError,
    )


def _moments(matrix: sp.ImmutableDenseMatrix) -> tuple[float, float]:
    """Return the least principal moment, and what the greatest has above the sum of the others.

    Both are zero where they are rounding, and where moments are no numbers.
    """
    if not all(x.is_number and x.is_finite for x in matrix):
        return 0.0, 0.0
    first, second, third = np.linalg.eigvalsh(np.array(matrix, dtype=np.float64))
    excess, size = third - second - first, max(abs(first), third)
    return first if -first > ROUNDED * size else 0.0, excess if excess > WRITTEN * size else 0.0


def _numbers(name: str, given: ArrayLike, shape: tuple[int, ...]) -> Floats:
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        reject(f"{name} is {given!r}.", remedy=f"Pass finite numbers of shape {shape}.")
    return array


def _product(p: Floats, q: Floats) -> Floats:
    """Return the product of two quaternions."""
    scalar = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[scalar], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def _from_angles(angles: Floats) -> Floats:
    c, s = np.cos(angles / 2), np.sin(angles / 2)
    about_z = [np.array([c[k], 0.0, 0.0, s[k]]) for k in (0, 2)]
    return _product(_product(about_z[0], np.array([c[1], s[1], 0.0, 0.0])), about_z[1])


def _from_matrix(R: Floats) -> Floats:
    """Return the quaternion of a rotation, its largest component from the diagonal."""
    if not (np.abs(R @ R.T - np.eye(3)).max() <= ROUNDED and np.linalg.det(R) > 0):
        reject(
            "rotation is no matrix of a rotation: its rows are not orthonormal, or it mirrors.",
            remedy="Pass one with R R^T = 1 and det R = 1, or angles=(phi, theta, psi).",
        )
    K = np.array(
        [
            [R.trace(), R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0, R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
            [0, 0, R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1]],
            [0, 0, 0, R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    eigenvector: Floats = np.linalg.eigh(K, UPLO="U")[1][:, -1]
    return eigenvector if eigenvector[0] >= 0 else -eigenvector
