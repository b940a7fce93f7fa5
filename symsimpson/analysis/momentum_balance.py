"""Balance of the momenta of symmetries under forces: Noether's theorem with forces, in a step."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import sympy as sp

from symsimpson.analysis.subject import Subject
from symsimpson.analysis.symmetries import Symmetry, linear_symmetries
from symsimpson.derivatives.step_equations import At, evaluate_equations
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.reference.first_order import Lines
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.array_types import Reals

__all__ = ["momentum_balance"]

#: So many steps are looked at, and so often Newton's method corrects each.
STEPS, ITERATIONS = 5, 8


def momentum_balance(s: Subject) -> tuple[float, list[Symmetry]]:
    """Measure p1.xi(q1) - p0.xi(q0) less h sum_i b_i f_i.xi(q_i), relative to p.xi.

    It vanishes for each linear symmetry xi of L (J. E. Marsden and M. West, Discrete mechanics and
    variational integrators, section 3.2.4). The symmetries are returned, too: none where L is not
    known, or depends on the time.
    """
    system, header = s.stepper.program.declared, s.stepper.program.header
    if system is None or header.conformal or "equations" not in header.functions:
        return 0.0, []
    plain = system.plain
    if any(plain.time in plain.graph.nodes[n].symbols for _, n in plain.energies):
        return 0.0, []
    symmetries = linear_symmetries(s.precise, s.z)
    scheme, force = read_scheme(s.stepper.scheme), _force(system)
    given = (*s.precise.parameters.values(), *(s.stepper.program.default_inputs or {}).values())
    values = [s.precise.context.mpf(x) for x in given]
    worst = 0.0
    for j in range(STEPS if symmetries else 0):
        q, v, t = _nodes(s, scheme, j)
        with mpmath.workdps(s.precise.context.dps):  # the functions of SymPy's text are global
            f = [force(*q[i], *v[i], *values, t[i]) for i in range(scheme.stages)]
        # as numbers of the context, which keep their digits here
        forces = np.array([[s.precise.context.convert(x) for x in row] for row in f], dtype=object)
        b = [_number(s, x) for x in scheme.quadrature.weights]
        ends = s.path.q[j : j + 2], s.path.p[j : j + 2]
        for symmetry in symmetries:
            before, after = symmetry.momentum(*ends)
            rates = symmetry.momentum(q, forces)
            change = s.h * sum(x * y for x, y in zip(b, rates, strict=True))
            size = symmetry.size(*ends) or 1.0
            worst = max(worst, abs(float(after - before - change)) / size)
    return worst, symmetries


def _force(system: MechanicalSystem) -> Any:
    """Return the forces as a function of q, v, parameters, inputs and t, in many digits."""
    plain = system.plain
    lines = Lines(plain, {("f", i): f for i, f in enumerate(plain.f)})
    return lines.function((*plain.q, *plain.v), "mpmath")


def _nodes(s: Subject, scheme: Scheme, j: int) -> tuple[Reals, Reals, Reals]:
    """Solve the equations of a step once more; return q, v and t at its nodes."""
    context, d, n = s.precise.context, scheme.degree, s.n
    m = len(s.precise.program.header.constraints)
    pulls = np.array([context.mpf(0)] * d * m, dtype=object).reshape(d, m) if m else None
    q, p, t = s.path.q[j], s.path.p[j], j * context.mpf(s.h)
    share = np.array([context.mpf(k) / d for k in range(1, d + 1)])
    points = q + share[:, None] * (s.path.q[j + 1] - q)
    for _ in range(ITERATIONS):
        at = At(q, points, s.h, s.precise.parameters, t, multipliers=pulls)
        left, slope = evaluate_equations(s.precise.program, at, p)
        solved = context.lu_solve(context.matrix(slope.tolist()), context.matrix(left.tolist()))
        change = np.array(list(solved), dtype=object)
        points = points - change[: d * n].reshape(d, n)
        pulls = None if pulls is None else pulls - change[d * n :].reshape(d, m)
    moved = points - q

    def combined(table: Any) -> Reals:
        rows = [[_number(s, x) for x in row[1:]] for row in table]
        return np.array(rows, dtype=object) @ moved

    c = np.array([_number(s, x) for x in scheme.quadrature.nodes], dtype=object)
    return q + combined(scheme.A), combined(scheme.B) / s.h, t + c * s.h


def _number(s: Subject, exact: sp.Expr) -> Any:
    return s.precise.context.mpf(str(sp.N(exact, s.precise.context.dps + 5)))
