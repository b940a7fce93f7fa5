"""An initial value problem that several programs solve, and its solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

from symsimpson.api.compiling import compile as compile_system
from symsimpson.api.stepper import Stepper
from symsimpson.declare.retimed import RetimedSystem
from symsimpson.declare.system import MechanicalSystem
from symsimpson.errors import InputError
from symsimpson.reference import FirstOrder, canonical, second_order, truth
from symsimpson.study.analysis.pilot import choose_state
from symsimpson.support.array_types import Floats

#: Decimal digits of the reference solution.
DIGITS = 20


@dataclass(frozen=True, eq=False)
class Problem:
    """An initial value problem of a system, with a reference solution at ``t_end``."""

    system: MechanicalSystem
    #: Each of shape (n,).
    q0: Floats
    v0: Floats
    p0: Floats
    t_end: float
    #: The equations of motion in (q, p) and in (q, v), for those who need first order.
    canonical: FirstOrder
    second_order: FirstOrder
    solution: Floats  #: q and p at ``t_end``, shape (2 n,).
    solution_error: float  #: An estimate of its error, in units of ``scale``.
    #: Errors are divided by these sizes: the largest value of each coordinate, at least 1 or the
    #: largest coordinate if that is smaller; the largest momentum. Shape (2 n,).
    scale: Floats
    #: The same motion in another time, if schemes are to run in that, too.
    retimed: RetimedSystem | None = None

    def error(self, q: Any, p: Any) -> float:
        """Return the largest error of a state at ``t_end``, in units of ``scale``."""
        difference = np.concatenate([q, p]) - self.solution
        largest = float(np.abs(difference / self.scale).max())
        return largest if np.isfinite(largest) else float("inf")

    def momentum(self, stepper: Stepper, q: Any, v: Any) -> Floats:
        """Return p of a state in (q, v), NaN for a peer that failed."""
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            return np.full(len(self.q0), np.nan)
        momentum: Floats = stepper.integrate(q, v0=v, h=1.0, steps=0).p[0]
        return momentum


def make_problem(
    system: MechanicalSystem, state: Mapping[str, Any] | None, t_end: float
) -> Problem:
    """Solve a problem in many digits, with an estimate of the error.

    Raises InputError if there is no state to start from; ArithmeticError if the solution has a
    singularity before ``t_end``.
    """
    retimed = system if isinstance(system, RetimedSystem) else None
    system = system if retimed is None else retimed.original
    stepper = compile_system(system, "simpson")
    q, p = choose_state(stepper, state, stepper.program.named_values())
    if system.constraints:
        raise InputError(
            f"{system.name} has constraints, which the other programs do not keep to: their states "
            "could not be measured.\nCompare in coordinates without, or schemes among themselves: "
            "ss.choose."
        )
    in_momenta, in_velocities = canonical(system), second_order(system)
    start = in_momenta.state([mpmath.mpf(float(x)) for x in (*q, *p)])
    samples = [mpmath.mpf(t_end) * k / 8 for k in range(1, 9)]
    solution = truth(in_momenta, start, samples, digits=DIGITS)
    n = system.n
    path = np.array([[float(x) for x in y[: 2 * n]] for y in solution.y])
    largest = np.abs(np.vstack([np.concatenate([q, p]), path])).max(axis=0)
    least = min(1.0, largest[:n].max() or 1.0)
    scale = np.concatenate([np.maximum(largest[:n], least), np.full(n, largest[n:].max() or 1.0)])
    rates = in_momenta.function("math")(*in_momenta.state(q, p), *in_momenta.values(None))
    return Problem(
        system,
        q,
        np.array(rates[:n], dtype=np.float64),
        p,
        float(t_end),
        in_momenta,
        in_velocities,
        path[-1],
        float(np.max(np.array(solution.errors, dtype=np.float64)[..., : 2 * n] / scale)),
        scale,
        retimed,
    )
