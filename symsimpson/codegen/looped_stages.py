"""The iteration over velocities and forces at the nodes, of systems that are loops.

It is that of :mod:`symsimpson.codegen.stages`, node by node, for a constant M. With 60 coordinates
that all meet Newton's method takes ten to fifty times as long; but it does not where its matrix is
a band, nor where M would have to be factorised at each node (30 coupled pendulums).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from symsimpson.codegen.ir import Call, IfActive, Kernel, Loop
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.stages import NODES_AS_VECTOR
from symsimpson.codegen.storage import node_stride
from symsimpson.codegen.unrolled import lanes

__all__ = ["LoopedStages"]

_HERE = ("W", "node", "lane")
_ENTER = Call("enter_node", _HERE)


@dataclass(frozen=True)
class LoopedStages:
    """Makes the kernels start_stages, iterate and advance_stages, for a constant M.

    Its factors stand where the start of a run left them.
    """

    low: Lowering
    loops: LoopKernels

    @property
    def stride(self) -> int:
        """Rows of a value that all nodes have."""
        return node_stride(self.low.equations.scheme)

    @property
    def sizes(self) -> dict[str, Any]:
        """Return numbers that the sizes of blocks of stages follow from."""
        return {"staged": self.stride, "staged_by_loops": True}

    @property
    def constants(self) -> tuple[Call, ...]:
        """Return what is done once a run."""
        return (Call("stage_constants", ("W", "h", "lane")),)

    @property
    def kernels(self) -> list[Kernel]:
        """The kernels of a step."""
        return [self._start(), self._iterate(), self._advance()]

    def _start(self) -> Kernel:
        body = (*self.loops.before_state(), Call("begin_stages"))
        doc = "Begin at (q, p): the same velocity at all nodes."
        return Kernel("start_stages", doc, lanes(body))

    def _iterate(self) -> Kernel:
        """One iteration: positions, forces; momenta, velocities."""
        time = self.loops.time_at_node()
        nodes = "range(NODES)" if time else NODES_AS_VECTOR
        # M v = p - a: a has one place for all nodes, and all forces are asked for before
        gyroscopic = self.low.equations.system.structure.gyroscopic
        again = (_ENTER, *time, Call("gyroscopic")) if gyroscopic else ()
        solved = nodes if again else NODES_AS_VECTOR
        body = (
            Call("sum_stages", ("W", "STAGE_Q", "STAGE_MU", "STAGE_V", "lane")),
            Loop("node", nodes, (_ENTER, *time, Call("gradient"), Call("leave_force", _HERE))),
            Call("sum_stages", ("W", "STAGE_P", "STAGE_NU", "STAGE_F", "lane")),
            Loop("node", solved, (*again, Call("leave_velocity", _HERE))),
            Call("check_stage_convergence"),
        )
        doc = "One iteration for the velocities and forces at all nodes."
        return Kernel("iterate", doc, lanes((IfActive(body),)))

    def _advance(self) -> Kernel:
        left = (Call("leave_path"),) if self.low.equations.looked_at else ()
        more = map(Call, ("extrapolate_stages", "check_stage_acceptance"))
        body = (Call("close_stages"), *left, *more)
        doc = "Close a step by compensated sums, then extrapolate to the nodes of the next."
        return Kernel("advance_stages", doc, lanes((IfActive(body),)))
