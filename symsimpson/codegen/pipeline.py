"""The whole way from a system to the text of a module, on one page."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from symsimpson.codegen.emit import emit
from symsimpson.codegen.kernels import lower
from symsimpson.discrete.equations import discretise
from symsimpson.discrete.reductions import read_exploit
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme

__all__ = ["source"]


def source(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    exploit: str | Iterable[str] = "all",
) -> str:
    """Generate the module of a system and a scheme.

    Parameters
    ----------
    system : MechanicalSystem
    scheme : str or Scheme
    exploit : str or iterable of str
        Findings about the system that may be made use of.

    Returns
    -------
    str
        The module's text, the same bytes every time; remembered for systems asked for of late.
    """
    return _source(system, read_scheme(scheme), read_exploit(exploit))


@lru_cache(maxsize=64)
def _source(system: MechanicalSystem, scheme: Scheme, exploit: frozenset[str]) -> str:
    equations = discretise(system, scheme, exploit)  # MechanicalSystem, Scheme -> DiscreteEquations
    module = lower(equations)  # DiscreteEquations -> Module of kernels
    return emit(equations, module)  # Module -> text
