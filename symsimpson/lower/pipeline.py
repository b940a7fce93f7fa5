"""From a system to the text of a module, on one page."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import sympy as sp

from symsimpson.declare.expression_checks import read_expression
from symsimpson.declare.hamiltonian import HamiltonianSystem
from symsimpson.declare.plain import Symbols
from symsimpson.declare.system import MechanicalSystem
from symsimpson.discrete.equations import discretise
from symsimpson.discrete.jet import RunningCost
from symsimpson.discrete.reductions import read_exploit
from symsimpson.errors import GenerationError, reject
from symsimpson.graph.nodes import Value
from symsimpson.graph.rebuild import rebuild
from symsimpson.lower.emit import emit
from symsimpson.lower.emitted_names import NameTable
from symsimpson.lower.forms import is_unrolled
from symsimpson.lower.module_kernels import lower
from symsimpson.schemes.named import read_scheme
from symsimpson.schemes.scheme import Scheme
from symsimpson.support.derivation import LAGRANGIAN, Derivation, collect_times, time_stage
from symsimpson.support.interpreter import collect_rarely


def source(
    system: MechanicalSystem, scheme: str | Scheme = "simpson", exploit: str | Iterable[str] = "all"
) -> str:
    """Generate the text of a module; ``exploit`` names the findings that it uses."""
    return derive(system, scheme, exploit).text


def derive(
    system: MechanicalSystem,
    scheme: str | Scheme = "simpson",
    exploit: str | Iterable[str] = "all",
    varied: Iterable[str] | None = None,
    running: Any = None,
    *,
    second: bool = False,
) -> Derivation:
    """Generate the module of a system and a scheme, with the seconds of each stage.

    Parameters
    ----------
    system, scheme, exploit
        As for :func:`source`.
    varied : iterable of str, optional
        Names of parameters and inputs. The module then differentiates a step by these, and by q
        and p.
    running : sympy.Expr or LAGRANGIAN, optional
        A cost in the user's symbols. The module integrates it along the path.
    second : bool
        Whether the module has second derivatives of the rows of a step.
    """
    names = None if varied is None else tuple(varied)
    return _derive(system, read_scheme(scheme), read_exploit(exploit), names, running, second)


def _read_cost(system: MechanicalSystem, running: Any) -> RunningCost | None:
    """Read a running cost g(t, q, v, u) in the user's symbols.

    Raises ModelError if it contains something else.
    """
    if running is None:
        return None
    if isinstance(running, str) and running == LAGRANGIAN:
        return RunningCost(system.plain.graph, system.plain.L)
    symbols = Symbols(system.coordinates, system.parameters, system.inputs)
    if isinstance(system, HamiltonianSystem):
        return _read_cost_of_momenta(system, symbols, running)
    allowed = (*symbols.q, *symbols.v, *symbols.a, *symbols.u, symbols.t)
    value = read_expression(system.name, "running cost", running, symbols, symbols.known, allowed)
    return RunningCost(symbols.graph, value)


def _read_cost_of_momenta(system: HamiltonianSystem, symbols: Symbols, running: Any) -> RunningCost:
    """Read a running cost g(t, q, p, v, u) of a Hamiltonian, where v is H_p."""
    rates = rebuild(system.plain.graph, system.plain.velocities, {}, symbols.graph)
    known: dict[sp.Basic, Value] = dict(symbols.known)
    for velocity, p, rate in zip(
        (q.diff() for q in system.coordinates), system.momenta, rates, strict=True
    ):
        known[p] = symbols.known[velocity]
        known[velocity] = rate
    allowed = (*symbols.q, *symbols.v, *symbols.a, *symbols.u, symbols.t)
    value = read_expression(system.name, "running cost", running, symbols, known, allowed)
    return RunningCost(symbols.graph, value)


def _find_varied(system: MechanicalSystem, names: Iterable[str]) -> tuple[sp.Symbol, ...]:
    """Return the plain symbols of parameters and inputs, by the user's names or the module's.

    Raises GenerationError if there is no such parameter or input.
    """
    plain, table = system.plain, NameTable(system)
    symbols = (*plain.parameters, *plain.u)
    users = [str(symbol) for symbol in (*system.parameters, *system.inputs)]
    by_name = dict(zip((*table.parameters, *table.inputs), symbols, strict=True))
    by_name = {"h": plain.step[0], "t": plain.t} | by_name | dict(zip(users, symbols, strict=True))
    by_name |= {"(h)": plain.step[0], "(t)": plain.t}  # whatever parameters are called
    for name in names:
        if name not in by_name:
            reject(
                f"{name!r} is no parameter or input of {system.name}.",
                where="derivatives",
                remedy=f"Choose among {', '.join([*users, 'h', 't'])}.",
                error=GenerationError,
            )
    return tuple(by_name[name] for name in names)


@lru_cache(maxsize=64)
def _derive(
    system: MechanicalSystem,
    scheme: Scheme,
    exploit: frozenset[str],
    names: tuple[str, ...] | None,
    running: Any,
    second: bool,
) -> Derivation:
    varied = None if names is None else _find_varied(system, names)
    cost = _read_cost(system, running)
    with collect_times() as seconds, collect_rarely():
        # MechanicalSystem, Scheme -> DiscreteEquations -> Module of kernels -> text
        equations = discretise(system, scheme, exploit, varied, cost, second=second)
        if not is_unrolled(equations):  # in loops, forces damp
            equations = discretise(
                system, scheme, exploit - {"conformal"}, varied, cost, second=second
            )
        before = seconds.get("jet", 0.0)  # where its size is looked at above
        with time_stage("text"):
            module = lower(equations)
            text = emit(equations, module)
    jet = seconds.get("jet", 0.0)
    stages = {**system.seconds, "jet": jet, "text": seconds["text"] - (jet - before)}
    written_out = is_unrolled(equations)
    operations = equations.jet.operations if written_out else None
    return Derivation(text, stages, operations, written_out)
