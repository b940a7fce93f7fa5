"""Which form kernels have: written out, or as loops, where lines would be many."""

from __future__ import annotations

from symsimpson.declare.constraints import regular_mass
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.reductions import Affine, Composed, Coupled, Linear, Part, Routh

#: Straight lines are written up to about so many: each takes some 3 ms to compile, and loops, of
#: which each is a function of its own, 12 s in all. They run two to five times as fast.
MOST_LINES = 4000
#: Parts with more unknowns are not written out, whatever they are made of.
UNROLLED_UNKNOWNS = 16
#: Those with constraints are sparse, and longer unrolled than others are: their loops take 18 s to
#: compile, and five times as long to run.
CONSTRAINED_UNKNOWNS, CONSTRAINED_LINES = 32, 5000
#: Nor are explicit steps with more forces, one for each kick and coordinate.
UNROLLED_FORCES = 270
#: All equations of a step are written out beside those of its parts if there are no more.
WRITTEN_UNKNOWNS = 4


def unrolled(equations: DiscreteEquations) -> bool:
    """Return whether kernels are written as straight-line code instead of loops."""
    plain, few = equations.plain, all(_size(x) <= UNROLLED_UNKNOWNS for x in equations.parts)
    if plain.velocity_constraints and not regular_mass(plain, equations.system.parameters.values()):
        return False  # an elimination exchanges rows
    if plain.held:  # drifts of these are loops
        few = equations.unknowns.size <= CONSTRAINED_UNKNOWNS and not drifting(equations)
    most = CONSTRAINED_LINES if plain.held else MOST_LINES
    return equations.scheme.exact and few and _lines(equations) <= most


def solves_all(equations: DiscreteEquations) -> bool:
    """Return whether Newton's method solves the equations of a step as they are."""
    first, *others = equations.parts
    return isinstance(first, Coupled) and not others


def few_equations(equations: DiscreteEquations) -> bool:
    """Return whether all equations of a step, as they are, take fewer lines than their loops."""
    asked = bool(equations.rows) and equations.varied is None and not equations.plain.held
    return asked and equations.unknowns.size <= WRITTEN_UNKNOWNS


def _lines(equations: DiscreteEquations) -> float:
    """Estimate how many lines all kernels have, from operations that are known before.

    Two kernels evaluate the jet at all nodes and eliminate, others parts of it once.
    """
    operations, stages = equations.jet.operations, equations.scheme.stages
    if drifting(equations):
        return operations + equations.jet.force_operations * stages
    if equations.plain.held:  # half of the matrix is zero
        size = equations.unknowns.size
        return (2 * stages + 1.5) * operations + size**2 + size**3 / 12
    unknowns = [part_unknowns(part) for part in equations.parts]
    elimination = sum(u**2 + u**3 / 12 for u in unknowns)
    return (2 * stages + 1.5) * operations + 2 * elimination


def _size(part: Part) -> int:
    """Measure a part by its unknowns or multipliers, or by an equivalent length of its text."""
    if isinstance(part, Linear):
        return 2 * len(part.coordinates)
    if isinstance(part, Affine):
        return len(part.coordinates) * len(part.solved)
    if isinstance(part, Composed):
        forces = len(part.coordinates) * len(part.drifts)
        return UNROLLED_UNKNOWNS * forces // UNROLLED_FORCES
    multipliers = len(part.cyclic) * len(part.annihilator) if isinstance(part, Routh) else 0
    return max(part_unknowns(part), multipliers)


def part_unknowns(part: Part) -> int:
    """Count the unknowns that a part solves for together."""
    return len(part.coordinates) * len(part.columns)


def drifting(equations: DiscreteEquations) -> bool:
    """Return whether steps are kicks and drifts."""
    return any(isinstance(part, Composed) for part in equations.parts)
