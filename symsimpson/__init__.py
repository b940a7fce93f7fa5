"""Variational integrators from kinetic and potential energy.

Declare T and V in SymPy; get a compiled, symplectic stepper of order two, four or more.

>>> import symsimpson as ss
>>> stepper = ss.compile(ss.systems.double_pendulum(), scheme="simpson")
>>> run = stepper.integrate([0.8, 1.0], p0=[0, 0], h=0.01, t_end=10.0)
>>> run
Trajectory(double_pendulum, simpson: 1000 steps of h=0.01, 1001 states stored, SUCCESS)
"""

import logging

import lazy_loader

__version__ = "0.4.0.dev0"

logging.getLogger(__name__).addHandler(logging.NullHandler())
# what is named in __init__.pyi is imported when it is first used, so that the package starts fast
_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name in __all__:
        return _attribute(name)
    from symsimpson.support.names import did_you_mean

    raise AttributeError(f"symsimpson has no {name}.{did_you_mean(name, __all__)}")
