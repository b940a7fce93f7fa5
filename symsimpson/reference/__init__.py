"""References to compare results with; none of them uses the generator.

The exact motion of the Lagrange top, systems in first-order form, the classical Runge-Kutta
method, compiled, and an accurate solution of any system with an estimate of its error.
"""

from symsimpson.reference.extrapolation import Truth as Truth
from symsimpson.reference.extrapolation import truth as truth
from symsimpson.reference.first_order import FirstOrder as FirstOrder
from symsimpson.reference.first_order import canonical as canonical
from symsimpson.reference.first_order import reduced_top as reduced_top
from symsimpson.reference.first_order import second_order as second_order
from symsimpson.reference.runge_kutta import rk4 as rk4
from symsimpson.reference.top import ExactTop as ExactTop
