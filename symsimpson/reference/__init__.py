"""Reference solutions that do not use the code generator.

- The exact motion of the Lagrange top.
- Systems in first-order form.
- The classical Runge-Kutta method, compiled.
- Accurate solutions of any system, with an estimate of their error.
"""

from symsimpson.reference.extrapolation import Truth as Truth
from symsimpson.reference.extrapolation import truth as truth
from symsimpson.reference.first_order import FirstOrder as FirstOrder
from symsimpson.reference.first_order import canonical as canonical
from symsimpson.reference.first_order import reduced_top as reduced_top
from symsimpson.reference.first_order import second_order as second_order
from symsimpson.reference.runge_kutta import rk4 as rk4
from symsimpson.reference.top import ExactTop as ExactTop
