"""The whole way from a system to the text of a module, on one page."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from symsimpson.codegen.emit import emit
from symsimpson.codegen.kernels import lower, unrolled
from symsimpson.derivation import Derivation
from symsimpson.discrete.equations import discretise
from symsimpson.discrete.reductions import read_exploit
from symsimpson.errors import SchemeError
from symsimpson.garbage import rarely_collected
from symsimpson.mechanics.system import MechanicalSystem
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.stopwatch import collecting, timed

__all__ = ["derive", "source"]


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
    return derive(system, scheme, exploit).text


def derive(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    exploit: str | Iterable[str] = "all",
) -> Derivation:
    """Generate the module of a system and a scheme, and say what that took.

    Parameters
    ----------
    system, scheme, exploit
        As for :func:`source`.

    Returns
    -------
    Derivation
    """
    return _derive(system, read_scheme(scheme), read_exploit(exploit))


@lru_cache(maxsize=64)
def _derive(system: MechanicalSystem, scheme: Scheme, exploit: frozenset[str]) -> Derivation:
    with collecting() as seconds, rarely_collected():
        # MechanicalSystem, Scheme -> DiscreteEquations -> Module of kernels -> text
        equations = discretise(system, scheme, exploit)
        if not unrolled(equations) and equations.plain.rates:
            raise SchemeError(
                f"{system.name} is so large that steps of {scheme.name} are loops, whose kicks "
                "have no friction yet.\nChoose a scheme of the family, as 'simpson' or 'gauss8'."
            )
        if not unrolled(equations):  # in loops, forces damp
            equations = discretise(system, scheme, exploit - {"conformal"})
        with timed("text"):
            module = lower(equations)
            text = emit(equations, module)
    jet = seconds.get("jet", 0.0)
    stages = {**system.seconds, "jet": jet, "text": seconds["text"] - jet}
    written_out = unrolled(equations)
    operations = equations.jet.operations if written_out else None
    return Derivation(text, stages, operations, written_out)
