"""First integrals of a system, and the motions that they generate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from symsimpson.api.stepper import Stepper
from symsimpson.study.analysis.discrete_flow import DiscreteFlow
from symsimpson.study.analysis.subject import SYMMETRY_DIGITS
from symsimpson.study.analysis.symmetries import Symmetry, linear_symmetries
from symsimpson.study.orbits.conditions import Closing
from symsimpson.study.orbits.flow import Flow, scale_of, turned
from symsimpson.support.array_types import Floats

#: Gradients of unit length are independent if their least singular value exceeds this.
INDEPENDENT = 1e-6
#: Sizes of the region in which symmetries are searched for, relative to the state.
WIDER = (1, 64, 4096)


@dataclass(frozen=True)
class Integrals:
    """The energy, if it is constant, and the momenta of linear symmetries."""

    energy: bool
    symmetries: tuple[Symmetry, ...]
    #: Whether the time may be shifted: nothing depends on it, and no event fixes it.
    timeless: bool

    @property
    def count(self) -> int:
        """Number of first integrals."""
        return self.energy + len(self.symmetries)

    def gradients(self, flow: Flow, z: Floats, values: Floats) -> Floats:
        """Return the gradients by (q, p), shape (count, 2 n)."""
        q, p = np.split(z, 2)
        rows = [flow.energy_gradient(z, values)] if self.energy else []
        rows += [np.concatenate([p @ x.A, x.A @ q + x.b]) for x in self.symmetries]
        return np.array(rows).reshape(-1, len(z))

    def fields(self, flow: Flow, z: Floats, values: Floats, moved: Floats) -> Floats:
        """Return the directions along which an orbit stays an orbit, one in each row.

        ``moved`` is the derivative of the state by the time, which a damped system has, too.
        """
        fields = turned(self.gradients(flow, z, values))
        if self.timeless and not self.energy:
            fields = np.concatenate([moved[None], fields])
        return fields


def find_integrals(stepper: Stepper, flow: Flow, closing: Closing, z: Floats) -> Integrals:
    """Find the first integrals that the closing of an orbit does not break."""
    header = stepper.program.header
    timeless = header.autonomous and not flow.to_event
    if not header.conservative or flow.to_event or not header.autonomous:
        return Integrals(False, (), timeless)
    symmetries: list[Symmetry] = []
    scale = scale_of(z[None])
    if not header.retimed:
        names = stepper.program.names.parameters.shown
        values = dict(zip(names, flow.spec.parameters.tolist(), strict=True))
        exact = DiscreteFlow(stepper, values, SYMMETRY_DIGITS)
        point = np.array([exact.context.mpf(x) for x in z.tolist()], dtype=object)
        for factor in WIDER:
            powers = np.round(np.log2(scale * factor)).astype(int).tolist()
            exact.sizes = np.array([exact.context.ldexp(1, x) for x in powers], dtype=object)
            try:
                symmetries = linear_symmetries(exact, point)
                break
            except ArithmeticError:  # at a small amplitude, the system is nearly linear
                continue
    R = closing.R
    kept = [x for x in symmetries if np.allclose(R @ x.A, x.A @ R) and np.allclose(R @ x.b, x.b)]
    independent = Integrals(True, (), timeless)
    for symmetry in kept:  # at rest, momenta of different symmetries may have the same gradient
        more = replace(independent, symmetries=(*independent.symmetries, symmetry))
        rows = more.gradients(flow, z, flow.spec.parameters) * scale
        sizes = np.linalg.norm(rows, axis=1, keepdims=True)
        if sizes.all() and np.linalg.svd(rows / sizes, compute_uv=False)[-1] > INDEPENDENT:
            independent = more
    return independent
