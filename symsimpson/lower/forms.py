"""The form of kernels: straight-line code for small systems, loops for large ones."""

from __future__ import annotations

from symsimpson.declare.constraints import regular_mass
from symsimpson.declare.quadratic import connected_groups
from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.discrete.reductions import Affine, Composed, Coupled, Linear, Part, Routh

#: The most lines of straight-line code. Each line takes about 3 ms to compile, and all loops
#: together 12 s. Straight-line code is two to five times as fast as loops.
MOST_LINES = 4000
#: The most unknowns of a part in straight-line code.
UNROLLED_UNKNOWNS = 16
#: The same limits for systems with constraints. These are sparse, and their loops take 18 s to
#: compile and run five times as long.
CONSTRAINED_UNKNOWNS, CONSTRAINED_LINES = 32, 5000
#: The most forces of an explicit step in straight-line code, one for each kick and coordinate.
UNROLLED_FORCES = 270
#: The most unknowns for which unreduced equations are also straight-line code.
WRITTEN_UNKNOWNS = 4


def is_unrolled(equations: DiscreteEquations) -> bool:
    """Return whether kernels are written as straight-line code instead of loops."""
    plain, few = equations.plain, all(_size(x) <= UNROLLED_UNKNOWNS for x in equations.parts)
    if not plain.definite and max(map(len, connected_groups(len(plain.q), plain.M))) > 2:
        return False  # an elimination exchanges rows
    if plain.velocity_constraints and not regular_mass(plain, equations.system.parameters.values()):
        return False  # an elimination exchanges rows
    if plain.constraint_names:  # drifts of these are loops
        few = equations.unknowns.size <= CONSTRAINED_UNKNOWNS and not has_drifts(equations)
    most = CONSTRAINED_LINES if plain.constraint_names else MOST_LINES
    return equations.scheme.exact and few and _lines(equations) <= most


def solves_unreduced(equations: DiscreteEquations) -> bool:
    """Return whether Newton's method solves the unreduced equations of a step."""
    first, *others = equations.parts
    return isinstance(first, Coupled) and not others


def has_few_equations(equations: DiscreteEquations) -> bool:
    """Return whether the unreduced equations of a step take fewer lines than their loops."""
    asked = (
        bool(equations.rows) and equations.varied is None and not equations.plain.constraint_names
    )
    return asked and equations.unknowns.size <= WRITTEN_UNKNOWNS


def _lines(equations: DiscreteEquations) -> float:
    """Estimate the number of lines of all kernels from the operations of the jet.

    Two kernels evaluate the jet at all nodes and eliminate; others evaluate parts of it once.
    """
    operations, stages = equations.jet.operations, equations.scheme.stages
    if has_drifts(equations):
        return operations + equations.jet.force_operations * stages
    if equations.plain.constraint_names:  # half of the matrix is zero
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


def has_drifts(equations: DiscreteEquations) -> bool:
    """Return whether steps are kicks and drifts."""
    return any(isinstance(part, Composed) for part in equations.parts)
