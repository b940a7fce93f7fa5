"""Motions with constraints by another way: M v' + Phi^T lambda = ..., Phi v' = -v.phi_qq.v.

Written down from T, V and phi by SymPy in the textbook way, and solved by SciPy: nothing of a
step is in it.
"""

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp


def index_one(system):
    """Return (q, v, t) -> (v', lambda) of a declared system, with its parameters' values."""
    q = list(system.coordinates)
    n, v = len(q), [x.diff() for x in q]
    plain_q, plain_v = sp.symbols(f"q:{n}"), sp.symbols(f"v:{n}")
    plain = dict(zip(v, plain_v, strict=True)) | dict(zip(q, plain_q, strict=True))
    given = {a: sp.Float(x, 20) for a, x in system.parameters.items()}
    L = system.lagrangian.xreplace(given).subs(plain)
    phi = sp.Matrix([x.xreplace(given) for x in system.constraints.values()]).subs(plain)
    momenta = sp.Matrix([L.diff(x) for x in plain_v])
    M, slopes = momenta.jacobian(plain_v), phi.jacobian(plain_q)
    push = sp.Matrix([L.diff(x) for x in plain_q]) - momenta.jacobian(plain_q) * sp.Matrix(plain_v)
    rates = slopes * sp.Matrix(plain_v)
    bend = rates.jacobian(plain_q) * sp.Matrix(plain_v)
    numbers = sp.lambdify([plain_q, plain_v], [M, slopes, push, bend, phi], "numpy", cse=True)

    def accelerations(position, velocity):
        mass, Phi, right, curve, _ = numbers(position, velocity)
        m = len(Phi)
        matrix = np.block([[mass, Phi.T], [Phi, np.zeros((m, m))]])
        solution = np.linalg.solve(matrix, np.concatenate([right[:, 0], -curve[:, 0]]))
        return solution[:n], solution[n:]

    return accelerations


def motion(system, q, v, times, method="DOP853", tolerance=1e-12):
    """Integrate; returns states (q, v) at times, shape (len(times), 2 n)."""
    accelerations, n = index_one(system), len(q)
    return solve_ivp(
        lambda t, y: np.concatenate([y[n:], accelerations(y[:n], y[n:])[0]]),
        (0.0, times[-1]),
        [*q, *v],
        method=method,
        rtol=tolerance,
        atol=tolerance * 1e-1,
        t_eval=times,
    ).y.T
