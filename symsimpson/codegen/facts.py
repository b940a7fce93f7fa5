"""Facts of a module, by which conditions in texts of the library are resolved."""

from __future__ import annotations

from symsimpson.codegen.looped import LoopKernels
from symsimpson.codegen.lower import Lowering
from symsimpson.discrete.reductions import Composed, Part, Routh, Separable

__all__ = ["cost_of_time", "facts", "part_facts", "system_facts"]


def facts(
    low: Lowering, loops: LoopKernels, part: Part, *, following: bool = False
) -> dict[str, object]:
    """Return the facts of a module whose step solves for a part.

    Increments of some coordinates may be ``following`` from those of the others.
    """
    return {
        **system_facts(low),
        **part_facts(part),
        "TRACED": False,
        "HELD": loops.held is not None,
        "ROLLING": loops.rolling,
        "CARRIED": loops.carried,
        "CONSTANT_MASS": loops.constant_mass,
        "PIVOTS": not loops.constant_mass,
        "NEWTON_IN_ORDER": loops.in_order,
        "IN_PAIRS": loops.written,
        "CLEARED": loops.cleared,
        "WEIGHTED": True,
        "FOLLOWING": following,
    }


def system_facts(low: Lowering) -> dict[str, object]:
    """Return what texts are told about a system, and about what is asked of its steps."""
    equations, plain = low.equations, low.equations.plain
    return {
        "AUTONOMOUS": plain.autonomous,
        "DRIVEN": bool(plain.u),
        "TIMED": bool(plain.u) or not plain.autonomous,
        "ALIKE": plain.autonomous and not plain.u,
        "DRAGGED": plain.dragged,
        "DAMPED": plain.rate is not None,
        "HOLONOMIC": len(plain.constraints),
        "GYROSCOPIC": equations.system.structure.gyroscopic,
        "LOOKED_AT": equations.looked_at,
        "VARIED_BY": len(low.varied),
        "SIZED": low.sized,
        "COSTED": equations.cost is not None,
        "TIMED_COST": plain.autonomous and cost_of_time(low),
        "SECOND": equations.second,
    }


def part_facts(part: Part) -> dict[str, object]:
    """Return what texts are told about the equations of a part."""
    follows = isinstance(part, Separable) and part.last is not None
    return {
        "CYCLIC": len(part.cyclic) if isinstance(part, Routh) else 0,
        "EXTRA": len(part.annihilator) if isinstance(part, Routh) else 0,
        "SEPARABLE": isinstance(part, Separable),
        "FOLLOWS": follows and bool(part.columns),
        "STRAIGHT_PATH": follows and not part.columns,
        "COMPOSED": isinstance(part, Composed),
        "ITERATED": bool(part.columns),
    }


def cost_of_time(low: Lowering) -> bool:
    """Return whether a running cost depends on the time."""
    cost, plain = low.equations.cost, low.equations.plain
    return cost is not None and cost.depends(plain.t)
