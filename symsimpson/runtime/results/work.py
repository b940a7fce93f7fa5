"""The work of forces along a run, and what the energy differs by from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from symsimpson.errors import InputError
from symsimpson.runtime.evaluator import evaluate
from symsimpson.runtime.runs.driving import at_places
from symsimpson.runtime.runs.run import workspace

if TYPE_CHECKING:
    from symsimpson.runtime.results.energies import Energies

__all__ = ["TOTAL", "integrals", "powers"]

#: The name of the sum of all forces.
TOTAL = "total"
Reals = NDArray[Any]


def powers(run: Energies) -> dict[str, Reals]:
    """Return the power of each force at the stored states, and of all."""
    header = run._stepper._module.header
    if header.conservative:
        return {TOTAL: 0 * run.t}
    found = evaluate(
        run._stepper, "power", "POWER", header.powers, run.t, run.q, run.p, run._values,
        _at_states(run),
    )  # fmt: skip
    return _named(run, found)


def _at_states(run: Energies) -> Reals:
    """Return the inputs at stored states, which stand in the places of steps."""
    numbers = run._stepper._module.numbers
    last = max(run.steps - 1, 0)
    number = np.arange(len(run)) * run.every if run.every else np.array([run.steps])
    ended = number > last
    with numbers.working():
        inputs = numbers.read(run._inputs)
        place = numbers.read(ended.astype(int))[:, None]
        return at_places(run._stepper, inputs, np.minimum(number, last), place)


def _named(run: Energies, found: Reals) -> dict[str, Reals]:
    """Name the columns of forces, and add them up."""
    names = run._stepper._names.forces.shown
    own = {name: found[:, k] for k, name in enumerate(names)}
    return own | {TOTAL: sum(own.values(), 0 * run.t)}


def integrals(run: Energies) -> tuple[dict[str, Reals], Reals]:
    """Return the work of each force and of all, and the integral of dL/dt, up to stored states.

    Each step is taken again: work is the integral h sum_i b_i f_i.v_i of the scheme, of its order.

    Raises
    ------
    InputError
        If only the last state is stored, the scheme is explicit, or a step cannot be taken again.
    """
    stepper, header = run._stepper, run._stepper._module.header
    numbers, kernels = stepper._module.numbers, stepper._module.kernels
    if header.conservative:
        return {TOTAL: 0 * run.t}, 0 * run.t
    if run.every is None:
        raise InputError(
            "a run that keeps its last state alone (every=None) does not tell what work was done."
            "\nStore states on the way: every=1, or every=100."
        )
    if "work" not in header.functions:
        raise InputError(
            f"{stepper.scheme} is explicit: its steps have no nodes at which forces do work.\n"
            "Integrate with a scheme of the family, as 'simpson' or 'gauss8'."
        )
    with numbers.working():
        W = workspace(header, numbers, numbers.read(run._values))
        out = numbers.zeros((len(run), header.powers))
        t, q, p, h = map(numbers.read, (run.t, run.q, run.p, run.h))
        reached = numbers.driver("add_up_work")(
            kernels.set("newton"), kernels.address("work"), h.item(), t, W,
            header.told, q, p, run.every, header.layout["WORK"], out, numbers.read(run._inputs),
        )  # fmt: skip
        found = numbers.result(out)
    if reached < len(run):
        raise InputError(
            f"{stepper.system}: the step to t = {float(run.t[reached]):g} could not be taken again "
            "to add up work: it is one that the run took with more robust kernels.\nTake a smaller "
            "step."
        )
    lost = 0 * run.t if header.autonomous else found[:, -1]
    return _named(run, found), lost
