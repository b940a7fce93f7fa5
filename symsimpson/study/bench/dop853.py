"""DOP853, an explicit Runge-Kutta method of order 8, compiled for one right-hand side."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

#: Steps of compiled loops between two checks for Ctrl-C.
PIECE = 8192


@cache
def make_dop853(f: Callable[..., None]) -> Callable[..., Any]:
    """Compile the method of Dormand and Prince of order 8 for f(y, parameters, out).

    The compiled function takes at most PIECE steps. It returns 0 before the final
    time, -1 if the step size is too small, and otherwise the number of evaluations. Its last
    argument stores t, h, whether the last step was rejected, and the number of evaluations. All
    are 0 initially.

    The coefficients are SciPy's. The step size control follows Hairer, Norsett and Wanner,
    Solving Ordinary Differential Equations I, sections II.4 and II.10.
    """
    from numba import njit
    from scipy.integrate import DOP853

    A = np.array(DOP853.A, dtype=np.float64)
    B = np.array(DOP853.B, dtype=np.float64)
    E3, E5 = np.array(DOP853.E3), np.array(DOP853.E5)
    stages = DOP853.n_stages

    @njit
    def dop853(y, parameters, t_end, tolerance, progress):  # type: ignore[no-untyped-def]
        m = y.size
        K = np.empty((stages + 1, m))
        x, new = np.empty(m), np.empty(m)
        f(y, parameters, K[0])
        t, h, rejected, evaluations = progress[0], progress[1], progress[2] > 0, int(progress[3])
        size, slope = 0.0, 0.0
        for i in range(m):
            scale = tolerance + tolerance * abs(y[i])
            size += (y[i] / scale) ** 2
            slope += (K[0, i] / scale) ** 2
        if evaluations == 0:
            h = 0.01 * np.sqrt(size / slope) if slope > 0.0 and size > 0.0 else 1e-6
            evaluations = 1
        for _ in range(PIECE):
            if t >= t_end:
                return evaluations
            h = min(h, t_end - t)
            if t + h == t:
                return -1
            for s in range(1, stages):
                for i in range(m):
                    total = 0.0
                    for j in range(s):
                        total += A[s, j] * K[j, i]
                    x[i] = y[i] + h * total
                f(x, parameters, K[s])
            for i in range(m):
                total = 0.0
                for j in range(stages):
                    total += B[j] * K[j, i]
                new[i] = y[i] + h * total
            f(new, parameters, K[stages])
            evaluations += stages
            fifth, third = 0.0, 0.0
            for i in range(m):
                scale = tolerance + tolerance * max(abs(y[i]), abs(new[i]))
                e5, e3 = 0.0, 0.0
                for j in range(stages + 1):
                    e5 += E5[j] * K[j, i]
                    e3 += E3[j] * K[j, i]
                fifth += (e5 / scale) ** 2
                third += (e3 / scale) ** 2
            denominator = fifth + 0.01 * third
            error = abs(h) * fifth / np.sqrt(denominator * m) if denominator > 0.0 else 0.0
            if error < 1.0:
                t += h
                for i in range(m):
                    y[i] = new[i]
                    K[0, i] = K[stages, i]
                factor = 10.0 if error == 0.0 else min(10.0, 0.9 * error ** (-0.125))
                h *= min(1.0, factor) if rejected else factor
                rejected = False
            else:
                h *= max(0.2, 0.9 * error ** (-0.125))
                rejected = True
        progress[0], progress[1], progress[2], progress[3] = t, h, rejected, evaluations
        return 0

    return dop853
