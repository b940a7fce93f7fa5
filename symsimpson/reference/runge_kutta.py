"""The compiled classical Runge-Kutta method of order four."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from symsimpson.reference.first_order import FirstOrder
from symsimpson.support.array_types import Floats


def rk4(
    equations: FirstOrder,
    y0: ArrayLike,
    *,
    h: float,
    steps: int,
    every: int = 1,
    parameters: Mapping[Any, float] | None = None,
) -> tuple[Floats, Floats]:
    """Integrate with the classical Runge-Kutta method of order four and a fixed step size.

    Parameters
    ----------
    equations : FirstOrder
        The differential equations.
    y0 : array_like, shape (m,)
        The state at t = 0.
    h : float
        The step size.
    steps : int
        The number of steps.
    every : int, default 1
        Store the states 0, every, 2 * every, ...
    parameters : mapping, optional
        Values of parameters by name that differ from the defaults of ``equations``.

    Returns
    -------
    t : ndarray, shape (steps // every + 1,)
        The times of the stored states.
    y : ndarray, shape (steps // every + 1, m)
        The stored states.

    Examples
    --------
    >>> import symsimpson as ss
    >>> from symsimpson.reference import canonical, rk4
    >>> t, y = rk4(canonical(ss.systems.harmonic_oscillator()), [1, 0], h=0.01, steps=100)
    >>> bool(abs(y[-1, 0] - 0.5403023058681398) < 1e-10)
    True
    """
    m = len(equations.unknowns)
    start = np.array(y0, dtype=np.float64)
    if start.shape != (m,):
        raise ValueError(f"y0 has shape {start.shape}, expected ({m},).")
    if steps < 0 or every < 1:
        raise ValueError(f"steps is {steps} and every is {every}. Pass steps >= 0 and every >= 1.")
    values = np.array([float(x) for x in equations.values(parameters)])
    out = np.empty((steps // every + 1, m))
    compiled_rk4(equations)(start, values, float(h), steps, every, out)
    return h * np.arange(0, steps + 1, every, dtype=np.float64), out


#: Compiled functions by the equations that define them.
_COMPILED: dict[tuple[Any, ...], Callable[..., Any]] = {}


def compiled_rates(equations: FirstOrder) -> Callable[..., Any]:
    """Compile f as a numba function (y, parameters, out) that writes f(y) to ``out``."""
    key = (equations.unknowns, equations.definitions, equations.rates, *equations.parameters)
    if key not in _COMPILED:
        from numba import njit

        names = {"rates": njit(equations.function("math"))}
        arguments = [f"y[{i}]" for i in range(len(equations.unknowns))]
        arguments += [f"p[{i}]" for i in range(len(equations.parameters))]
        text = f"def f(y, p, out):\n    values = rates({', '.join(arguments)})\n"
        text += "".join(f"    out[{i}] = values[{i}]\n" for i in range(len(equations.rates)))
        exec(text, names)  # safe: the text contains only indices
        _COMPILED[key] = njit(names["f"])
    return _COMPILED[key]


def compiled_rk4(equations: FirstOrder) -> Callable[..., Any]:
    """Compile the method as a numba function (y, parameters, h, steps, every, out).

    It writes the stored states to ``out``, shape (steps // every + 1, m), and changes y.
    """
    return _make_rk4(compiled_rates(equations))


@cache
def _make_rk4(f: Callable[..., None]) -> Callable[..., Any]:
    """Return the compiled loop over steps for a compiled f."""
    from numba import njit

    @njit
    def loop(y, p, h, steps, every, out):  # type: ignore[no-untyped-def]
        k1, k2, k3, k4 = np.empty_like(y), np.empty_like(y), np.empty_like(y), np.empty_like(y)
        stage = np.empty_like(y)
        out[0] = y
        for step in range(1, steps + 1):
            f(y, p, k1)
            for i in range(y.size):
                stage[i] = y[i] + 0.5 * h * k1[i]
            f(stage, p, k2)
            for i in range(y.size):
                stage[i] = y[i] + 0.5 * h * k2[i]
            f(stage, p, k3)
            for i in range(y.size):
                stage[i] = y[i] + h * k3[i]
            f(stage, p, k4)
            for i in range(y.size):
                y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
            if step % every == 0:
                out[step // every] = y

    return loop
