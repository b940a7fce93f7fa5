"""The whole way from a system to the text of a module, on one page."""

from __future__ import annotations

from functools import lru_cache

from symsimpson.codegen.emit import emit
from symsimpson.codegen.kernels import lower
from symsimpson.discrete.equations import discretise
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.schemes.scheme import Scheme, read_scheme

__all__ = ["source"]


def source(system: MechanicalSystem, scheme: str | Scheme = "simpson") -> str:
    """Generate the module of a system and a scheme.

    Parameters
    ----------
    system : MechanicalSystem
    scheme : str or Scheme

    Returns
    -------
    str
        The module's text, the same bytes every time; remembered for systems asked for of late.
    """
    return _source(system, read_scheme(scheme))


@lru_cache(maxsize=64)
def _source(system: MechanicalSystem, scheme: Scheme) -> str:
    equations = discretise(system, scheme)  # MechanicalSystem, Scheme -> DiscreteEquations
    module = lower(equations)  # DiscreteEquations -> Module of kernels
    return emit(equations, module)  # Module -> text
