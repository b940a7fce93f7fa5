"""Orientations as numbers: unit quaternions from Euler angles or rotation matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.errors import reject
from symsimpson.support.array_types import Floats

#: Largest error of the length of a quaternion, or of the rows of a rotation matrix.
ROUNDED = 1e-9


def read_array(name: str, given: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Check that an argument is an array of finite numbers of this shape."""
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        reject(f"{name} is {given!r}.", remedy=f"Pass finite numbers of shape {shape}.")
    return array


def read_orientation(
    angles: ArrayLike | None, rotation: ArrayLike | None, quaternion: ArrayLike | None
) -> Floats:
    """Return the unit quaternion of an orientation, from the argument that is not None."""
    if sum(x is not None for x in (angles, rotation, quaternion)) > 1:
        reject("angles, rotation and quaternion exclude one another.", remedy="Pass one of them.")
    if angles is not None:
        q = _from_angles(read_array("angles", angles, (3,)))
    elif rotation is not None:
        q = _from_matrix(read_array("rotation", rotation, (3, 3)))
    else:
        q = read_array("quaternion", (1, 0, 0, 0) if quaternion is None else quaternion, (4,))
    length = float(np.linalg.norm(q))
    if not abs(length - 1) <= ROUNDED:
        reject(
            f"the quaternion has the length {length:.12g}, not 1.",
            remedy="Divide it by its length.",
        )
    return q / length


def multiply(p: Floats, q: Floats) -> Floats:
    """Return the product of two quaternions, scalar parts first."""
    scalar = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[scalar], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def _from_angles(angles: Floats) -> Floats:
    """Return the quaternion of turns about z, the new x and the new z."""
    c, s = np.cos(angles / 2), np.sin(angles / 2)
    about_z = [np.array([c[k], 0.0, 0.0, s[k]]) for k in (0, 2)]
    return multiply(multiply(about_z[0], np.array([c[1], s[1], 0.0, 0.0])), about_z[1])


def _from_matrix(R: Floats) -> Floats:
    """Return the quaternion of a rotation matrix, with a scalar part that is not negative."""
    if not (np.abs(R @ R.T - np.eye(3)).max() <= ROUNDED and np.linalg.det(R) > 0):
        reject(
            "rotation is not a rotation matrix: its rows are not orthonormal, or it mirrors.",
            remedy="Pass a matrix with R R^T = 1 and det R = 1, or angles=(phi, theta, psi).",
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
