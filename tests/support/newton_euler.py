"""Accelerations of a serial arm by the recursive Newton-Euler method, in numbers alone.

Luh, Walker and Paul 1980: velocities and accelerations outward, forces and moments inward.
Nothing here uses the package but the numbers of its links.
"""

import numpy as np


def frames(links, q):
    """Rotation from each link to the one before, and the shift in the frame before."""
    found = []
    for link, x in zip(links, q, strict=True):
        angle = link.theta + x
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(link.alpha), np.sin(link.alpha)
        rotation = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0, sa, ca]], dtype=float)
        found.append((rotation, np.array([link.a * c, link.a * s, link.d], dtype=float)))
    return found


def torques(links, q, v, acceleration, gravity):
    """Moments that the joints must give for a motion."""
    z = np.array([0.0, 0.0, 1.0])
    omega, alpha, linear = np.zeros(3), np.zeros(3), -np.asarray(gravity, dtype=float)
    outward = []
    placed = frames(links, q)
    for link, (rotation, shift), u, w in zip(links, placed, v, acceleration, strict=True):
        alpha = rotation.T @ (alpha + z * w + np.cross(omega, z * u))
        omega = rotation.T @ (omega + z * u)
        own = rotation.T @ shift
        linear = rotation.T @ linear + np.cross(alpha, own) + np.cross(omega, np.cross(omega, own))
        centre = np.array(link.centre, dtype=float)
        at_centre = linear + np.cross(alpha, centre) + np.cross(omega, np.cross(omega, centre))
        inertia = np.diag(np.array(link.inertia, dtype=float))
        force = link.mass * at_centre
        moment = inertia @ alpha + np.cross(omega, inertia @ omega)
        outward.append((force, moment, own, centre))
    found = np.zeros(len(links))
    force, moment = np.zeros(3), np.zeros(3)
    for k in reversed(range(len(links))):
        own_force, own_moment, own, centre = outward[k]
        if k + 1 < len(links):
            next_rotation = placed[k + 1][0]
            force, moment = next_rotation @ force, next_rotation @ moment
        moment = moment + np.cross(own, force) + np.cross(own + centre, own_force) + own_moment
        force = force + own_force
        found[k] = (placed[k][0].T @ z) @ moment + links[k].rotor * acceleration[k]
    return found


def accelerations(links, q, v, gravity):
    """Accelerations of an arm without moments at its joints."""
    n = len(links)
    bias = torques(links, q, v, np.zeros(n), gravity)
    zero = np.zeros(n)
    still = torques(links, q, zero, zero, (0, 0, 0))
    columns = [torques(links, q, zero, row, (0, 0, 0)) - still for row in np.eye(n)]
    return np.linalg.solve(np.array(columns).T, -bias)
