"""The structure of a system that is declared by its Hamiltonian."""

from __future__ import annotations

from symsimpson.declare.declared import Declared
from symsimpson.declare.quadratic import rank
from symsimpson.declare.structure import Structure, Subsystem
from symsimpson.graph.derive import Derivatives
from symsimpson.graph.findings import IdentityTest
from symsimpson.graph.nodes import ZERO


def analyse_hamiltonian(system: Declared) -> Structure:
    """Find the structure of a system that is declared by H; its momenta are the symbols v."""
    plain, n = system.plain, system.n
    names = [user.func.__name__ for user in system.coordinates]
    graph, q, p = plain.graph, plain.numbers(plain.q), plain.numbers(plain.v)
    derivatives = Derivatives(graph)
    forces, rates = plain.right_sides, plain.velocities
    curves = [[derivatives(rate, x) for x in p] for rate in rates]
    mixed = [derivatives(rate, x) for rate in rates for x in q]
    flat = [entry for row in curves for entry in row]
    findings = IdentityTest(graph, [*forces, *rates, *flat, *mixed, plain.hamiltonian or ZERO])
    undragged = not any(findings.depends(f, x) for f in forces for x in p)
    separable = undragged and all(map(findings.vanishes, mixed))
    everything = [*rates, *forces, plain.hamiltonian or ZERO]
    cyclic = tuple(
        i
        for i in range(n)
        if findings.vanishes(forces[i])
        and not any(findings.depends(value, q[i]) for value in everything)
    )
    vanishing = sum(map(findings.vanishes, flat))
    return Structure(
        n=n,
        constant_mass=False,
        diagonal_mass=False,
        constant_rows=(),
        gyroscopic=False,
        separable=separable,
        linear=False,
        cyclic=tuple(names[i] for i in cyclic),
        autonomous=plain.autonomous,
        damping=None,
        forced=tuple(name for name, (c, _) in zip(names, plain.f, strict=True) if c),
        periodic=(),
        subsystems=(
            Subsystem(
                tuple(range(n)), cyclic, constant_mass=False, separable=separable, linear=False
            ),
        ),
        zeros={"H_pp": (vanishing, n * n)},
        undecided=(),
        nearly=(),
        plain=plain,
        system=system,
        momentum_rank=rank(graph, curves),
    )
