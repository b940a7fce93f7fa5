"""The fastest linear oscillation at a state, and the steps that a scheme takes of it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Hashable, Iterable
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from symsimpson.analysis.stability.limits import theory_limits
from symsimpson.errors import StabilityWarning
from symsimpson.graph.derive import Derivatives
from symsimpson.graph.nodes import Value
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.reference.first_order import Lines
from symsimpson.schemes.named import read_scheme

if TYPE_CHECKING:
    from symsimpson.runtime.stepper import Stepper

__all__ = ["largest_frequency", "largest_stable", "warn_of_step"]

#: Limits beyond this are as good as none.
LARGEST = 12.0
#: The Hessian of larger systems takes too long for a warning.
MOST_COORDINATES = 12
#: Smaller steps than this, times the frequency, are stable with every scheme.
ALWAYS_STABLE = 1.5


def largest_frequency(
    system: MechanicalSystem, q: Iterable[float], parameters: Iterable[float], t: float = 0.0
) -> float:
    """Return the largest omega of K x = omega^2 M x, K the Hessian of V at q.

    It is 0 if none is positive, or K or M have no value there.

    Parameters
    ----------
    system : MechanicalSystem
    q : iterable of float, n of them
    parameters : iterable of float
        Values of all parameters, in the order of the system.
    t : float
    """
    try:
        stiffness, mass = map(np.array, _matrices(system)(*map(float, (*q, *parameters, t))))
        squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return 0.0
    return math.sqrt(max(0.0, float(squares.max())))


@lru_cache(maxsize=64)
def _matrices(system: MechanicalSystem) -> Callable[..., Any]:
    """Return a function of q, the parameters and t for (K, M)."""
    plain = system.plain
    graph, q = plain.graph, plain.numbers(plain.q)
    derivatives = Derivatives(graph)
    slopes = [derivatives(plain.V, x) for x in q]
    entries = [derivatives(slope, x) for slope in slopes for x in q]
    masses = [plain.entry(i, j) for i in range(len(q)) for j in range(len(q))]
    outputs: dict[tuple[Hashable, ...], Value] = {("K", k): x for k, x in enumerate(entries)}
    outputs |= {("M", k): x for k, x in enumerate(masses)}
    lines, places = Lines(plain, outputs), range(len(entries))
    function: Callable[..., Any] = sp.lambdify(
        [*plain.q, *plain.parameters, plain.t],
        [lines.value(name, k) for name in "KM" for k in places],
        modules="math", cse=lambda expressions: (lines.early, expressions),
    )  # fmt: skip
    return lambda *numbers: np.array(function(*numbers)).reshape(2, len(q), len(q))


@cache
def largest_stable(scheme: str) -> float:
    """Return h omega up to which a scheme is stable for a linear oscillator; inf if for all."""
    if read_scheme(scheme).unbounded:
        return math.inf
    edges = theory_limits(scheme, LARGEST)
    return edges[0] if edges else math.inf


def warn_of_step(
    stepper: Stepper,
    system: MechanicalSystem,
    q: Iterable[float],
    values: Iterable[float],
    h: float,
    t: float,
) -> None:
    """Warn of a step beyond the linear-stability limit at the start."""
    if system.n > MOST_COORDINATES:
        return
    omega = largest_frequency(system, q, values, t)
    if abs(h) * omega < ALWAYS_STABLE:
        return
    limit = largest_stable(stepper.scheme)
    if abs(h) * omega > limit:
        warnings.warn(
            f"{stepper.system}, {stepper.scheme}: h={h:g} is beyond the limit of linear stability. "
            f"The fastest oscillation at the start has omega={omega:.4g}; h omega is "
            f"{abs(h) * omega:.3g}, and from {limit:.3g} on oscillations may grow.\n"
            f"Take h below {limit / omega:.3g}, or a Gauss scheme ('midpoint', 'gauss8'), which no "
            "step makes grow.",
            StabilityWarning,
            stacklevel=6,  # where integrate is called
        )
