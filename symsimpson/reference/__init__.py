"""References to compare results with; none of them uses the generator.

The exact motion of the Lagrange top, systems in first-order form, the classical Runge-Kutta
method, compiled, and an accurate solution of any system with an estimate of its error.
"""

from symsimpson.reference.extrapolation import Truth, truth
from symsimpson.reference.first_order import FirstOrder, canonical, reduced_top, second_order
from symsimpson.reference.runge_kutta import rk4
from symsimpson.reference.top import ExactTop

__all__ = [
    "ExactTop",
    "FirstOrder",
    "Truth",
    "canonical",
    "reduced_top",
    "rk4",
    "second_order",
    "truth",
]
