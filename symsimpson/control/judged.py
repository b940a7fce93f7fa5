"""Judgement of what a solver came to: whether it is a motion of the system, what is off most."""

from __future__ import annotations

import numpy as np

from symsimpson.control.between_nodes import balanced
from symsimpson.control.constraint_rows import resolved
from symsimpson.control.control_status import STATUSES, ControlStatus
from symsimpson.control.ipopt import Outcome
from symsimpson.control.layout import Layout
from symsimpson.control.masses import massive
from symsimpson.control.result import FOUND, ControlResult
from symsimpson.control.scaling import violations

__all__ = ["result_of"]


def result_of(layout: Layout, outcome: Outcome, best: bool) -> ControlResult:
    """Return what a solver came to, and whether it is an optimum by its multipliers."""
    x, off = outcome.x, violations(layout, outcome.x)
    cost, _ = layout.programme[0].values(x)
    worst = int(np.argmax(off)) if off.size else 0
    status = STATUSES.get(outcome.ipopt_status, ControlStatus.RESTORATION_FAILED)
    known = layout.parameter_values(x)
    if status in FOUND and not massive(layout, x):
        status = ControlStatus.NO_MASS
    elif status in FOUND and not (resolved(layout, x, known) and balanced(layout, x)):
        status = ControlStatus.NOT_RESOLVED
    elif status in FOUND and not best:
        status = ControlStatus.NOT_OPTIMAL
    name, violation = (layout.names[worst], off[worst]) if off.size else ("", 0.0)
    if np.isfinite(violation) and not np.isfinite(cost):
        name, violation = "cost", np.nan
    return ControlResult(
        layout,
        x,
        outcome.multipliers,
        cost,
        status,
        outcome.iterations,
        outcome.seconds,
        outcome.in_functions,
        float(violation),
        name,
        outcome.history,
    )
