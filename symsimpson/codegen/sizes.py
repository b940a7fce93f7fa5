"""Numbers of a module that the sizes of its blocks follow from."""

from __future__ import annotations

from symsimpson.codegen.differentials import sizes as differential_sizes
from symsimpson.codegen.facts import cost_of_time
from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.codegen.stages import Stages
from symsimpson.codegen.storage import node_stride
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.reductions import Composed
from symsimpson.module.dimensions import Sizes

__all__ = ["drifting", "sizes"]


def sizes(
    low: Lowering, loops: LoopKernels, stages: Stages | None, *, by_columns: bool, decaying: bool
) -> Sizes:
    """Return what the sizes of all blocks follow from."""
    storage, held, plain = loops.storage, loops.held, low.equations.plain
    unknowns, scheme = low.equations.unknowns, low.equations.scheme
    looped = low.equations.varied is not None or not loops.written
    bordered = () if held is None else (held.storage,)
    jacobian = [part.size(unknowns.control_points) for part in (storage, *bordered)]
    return Sizes(
        n=low.n,
        m=held.count if held else 0,
        rolling=held.velocities if held else 0,
        parameters=len(low.names.parameters),
        inputs=len(low.names.inputs),
        invariants=len(low.names.invariants),
        powers=len(plain.powers),
        degree=scheme.degree,
        nodes=scheme.stages,
        unknowns=unknowns.size,
        entries=storage.node_size,
        bordered=sum(part.node_size for part in bordered),
        jacobian=sum(jacobian),
        hoisted=len(low.hoisted),
        coefficients=len(low.coefficients),
        pivots=len(low.scales),
        stride=node_stride(scheme),
        by_nodes=looped or bool(plain.powers) or low.equations.system.retiming is not None,
        assembled=bool(low.equations.rows) and looped,
        constant_mass=loops.constant_mass,
        dragged=plain.dragged,
        timed=not plain.autonomous or cost_of_time(low),
        damped=plain.rate is not None,
        decaying=decaying,
        constrained=held is not None,
        carried=plain.carried,
        drifting=drifting(low.equations),
        retimed=low.equations.system.retiming is not None,
        cyclic=len(loops.routh.cyclic) if loops.routh else 0,
        cyclic_multipliers=loops.routh.multipliers if loops.routh else 0,
        **(stages.sizes if stages is not None else {}),
        **differential_sizes(low, by_columns=by_columns),
    )


def drifting(equations: DiscreteEquations) -> bool:
    """Return whether steps are kicks and drifts."""
    return any(isinstance(part, Composed) for part in equations.parts)
