"""Thresholds of the library functions: when an iteration is done, and a step in doubt."""

from __future__ import annotations

from symsimpson.discrete.equations import DiscreteEquations
from symsimpson.lower.ir import Module

#: Constants of the library functions that check an iteration and a step.
_THRESHOLDS = """\
# when Newton's method is done, and in doubt; relative sizes, squared
INFINITE = real("inf")
NEGLIGIBLE = {negligible}
OWN_NEGLIGIBLE = 2.0**-80  # that of a single coordinate is so small a part of its increment,
OWN_ROUNDED = 2.0**-190  # or the present one, to the fourth power, of all increments
QUADRATIC = 1e-2  # from here on corrections shrink quadratically
STAGNATION = 1e-20  # corrections that stop shrinking below this are round-off
FAR = 4.0  # a velocity at the end of the path off by more is in doubt
UNRESOLVED = {unresolved}  # cyclic velocities off by more are lost within the step
LARGE_CHANGE = 0.5  # where M of cyclic coordinates changes by more, finer steps are compared
"""
_HELD_THRESHOLDS = """\
ROUNDED = 2.0**-92  # corrections that stop shrinking below this, relative to q, are round-off
"""
_DRIFT_THRESHOLDS = f"""\
# when a drift ends on the constraints; relative sizes, squared
INFINITE = real("inf")
{_HELD_THRESHOLDS}MOST_CORRECTIONS = 100
"""
#: Whether M is singular, where it is indefinite.
_SINGULAR_THRESHOLD = """\
SINGULAR = 2.0**-40  # the least determinant of M with rows of size 1
"""
_LEGENDRE_THRESHOLDS = """\
CLOSE = 2.0**-60  # momenta whose squared error is below this part of them get whole corrections
MOST_HALVINGS, MOST_SOUGHT = 50, 200  # of a correction, and corrections
"""
_PHASE_THRESHOLD = """\
SMALL_MOVE = 2.0**-44  # moves of a coordinate count at least as this part of it
"""
#: Beyond degree two truncation is so small that what is left unsolved, which adds up, would show.
_NEGLIGIBLE = [f"2.0**-{k}  # the next correction would be lost in rounding" for k in (106, 110)]
_STAGE_THRESHOLDS = """\
MANY = 10  # after more iterations what nodes have is extrapolated with care
LOST = 2.0**-150  # what is left at nodes has a sign and adds up: in 1e9 steps below rounding
ROUNDING = 2.0**-132  # corrections below this are made of rounding
FALL = 2.0  # M is looked at where its pivots fall so far behind the last node, as the last two do
STALLED = 2.0**-92  # and below this where they shrink no more,
NOISE = 2.0**-100  # or below this where they hardly do
"""
_TURN_THRESHOLDS = """\
FRESH = 2  # iterations that compute sines and cosines; later ones turn them by what angles change
TURN = 2.0**-14  # by so much, squared, they are turned exactly
"""


def thresholds(equations: DiscreteEquations, module: Module) -> str:
    """Return the definitions of the thresholds that the library functions of a module use."""
    plain = equations.plain
    canonical = plain.hamiltonian is not None
    of_mass = _SINGULAR_THRESHOLD if canonical or not plain.definite else ""
    of_mass += _LEGENDRE_THRESHOLDS if canonical or not plain.quadratic else ""
    of_mass += _PHASE_THRESHOLD if canonical else ""
    if not module.newton_unknowns:
        infinite = 'INFINITE = real("inf")\n' if canonical else ""
        return (_DRIFT_THRESHOLDS if module.names.constraints else infinite) + of_mass
    # a straight path leaves rest with the velocity it ends with
    lines = _THRESHOLDS.format(
        negligible=_NEGLIGIBLE[equations.scheme.degree > 2],
        unresolved=1.0 if equations.scheme.degree == 1 else 0.12,
    )
    lines += _HELD_THRESHOLDS if module.names.constraints else ""
    lines += _STAGE_THRESHOLDS if "STRIDE" in module.tables else ""
    return lines + of_mass + (_TURN_THRESHOLDS if "STAGE_TURNED" in module.layout else "")
